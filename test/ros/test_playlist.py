# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What of a bag is played, and what the live nodes are to listen to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadpi_core.messages.sensor_messages import unpack_stamps
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


def test_what_was_sent_is_stored_by_topic_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """numpy below 2.1 stores every keyword as an array, also an option that later versions know."""
    given: dict[str, object] = {}
    playlist = Playlist.read(BAG, ("imu", "erpm"))
    sent_ns = np.zeros(len(playlist), dtype=np.int64)
    sent_ns[:100] = 7 * np.arange(1, 101)
    playlist.save_sent(tmp_path / "sent.npz", sent_ns)
    with np.load(tmp_path / "sent.npz") as stored:
        assert sorted(stored.files) == ["erpm", "imu"]
        assert sorted(np.concatenate([stored[name][:, 1] for name in stored.files])) == sent_ns[:100].tolist()
        imu = stored["imu"]
    of_imu = playlist.topic[:100] == playlist.names.index("imu")
    np.testing.assert_array_equal(imu[:, 1], sent_ns[:100][of_imu])
    np.testing.assert_array_equal(imu[:, 0], unpack_stamps(playlist.by_name()["imu"].payloads)[: len(imu)])
    monkeypatch.setattr(np, "savez", lambda _, **arrays: given.update(arrays))
    playlist.save_sent(tmp_path / "again.npz", sent_ns)
    assert sorted(given) == ["erpm", "imu"]
