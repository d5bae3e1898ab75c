# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The standard topics: their types exist, and what is offered on each is what bags and nodes declare."""

import pytest
from rosbags.interfaces import QosDurability, QosReliability

from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.topics import TOPIC_TYPES, qos_of
from quadpi_core.results import EVENTS_KEPT


def test_every_type_is_one_that_messages_are_made_of():
    assert set(TOPIC_TYPES.values()) <= set(typestore().types)


@pytest.mark.parametrize(
    ("topic", "depth", "reliable", "latched"),
    [
        # Two seconds of an IMU of 500 Hz.
        ("imu", 1000, False, False),
        ("mocap/pose", 1000, False, False),
        ("anything/else", 1000, False, False),
        ("odometry", 200, True, False),
        ("prediction", 200, True, False),
        ("wrench/predicted", 200, True, False),
        ("wrench/residual", 200, True, False),
        ("extrapolation_alarm", 200, True, False),
        ("alarm_log", EVENTS_KEPT, True, True),
    ],
)
def test_sensors_are_best_effort_results_reliable_and_the_log_is_kept(topic, depth, reliable, latched):
    """A reliable subscription gets nothing of a best-effort publisher, and says nothing."""
    profile = qos_of(topic).profile()
    assert profile.depth == depth
    assert (profile.reliability == QosReliability.RELIABLE) is reliable
    assert (profile.durability == QosDurability.TRANSIENT_LOCAL) is latched
