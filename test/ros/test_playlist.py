# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What of a bag is played, and what the live nodes are to listen to."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.paths import bags_directory
from quadpi_ros.playlist import PlayerError, Playlist, live_inputs

BAG = bags_directory() / "extrapolation.mcap"


def test_the_live_nodes_hear_what_the_bag_holds() -> None:
    inputs = live_inputs(BAG)
    assert (inputs.rotor_topic, inputs.mocap_topic) == ("erpm", "mocap/pose")
    assert inputs.topics[:3] == ("imu", "erpm", "mocap/pose")


@pytest.mark.parametrize(
    ("named", "message"),
    [
        (("imu", "rotor_speeds", "mocap/pose"), "topic rotor_speeds: the bag does not hold it"),
        (("imu", "erpm", "mocap/pose", "mavros_status"), "topic mavros_status: the bag does not hold it"),
        (("imu", "rpm", "mocap/pose"), "topic rpm: not known; known: imu, "),
        (("imu", "erpm"), "topic mocap/pose: the live nodes need it"),
    ],
)
def test_topics_that_are_asked_for_must_be_there(named: tuple[str, ...], message: str) -> None:
    with pytest.raises(PlayerError, match=message):
        live_inputs(BAG, named)


def test_messages_are_in_the_order_of_their_log_times() -> None:
    playlist = Playlist.read(BAG, ("erpm", "imu=/imu"))
    assert list(playlist.topics) == ["erpm", "imu"]
    assert (np.diff(playlist.due_ns) >= 0).all()
    for index, topic in enumerate(playlist.topics.values()):
        mine = playlist.topic == index
        np.testing.assert_array_equal(playlist.start_ns + playlist.due_ns[mine], topic.log_time_ns)
        np.testing.assert_array_equal(playlist.message[mine], np.arange(len(topic.log_time_ns)))
