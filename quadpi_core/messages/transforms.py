# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Static transforms between frames, from the messages of `/tf_static`."""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np
from rosbags.serde import SerdeError

from quadpi_core.errors import LogError
from quadpi_core.frames import Array
from quadpi_core.messages.definitions import typestore
from quadpi_core.rotations import rotation_matrix

TF_TYPE = "tf2_msgs/msg/TFMessage"
TF_TOPIC = "tf_static"
_NORM_TOLERANCE = 0.01


class Transform(NamedTuple):
    """Transform between frames: rotation (3, 3) of vectors, position (3,) m of the source's origin."""

    rotation: Array
    translation: Array

    def then(self, other: Transform) -> Transform:
        """This transform followed by another."""
        return Transform(
            other.rotation @ self.rotation, other.rotation @ self.translation + other.translation
        )

    def inverse(self) -> Transform:
        """The inverse transform."""
        return Transform(self.rotation.T, -self.rotation.T @ self.translation)


def plain_name(frame: str) -> str:
    """Name of a frame without the leading slash of early tf."""
    return frame.strip("/")


class StaticTransforms:
    """Tree of static transforms.

    Attributes:
        changes: number of messages added.
    """

    def __init__(self) -> None:
        self.changes = 0
        self._to: dict[str, dict[str, Transform]] = {}

    def take(self, message: bytes) -> None:
        """Add a serialized tf2_msgs/TFMessage; later transforms replace earlier ones between the same frames.

        Raises:
            LogError: for invalid bytes; for an invalid rotation, after the other transforms were added.
        """
        try:
            decoded = typestore().deserialize_cdr(message, TF_TYPE)
        except (SerdeError, struct.error, ValueError, IndexError, AssertionError, MemoryError) as error:
            raise LogError(f"its {len(message)} bytes are no {TF_TYPE}") from error
        wrong = []
        for one in decoded.transforms:  # type: ignore[attr-defined]
            parent, child = plain_name(one.header.frame_id), plain_name(one.child_frame_id)
            q, p = one.transform.rotation, one.transform.translation
            quaternion, translation = np.array([q.w, q.x, q.y, q.z]), np.array([p.x, p.y, p.z])
            norm = float(np.linalg.norm(quaternion))
            if not (abs(norm - 1.0) <= _NORM_TOLERANCE and np.isfinite(translation).all()):
                wrong.append(
                    f"the transform from {parent} to {child} is none (quaternion of norm {norm:.3g})"
                )
                continue
            transform = Transform(rotation_matrix(quaternion / norm), translation)
            self._to.setdefault(child, {})[parent] = transform
            self._to.setdefault(parent, {})[child] = transform.inverse()
        self.changes += 1
        if wrong:
            raise LogError(wrong[0])

    def between(self, source: str, target: str) -> Transform | None:
        """Transform from one frame to another, through others if necessary; None without a path."""
        reached = {source: Transform(np.eye(3), np.zeros(3))}
        waiting = [source]
        while waiting and target not in reached:
            frame = waiting.pop(0)
            for following, transform in self._to.get(frame, {}).items():
                if following not in reached:
                    reached[following] = reached[frame].then(transform)
                    waiting.append(following)
        return reached.get(target)
