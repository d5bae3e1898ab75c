# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The program that plays a bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.logs.bags import read_outputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory
from quadpi_core.results import LEVEL_ALARM, LEVEL_OK
from quadpi_core.vehicle import Vehicle
from quadpi_ros.live_session import Child, Collector
from quadpi_ros.parameters import START_TIMEOUT_S
from quadpi_ros.player import parse_arguments, start_of
from quadpi_ros.playlist import PlayerError, Playlist, live_inputs

from .rig import assert_alive

BAG = bags_directory() / "extrapolation.mcap"


def test_player_names_a_bag_that_is_not_there(
    run_main: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    status, errors = run_main("player", str(tmp_path / "none.mcap"))
    assert status == 2
    assert errors == f"quadpi: {tmp_path / 'none.mcap'}: no such bag\n"


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--rate", "0"), "argument -r/--rate: must be positive, found 0"),
        (("--clock", "-1"), "argument --clock: must be positive, found -1"),
        (("--loop", "--sent", "sent.npz"), "--sent is of a bag that is played once"),
    ],
)
def test_options_are_checked(
    arguments: tuple[str, ...], complaint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        parse_arguments((str(BAG), *arguments))
    assert complaint in capsys.readouterr().err


def test_options_that_ros2_bag_play_has_are_written_as_there() -> None:
    options = parse_arguments((str(BAG), "-r", "2", "-l", "--start-offset", "1.5", "--clock"))
    assert (options.rate, options.loop) == (2.0, True)
    assert (options.start_offset, options.clock) == (1.5, 40.0)
    assert parse_arguments((str(BAG), "--clock", "100")).clock == 100.0
    assert parse_arguments((str(BAG),)).clock is None


def test_a_start_beyond_the_end_and_a_loop_too_short_are_refused(folder: Path) -> None:
    bag = folder / "hover.mcap"
    playlist = Playlist.read(bag)

    def start(*arguments: str) -> int:
        return start_of(playlist, parse_arguments((str(bag), *arguments)))

    assert start("--start-offset", "1.5", "--loop") == 1_500_000_000
    for none in ("3.5", "-1", "nan"):
        with pytest.raises(
            PlayerError, match=rf"hover\.mcap: --start-offset {none}: what is played lasts 3 s"
        ):
            start("--start-offset", none)
    assert start("--start-offset", "2.5") == 2_500_000_000
    with pytest.raises(PlayerError, match=r"hover\.mcap: --loop: 0\.499 s are too short: .* more than 1 s"):
        start("--start-offset", "2.5", "--loop")


@pytest.mark.usefixtures("ros_domain")
def test_every_further_loop_gives_the_same(folder: Path, tmp_path: Path) -> None:
    """Nodes with simulated time: clock and stamps jump back, and each loop begins from nothing."""
    bag, model, vehicle = folder / "hover.mcap", folder / "model", "neurobem"
    replay(AerodynamicModel.load(model), Vehicle.load(vehicle), bag, tmp_path / "replayed.mcap")
    expected, expected_alarms = read_outputs(tmp_path / "replayed.mcap")
    given = {"vehicle": vehicle, "model": model, "use_sim_time": "true"}
    nodes = ("--ros-args", *(part for name, value in given.items() for part in ("-p", f"{name}:={value}")))
    played = (str(bag), "--loop", "--clock", "--topics", "imu", "rotor_speeds", "mocap/pose")
    waits = ("--nodes", "estimator", "monitor", "--wait", str(START_TIMEOUT_S))

    def loops(time_ns: np.ndarray) -> list[np.ndarray]:
        return np.split(np.arange(len(time_ns)), np.flatnonzero(np.diff(time_ns) < 0) + 1)

    with (
        Child("quadpi_ros.live_process", nodes, tmp_path) as live,
        Collector(int(expected.time_ns[0])) as collector,
        Child("quadpi_ros.player", (*played, *waits), tmp_path) as player,
    ):

        def enough() -> bool:
            return len(loops(collector.predictions().time_ns)) > 3

        while not collector.spin_until(enough, 1.0):
            assert_alive(live)
            assert not player.finished()
        predictions, alarms = collector.predictions(), collector.alarms()
    second, third = (
        {name: values[part] for name, values in vars(predictions).items()}
        for part in loops(predictions.time_ns)[1:3]
    )
    # The first loop is no measure: on a busy machine it begins before all processes run at full speed.
    for name, values in second.items():
        np.testing.assert_array_equal(third[name], values, err_msg=name)
    # The sample whose stamp jumps back only tells the estimator to begin again.
    np.testing.assert_array_equal(second["time_ns"], expected.time_ns[1:])
    _, again, *_ = (alarms.time_ns[part] for part in loops(alarms.time_ns))
    levels = [alarms.level[part] for part in loops(alarms.time_ns)]
    for part in levels[1:3]:
        assert (part.min(), part.max()) == (LEVEL_OK, LEVEL_ALARM)
    assert again[0] < expected_alarms.time_ns[0] + 100_000_000


# What of a bag is played, and what the live nodes are to listen to.


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
