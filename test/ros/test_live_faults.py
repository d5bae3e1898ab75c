# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Faults of publishers, clocks and files around running nodes, over real DDS; see test/faults/README.md."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from quadpi.msg import ExtrapolationAlarm
from quadpi.srv import LoadModel
from rclpy.serialization import deserialize_message

from benchmarks.process_usage import resident_bytes
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_folder import ARRAYS_FILE
from quadpi_core.paths import bags_directory
from quadpi_core.results import BAD_DATA
from quadpi_core.simulation.sensors import Fault
from quadpi_core.vehicle import Vehicle
from quadpi_ros.live_session import Child, run_session
from test.faults.onboard import Onboard, sent_by, spoilt

from .rig import STARTED_S, STEP_NS, Rig, arguments, assert_alive, assert_whole

pytestmark = pytest.mark.usefixtures("ros_domain")

YEAR_NS = 365 * 86_400 * 10**9
GROWTH_MAX = 20 * 2**20
GOLDEN_MODEL = Path(__file__).parents[1] / "golden" / "model"


@pytest.fixture(scope="module")
def flying(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model folder that tests may spoil."""
    copy = tmp_path_factory.mktemp("flying") / "model"
    shutil.copytree(folder / "model", copy)
    return copy


@pytest.fixture(scope="module")
def live(ros_domain: int, flying: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Child]:
    del ros_domain
    with Child("quadpi_ros.live_process", arguments(str(flying)), tmp_path_factory.mktemp("err")) as nodes:
        yield nodes


@pytest.fixture
def rig(running: Rig) -> Iterator[Rig]:
    """The vehicle in the air, ten seconds after whatever came before; the nodes outlive every test."""
    running.now_ns += 10_000_000_000
    running.fly(STARTED_S)
    running.fly_until_heard("odometry", "prediction")
    running.forget()
    yield running
    assert_alive(running.nodes)


def reasons(rig: Rig) -> set[str]:
    """Why the alarm says BAD_DATA."""
    alarms = [
        deserialize_message(payload, ExtrapolationAlarm) for payload in rig.heard["extrapolation_alarm"]
    ]
    return {text for alarm in alarms if alarm.causes & BAD_DATA for text in alarm.reasons}


def refused(rig: Rig, name: str) -> dict[str, int]:
    """What a topic's last status says of refused messages."""
    status = rig.latest(name)
    assert status is not None
    return {
        v.key.removeprefix("refused: "): int(v.value) for v in status.values if v.key.startswith("refused: ")
    }


def test_flood(rig: Rig, live: Child) -> None:
    """Each message ten times, for a second; the copies are refused, and what comes after is whole."""
    before = resident_bytes(live.pid)

    def ten_times(_: int, sample: dict[str, Any]) -> dict[str, Any]:
        payloads = {
            "imu": sensor_messages.pack_imu(sample["imu"]),
            "rotor_speeds": sensor_messages.pack_rotor_speeds(sample["rotor_speeds"]),
        }
        for _ in range(9):
            for topic, payload in payloads.items():
                rig.send(topic, payload)
        return sample

    first_ns, last_ns = rig.fly(1.0, ten_times)
    rig.await_status("estimator: imu", DiagnosticStatus.WARN, "samples refused")
    # The first status may be from amid the flood.
    rig.until(lambda: refused(rig, "estimator: imu")["stamp not advancing"] > 1000)
    span = rig.fly(STARTED_S + 0.5)
    assert_whole(rig, "prediction", span[1] - 200 * STEP_NS, span[1])
    stamps = rig.stamps("prediction", first_ns, last_ns)
    assert len(stamps) > 0
    assert (np.diff(stamps) > 0).all()
    assert resident_bytes(live.pid) - before < GROWTH_MAX


@pytest.mark.parametrize("topic", ["imu", "rotor_speeds", "mocap/pose"])
def test_stamps_a_year_ahead(rig: Rig, topic: str) -> None:
    def ahead(_: int, sample: dict[str, Any]) -> dict[str, Any]:
        return sample | {topic: replace(sample[topic], time_ns=sample[topic].time_ns + YEAR_NS)}

    rig.fly(0.5, ahead)
    span = rig.fly(STARTED_S + 0.7)
    assert_whole(rig, "prediction", span[1] - 200 * STEP_NS, span[1])
    rig.await_status("estimator: filter", DiagnosticStatus.OK, "ok")
    if topic == "imu":
        assert any(text.endswith("s, or its clock differs") for text in reasons(rig))
        assert {"stamp jumped", "reset"} <= refused(rig, "estimator: imu").keys()


def test_the_vehicle_side_starts_again_in_flight(rig: Rig) -> None:
    """Its publishers fall silent, and others come in their place."""
    stopped_s = time.monotonic()
    rig.await_status("estimator: state", DiagnosticStatus.ERROR, "nothing arrives on imu, mocap/pose")
    rig.restart_sensors()
    rig.now_ns += round(1e9 * (time.monotonic() - stopped_s))
    first_ns, last_ns = rig.fly(STARTED_S + 0.5)
    assert_whole(rig, "prediction", first_ns + round(1e9 * STARTED_S), last_ns)
    assert any("missing" in text for text in reasons(rig))


def test_a_model_file_that_changes_in_flight(rig: Rig, flying: Path) -> None:
    """What flies is in memory; a file that was altered, or is gone, is refused by name."""
    arrays = flying / ARRAYS_FILE
    whole = arrays.read_bytes()
    arrays.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    answer = rig.call_later(LoadModel, "monitor/load_model", LoadModel.Request(path=str(flying)))
    first_ns, _ = rig.fly(0.5)
    altered = answer()
    assert not altered.success
    assert f"{flying}: {ARRAYS_FILE}: its hash is not the one in" in altered.message
    shutil.rmtree(flying)
    answer = rig.call_later(LoadModel, "monitor/load_model", LoadModel.Request(path=str(flying)))
    _, last_ns = rig.fly(0.5)
    missing = answer()
    assert not missing.success
    assert str(flying) in missing.message
    assert missing.model == altered.model
    assert_whole(rig, "prediction", first_ns, last_ns)


def test_the_flights_of_test_faults_are_what_the_nodes_do(tmp_path: Path) -> None:
    """A gyro without numbers, a pause of the IMU and one of the rotor speeds: the same rows over DDS."""
    recording = read_bag(bags_directory() / "interpolation.mcap", Vehicle.load("bebop2"))
    sent = spoilt(
        sent_by(replace(recording, arrivals={}), 5.5),
        Fault("not_finite", "imu", 1.6, 0.03, signal="angular_velocity"),
        Fault("dropout", "imu", 2.2, 0.3),
        Fault("dropout", "rotor_speeds", 4.2, 0.3),
    )
    imu, pose, rotor_speeds = (sent[topic].stream for topic in ("imu", "mocap/pose", "rotor_speeds"))
    bag = tmp_path / "faults.mcap"
    write_bag(bag, replace(recording, arrivals={}, imu=imu, pose=pose, rotor_speeds=rotor_speeds))
    session = run_session(bag, GOLDEN_MODEL, vehicle="bebop2")
    flown = Onboard(Vehicle.load("bebop2"), AerodynamicModel.load(GOLDEN_MODEL)).fly(sent)
    np.testing.assert_array_equal(session.predictions.time_ns, flown.predictions.time_ns)
    for name in ("predicted", "lower", "upper", "measured"):
        np.testing.assert_allclose(
            getattr(session.predictions, name), getattr(flown.predictions, name), rtol=1e-9, atol=1e-9
        )
    np.testing.assert_array_equal(session.alarms.time_ns, flown.alarms.time_ns)
    np.testing.assert_array_equal(session.alarms.cause_level, flown.alarms.cause_level)
    assert {"sample not finite", "gap in the samples"} <= set().union(*session.alarms.reasons)
