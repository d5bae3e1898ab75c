# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What of a bag is played, and what the live nodes are to listen to."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from quadpi_core.paths import bags_directory
from quadpi_ros.player import PlayerError, live_inputs

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


def test_player_names_a_bag_that_is_not_there(
    run_main: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    status, errors = run_main("player", str(tmp_path / "none.mcap"))
    assert status == 2
    assert errors == f"quadpi: {tmp_path / 'none.mcap'}: no such bag\n"
