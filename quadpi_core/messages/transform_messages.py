# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Transforms of the body as every tool that knows tf takes them: tf2_msgs/TFMessage with one transform."""

from __future__ import annotations

from quadpi_core.messages.cdr import Codec, Field
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.messages.one_by_one import OutgoingMessage

# An array of one message is its length, and then the message.
_ONE_TRANSFORM = Codec(
    TF_TYPE,
    (
        Field("transforms", "<u4"),
        Field("header.stamp.sec", "<i4"),
        Field("header.stamp.nanosec", "<u4"),
        Field("header.frame_id", "string"),
        Field("child_frame_id", "string"),
        Field("transform.translation", "<f8", 3),
        Field("transform.rotation", "<f8", 4),
    ),
)


def transform_message(world_frame: str, body_frame: str) -> OutgoingMessage:
    """A message of the transform from a world, its frame_id, to a body, its child_frame_id.

    Its values (1, 7) are the first ones of an odometry: position in the world ENU [m], and the orientation of
    the body FLU as a quaternion x, y, z, w.
    """
    constants = (("transforms", 1), ("header.frame_id", world_frame), ("child_frame_id", body_frame))
    return OutgoingMessage(_ONE_TRANSFORM, constants)
