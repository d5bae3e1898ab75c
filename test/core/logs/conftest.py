# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink packets, bags, and logs of every autopilot for tests, of flights whose truth is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.fuzzing import flight_logs
from benchmarks.fuzzing.flight_logs import Flown, Sender
from quadpi_core.flight import (
    BatteryStream,
    ImuStream,
    OdometryStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    WindStream,
)
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.payloads import Topic
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

from .bag_examples import assert_same_flight

START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="session")
def mavlink_sender() -> type[Sender]:
    """A class whose instances pack messages."""
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    return Sender


@pytest.fixture(scope="session")
def mavlink_message(mavlink_sender: type[Sender]) -> Callable[..., Any]:
    """What the decoder makes of one message, by its name and fields."""

    def decoded(name: str, *values: Any) -> Any:
        from quadpi_core.logs.mavlink_frames import Framer

        (message,) = Framer().feed(mavlink_sender().packet(name, *values), complete=True)
        return message

    return decoded


@pytest.fixture(scope="session")
def flown() -> Flown:
    """A second of hovering, slowly turning and drifting."""
    return flight_logs.hover()


@pytest.fixture(scope="session")
def autopilot_logs(flown: Flown) -> dict[str, bytes]:
    """The flight as a log of every format, by its suffix."""
    pytest.importorskip("pymavlink", reason="pymavlink is not installed")
    return {
        ".BIN": flight_logs.dataflash(flown),
        ".ulg": flight_logs.ulog(flown),
        ".tlog": flight_logs.tlog(flown),
        ".bbl": flight_logs.blackbox(flown),
    }


@pytest.fixture(scope="session")
def sensor_topics() -> list[Topic]:
    """Sensors in the first two seconds of a bundled bag."""
    with Bag(bags_directory() / "interpolation.mcap") as bag:
        found = bag.read(["/imu", "/erpm", "/mocap/pose"])
    end_ns = min(topic.log_time_ns[0] for topic in found.values()) + 2 * 10**9
    return [topic.split(end_ns)[0] for topic in found.values()]


@pytest.fixture(scope="session")
def same_flight(
    sensor_topics: list[Topic], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[Path], None]:
    """same_flight(path): a log of any kind holds the flight of these sensors."""
    path, vehicle = tmp_path_factory.mktemp("bag") / "flight.mcap", Vehicle.load("bebop2")
    write_mcap(path, sensor_topics, {})
    expected = read_recording(path, vehicle)
    return lambda found: assert_same_flight(found, expected, vehicle)


@pytest.fixture
def topics() -> list[Topic]:
    """Two topics on clocks that interleave; 3000 samples need more than one chunk."""
    count, rng = 3000, np.random.default_rng(3)
    rotor_time, wind_time = np.arange(count) * 2_000_000 + 10, np.arange(count) * 7_000_000
    rotors = RotorSpeedStream(rotor_time, rng.uniform(0, 900, size=(count, 4)))
    wind = WindStream(wind_time, rng.normal(size=(count, 3)))
    big_wind_frame = sensor_messages.pack_wind(wind, frame_id="w" * 400)
    return [
        Topic(
            "/rotor_speeds",
            sensor_messages.ROTOR_SPEEDS,
            rotor_time,
            sensor_messages.pack_rotor_speeds(rotors),
        ),
        Topic("/wind", sensor_messages.WIND, wind_time, big_wind_frame),
    ]


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    """Random numbers on every topic."""
    count, rng = 40, np.random.default_rng(11)
    source = tmp_path / "flight.csv"
    source.write_text("a log\n")
    time_ns = START_NS + np.arange(count) * 2_000_000
    attitude = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return Recording(
        name="flight",
        vehicle="bebop2",
        source=str(source),
        imu=ImuStream(time_ns, rng.normal(size=(count, 3)), rng.normal(size=(count, 3))),
        rotor_speeds=RotorSpeedStream(time_ns + 300, rng.uniform(0, 900, size=(count, 4))),
        pose=PoseStream(time_ns[::4], rng.normal(size=(count // 4, 3)), attitude[::4]),
        odometry=OdometryStream(
            time_ns, *(rng.normal(size=(count, 3)), attitude, *rng.normal(size=(2, count, 3)))
        ),
        wind=WindStream(time_ns[:2], rng.normal(size=(2, 3))),
    )


@pytest.fixture(scope="session")
def vehicle() -> Vehicle:
    """That flew the logs of autopilots."""
    return replace(Vehicle.load("neurobem"), pole_pairs=7)


@pytest.fixture
def written(autopilot_logs: dict[str, bytes], tmp_path: Path) -> dict[str, Path]:
    """The files of these logs by suffix."""
    paths = {suffix: tmp_path / f"flight{suffix}" for suffix in autopilot_logs}
    for suffix, path in paths.items():
        path.write_bytes(autopilot_logs[suffix])
    return paths


@pytest.fixture
def hover() -> Recording:
    """Four seconds near hover, rolling gently to and fro."""
    rate_hz, samples, rng = 500, 2000, np.random.default_rng(3)
    time = np.arange(samples) / rate_hz
    time_ns = np.arange(samples, dtype=np.int64) * (1_000_000_000 // rate_hz)
    roll, zero = 0.2 * np.sin(2.0 * np.pi * time), np.zeros(samples)
    attitude = np.stack([np.cos(roll / 2), np.sin(roll / 2), zero, zero], axis=1)
    rates = np.stack([np.gradient(roll, time), zero, zero], axis=1) + rng.normal(0.0, 0.01, (samples, 3))
    force = np.array([0.0, 0.0, -9.81]) + rng.normal(0.0, 0.1, (samples, 3))
    # As a thrust along z moves it sideways.
    sway = -9.81 * 0.2 / (2.0 * np.pi) ** 2 * np.sin(2.0 * np.pi * time)
    position = np.stack([zero, sway, -1.0 - 0.1 * time], axis=1)
    speeds = 1570.0 + rng.normal(0.0, 10.0, (samples, 4))
    velocity = np.gradient(position, time, axis=0)
    return Recording(
        name="hover",
        vehicle="crazyflie_rpm",
        source="hover.mcap",
        imu=ImuStream(time_ns, rates, force),
        rotor_speeds=RotorSpeedStream(time_ns, speeds),
        pose=PoseStream(time_ns[::5], position[::5], attitude[::5]),
        odometry=OdometryStream(time_ns, position, attitude, velocity, rates),
        battery=BatteryStream(time_ns, np.linspace(4.0, 3.9, samples)),
    )
