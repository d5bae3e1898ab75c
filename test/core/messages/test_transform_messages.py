# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One transform in a message, as rosbags writes and reads it."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.frame_ids import TF_TYPE
from quadpi_core.messages.transform_messages import transform_message

POSE = np.array([[1.0, -2.0, 3.0, 0.1, 0.2, 0.3, np.sqrt(1.0 - 0.14)]])


@pytest.mark.parametrize("world", ["map", "odom", "earth", ""])
@pytest.mark.parametrize("body", ["base_link", "uav1/base_link", "b"])
def test_a_transform_is_read_by_others(world: str, body: str) -> None:
    message = transform_message(world, body)
    message.values[:] = POSE
    for time_ns in (5_000_000_007, 6_999_999_999):
        payload = message.stamped(time_ns)
        read = typestore().deserialize_cdr(payload, TF_TYPE)
        assert bytes(typestore().serialize_cdr(read, TF_TYPE)) == payload
        (one,) = read.transforms
        assert 10**9 * one.header.stamp.sec + one.header.stamp.nanosec == time_ns
        assert (one.header.frame_id, one.child_frame_id) == (world, body)
        p, q = one.transform.translation, one.transform.rotation
        assert [p.x, p.y, p.z, q.x, q.y, q.z, q.w] == POSE[0].tolist()
