# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Static transforms between frames, as `/tf_static` has them."""

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
    """From one frame to another: rotation (3, 3) of vectors, and the place (3,) m of the one's origin."""

    rotation: Array
    translation: Array

    def then(self, other: Transform) -> Transform:
        """This one, then another."""
        return Transform(
            other.rotation @ self.rotation, other.rotation @ self.translation + other.translation
        )

    def inverse(self) -> Transform:
        """The way back."""
        return Transform(self.rotation.T, -self.rotation.T @ self.translation)


def plain_name(frame: str) -> str:
    """A frame without the slash that tf once put before it."""
    return frame.strip("/")


class StaticTransforms:
    """What is known of how frames lie to each other.

    Attributes:
        changes: counts the messages taken.
    """

    def __init__(self) -> None:
        self.changes = 0
        self._to: dict[str, dict[str, Transform]] = {}

    def take(self, message: bytes) -> None:
        """Take a serialized tf2_msgs/TFMessage; of two transforms between the same frames the later counts.

        Raises:
            LogError: for bytes that are none; for a rotation that is none, once the others have been taken.
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
        """From one frame to another, through others if necessary; None without a path."""
        reached = {source: Transform(np.eye(3), np.zeros(3))}
        waiting = [source]
        while waiting and target not in reached:
            frame = waiting.pop(0)
            for following, transform in self._to.get(frame, {}).items():
                if following not in reached:
                    reached[following] = reached[frame].then(transform)
                    waiting.append(following)
        return reached.get(target)
