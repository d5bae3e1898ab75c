# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Poses of one body among those that a motion capture follows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from quadpi_core.errors import SampleError
from quadpi_core.flight import PoseStream, Stamps
from quadpi_core.frames import (
    Array,
    quaternion_flu_enu_to_frd_ned,
    quaternion_fur_eus_to_flu_enu,
    world_enu_to_ned,
    world_eus_to_enu,
)
from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, Reading, of_items
from quadpi_core.messages.adapters.adapter_settings import FLU_ENU, FRD_NED, FUR_EUS, BodySettings
from quadpi_core.messages.cdr import header_stamps
from quadpi_core.messages.definitions import Items
from quadpi_core.messages.frame_ids import TF_TYPE, BodyFrames, FrameRefusedError
from quadpi_core.records import NORM_TOLERANCE
from quadpi_core.vehicle import Vehicle

_WXYZ = [3, 0, 1, 2]
_SEEN_MAX = 8


class Members(NamedTuple):
    """Columns of a body: its name, its position, and its orientation as a quaternion x, y, z, w."""

    name: str
    position: str = "pose.position"
    orientation: str = "pose.orientation"


class BodyReader:
    """Poses of the body that the settings name.

    A body that is hidden is absent from a message, or comes with an orientation that is none (NaN, zeros).
    """

    def __init__(self, settings: BodySettings) -> None:
        assert settings.body is not None
        self._settings, self._body = settings, settings.body
        # Names of other bodies, for whoever has to find out what the own one is called.
        self._seen: set[str] = set()
        self._absent, self._untracked = 0, 0

    def dropped(self) -> Counter[str]:
        """How many messages gave no sample, by reason."""
        seen = ", ".join(sorted(self._seen)) or "none"
        return +Counter(
            {
                f"{self._body} is not in it (others: {seen})": self._absent,
                f"{self._body} has no pose in it": self._untracked,
            }
        )

    def read(self, time_ns: Stamps, bodies: Items, members: Members) -> PoseStream:
        """The poses among the M bodies that N messages hold.

        Raises:
            SampleError: if two bodies of a message have the name.
        """
        names = bodies.columns[members.name]
        rows = np.flatnonzero(names == self._body.encode())
        sample = bodies.message[rows]
        if len(rows) > 1 and np.any(np.diff(sample) == 0):
            index = int(sample[np.argmin(np.diff(sample))])
            raise SampleError(index, f"two bodies are named {self._body}")
        if absent := len(bodies.counts) - len(rows):
            self._absent += absent
            if len(self._seen) < _SEEN_MAX:
                others = {other.decode(errors="replace") for other in np.unique(names)[: _SEEN_MAX + 1]}
                self._seen |= others - {self._body}
        position = bodies.columns[members.position][rows]
        orientation = bodies.columns[members.orientation][rows][:, _WXYZ]
        norm = np.sqrt(np.sum(orientation * orientation, axis=1))
        tracked = (np.abs(norm - 1.0) <= NORM_TOLERANCE) & np.isfinite(position).all(axis=1)
        if not tracked.all():
            self._untracked += int(np.sum(~tracked))
            rows, position, orientation, norm = (
                values[tracked] for values in (rows, position, orientation, norm)
            )
        return PoseStream(
            time_ns[rows], *_to_ned(self._settings, position, orientation / norm[:, np.newaxis])
        )


def _to_ned(settings: BodySettings, position: Array, attitude: Array) -> tuple[Array, Array]:
    """Position (N, 3) in NED and attitude (N, 4) FRD to NED."""
    if settings.frames == FRD_NED:
        return position, attitude
    if settings.frames == FUR_EUS:
        position, attitude = world_eus_to_enu(position), quaternion_fur_eus_to_flu_enu(attitude)
    return world_enu_to_ned(position), quaternion_flu_enu_to_frd_ned(attitude)


def _bodies(array: str, members: Members) -> Callable[[BodySettings, Vehicle | None], Reading]:
    def start(settings: BodySettings, _vehicle: Vehicle | None) -> Reading:
        reader = BodyReader(settings)
        return Reading(
            lambda columns, items: reader.read(
                header_stamps(columns)[items[array].message], items[array], members
            ),
            reader.dropped,
        )

    return start


_POSE = {"pose.position": 3, "pose.orientation": 4}
MOCAP4R2 = Adapter(
    name="mocap4r2",
    type_name="mocap4r2_msgs/msg/RigidBodies",
    topic="rigid_bodies",
    kind="mocap",
    columns=STAMP | of_items("rigidbodies", rigid_body_name=0, **_POSE),
    start=_bodies("rigidbodies", Members("rigid_body_name")),
)
NAMED_POSES = Adapter(
    name="named_poses",
    type_name="motion_capture_tracking_interfaces/msg/NamedPoseArray",
    topic="poses",
    kind="mocap",
    columns=STAMP | of_items("poses", name=0, **_POSE),
    start=_bodies("poses", Members("name")),
)


_MEMBERS = Members("child_frame_id", "transform.translation", "transform.rotation")
_PARENT = "header.frame_id"


def _start(settings: BodySettings, _vehicle: Vehicle | None) -> Reading:
    reader, body = BodyReader(settings), settings.body or ""

    def read(transforms: Items) -> PoseStream:
        if settings.frames == FLU_ENU:
            of_body = transforms.columns[_MEMBERS.name] == body.encode()
            _check_frames(transforms, np.flatnonzero(of_body), body)
        return reader.read(header_stamps(transforms.columns), transforms, _MEMBERS)

    return Reading(lambda _, items: read(items["transforms"]), reader.dropped)


def _check_frames(transforms: Items, rows: np.typing.NDArray[np.int64], body: str) -> None:
    """Refuse a world or a body that says z down, naming the message."""
    parents = transforms.columns[_PARENT][rows]
    for parent in np.unique(parents):
        try:
            BodyFrames.world((parent.decode(errors="replace"), body))
        except FrameRefusedError as refused:
            first = rows[int(np.argmax(parents == parent))]
            raise SampleError(int(transforms.message[first]), str(refused)) from refused


TF = Adapter(
    name="tf",
    type_name=TF_TYPE,
    topic="/tf",
    kind="mocap",
    columns=of_items(
        "transforms", **STAMP, **{_PARENT: 0, _MEMBERS.name: 0, _MEMBERS.position: 3, _MEMBERS.orientation: 4}
    ),
    start=_start,
    common=True,
)
