# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""tf2_msgs/TFMessage: the transform from the world to one child frame, the body, among all that are sent."""

from __future__ import annotations

import numpy as np

from quadpi_core.errors import SampleError
from quadpi_core.flight import PoseStream
from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, Reading, of_items
from quadpi_core.messages.adapters.adapter_settings import FLU_ENU, BodySettings
from quadpi_core.messages.adapters.packages.rigid_bodies import BodyReader, Members
from quadpi_core.messages.cdr import header_stamps
from quadpi_core.messages.foreign_messages import Items
from quadpi_core.messages.frame_ids import TF_TYPE, BodyFrames, FrameRefusedError
from quadpi_core.vehicle import Vehicle

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
    """Refuse a world or a body that says z down.

    Raises:
        SampleError: naming the message.
    """
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
