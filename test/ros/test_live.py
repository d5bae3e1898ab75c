# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live nodes over real DDS, fed by the player from a small bag."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.flight import AXES, ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.inputs import aerodynamic_inputs
from quadpi_core.logs.bags import read_outputs, write_bag
from quadpi_core.models import AerodynamicModel, FittedPolynomial
from quadpi_core.models.regressors import Regressor, RegressorProgram
from quadpi_core.models.rules import ResidualRule
from quadpi_core.models.spread import SpreadShape
from quadpi_core.monitor.alarm import LEVEL_ALARM
from quadpi_core.monitor.envelope import Envelope
from quadpi_core.monitor.replay import replay
from quadpi_core.vehicle import Vehicle

pytest.importorskip("quadpi.msg", reason="the quadpi messages are not built")

from quadpi_ros.collector import AlarmChange, Collector
from quadpi_ros.processes import ChildError
from quadpi_ros.session import SessionError, SessionResult, run_session

VEHICLE = "neurobem"
START_NS = 1_700_000_000_000_000_000
DURATION_S = 4.0
OUTSIDE_FROM_S = 3.0
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def stamps(rate_hz: float) -> np.ndarray:
    return START_NS + np.round(np.arange(DURATION_S * rate_hz) * 1e9 / rate_hz).astype(np.int64)


def hovering(vehicle: Vehicle, seed: int) -> Recording:
    """Hover, rotors swinging a little; from OUTSIDE_FROM_S on they turn far faster than ever trained."""
    rng = np.random.default_rng(seed)
    imu_ns, rotor_ns, pose_ns = stamps(500.0), stamps(500.0) + 700_000, stamps(120.0)
    time_s = 1e-9 * (rotor_ns - START_NS)
    swing = np.stack([np.sin(7.0 * time_s + phase) for phase in range(4)], axis=1)
    speeds = 1100.0 + 60.0 * swing + 5.0 * rng.standard_normal(swing.shape)
    speeds[time_s >= OUTSIDE_FROM_S] += 600.0
    gravity = np.array([0.0, 0.0, -vehicle.gravity_m_s2])
    return Recording(
        name="hover",
        vehicle=vehicle.name,
        source="hover",
        imu=ImuStream(
            imu_ns,
            0.02 * rng.standard_normal((len(imu_ns), 3)),
            gravity + 0.3 * rng.standard_normal((len(imu_ns), 3)),
        ),
        rotor_speeds=RotorSpeedStream(rotor_ns, speeds),
        pose=PoseStream(
            pose_ns, 0.002 * rng.standard_normal((len(pose_ns), 3)), np.tile(LEVEL, (len(pose_ns), 1))
        ),
    )


def trained_on_hover(vehicle: Vehicle) -> AerodynamicModel:
    """Fx and Mz of a few terms, whose envelope is the undisturbed hover."""
    rng = np.random.default_rng(2)
    count = 2000
    inputs = aerodynamic_inputs(
        0.1 * rng.standard_normal((count, 3)),
        np.tile(LEVEL, (count, 1)) + 0.01 * rng.standard_normal((count, 4)),
        0.05 * rng.standard_normal((count, 3)),
        1100.0 + 60.0 * rng.uniform(-1.2, 1.2, (count, 4)),
        vehicle,
    )
    polynomials = {}
    for axis, terms in {"Fx": ("1", "u"), "Mz": ("1", "U_r")}.items():
        regressors = tuple(Regressor.parse(term) for term in terms)
        z = RegressorProgram.compile(regressors).evaluate(inputs)
        whitening = np.linalg.inv(np.linalg.cholesky(z.T @ z))
        rule = ResidualRule(0.2, 500.0)
        polynomials[axis] = FittedPolynomial(
            regressors, np.array([0.1, 0.01]), whitening, SpreadShape(1.0, 0.0), rule, 1.0
        )
    leverage, width = np.zeros((count, len(AXES))), np.zeros((count, len(AXES)))
    for axis, polynomial in polynomials.items():
        leverage[:, AXES.index(axis)] = polynomial.leverage(inputs)
        width[:, AXES.index(axis)] = polynomial.spread(inputs)
    return AerodynamicModel(
        name="hover",
        vehicle=vehicle.name,
        vehicle_fingerprint=vehicle.fingerprint,
        settings="default",
        cutoff_hz=30.0,
        confidence=0.95,
        fitted=polynomials,
        envelope=Envelope.fit(inputs, np.zeros(count), leverage, width),
        training_range=dict.fromkeys(polynomials, 1.0),
        flights=(),
        selection={axis: [] for axis in polynomials},
        held_out_coverage={axis: [] for axis in polynomials},
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """hover.mcap, blind.mcap without mocap, and model/."""
    folder = tmp_path_factory.mktemp("live")
    vehicle = Vehicle.load(VEHICLE)
    recording = hovering(vehicle, seed=1)
    write_bag(folder / "hover.mcap", recording)
    write_bag(folder / "blind.mcap", replace(recording, pose=None))
    trained_on_hover(vehicle).save(folder / "model")
    return folder


@pytest.fixture(scope="module")
def heard() -> list[AlarmChange]:
    return []


@pytest.fixture(scope="module")
def session(folder: Path, heard: list[AlarmChange]) -> SessionResult:
    return run_session(folder / "hover.mcap", folder / "model", vehicle=VEHICLE, on_alarm=heard.append)


def test_every_imu_sample_gets_its_prediction(session: SessionResult) -> None:
    assert session.dropped == 0
    expected = stamps(500.0)
    assert len(session.imu_stamps_ns) == len(expected)
    initialised = expected[expected >= session.odometry.time_ns[0]]
    np.testing.assert_array_equal(session.odometry.time_ns, initialised)
    np.testing.assert_array_equal(session.predictions.time_ns, initialised)
    assert initialised[0] - START_NS < 1.1e9


def test_what_comes_out_is_finite_and_ordered(session: SessionResult) -> None:
    predictions = session.predictions
    held = [AXES.index("Fx"), AXES.index("Mz")]
    assert (predictions.lower[:, held] < predictions.predicted[:, held]).all()
    assert (predictions.predicted[:, held] < predictions.upper[:, held]).all()
    assert not np.delete(predictions.predicted, held, axis=1).any()
    assert np.isfinite(predictions.measured).all()
    np.testing.assert_allclose(np.linalg.norm(session.odometry.attitude, axis=1), 1.0)
    assert np.abs(session.odometry.velocity).max() < 0.5


def test_the_alarm_comes_when_the_rotors_leave_the_envelope(
    session: SessionResult, heard: list[AlarmChange]
) -> None:
    summary = session.summary()
    assert summary["alarm_first_s"] == pytest.approx(OUTSIDE_FROM_S + 0.1, abs=0.1)
    assert 0.1 < summary["alarm_fraction"] < 0.5
    assert (session.alarms.level[session.alarms.time_ns < START_NS + 2.9e9] < LEVEL_ALARM).all()
    raised = [change for change in heard if change.level == LEVEL_ALARM]
    assert raised
    assert raised[0].causes == ("extrapolation",)
    assert "omega_avg" in raised[0].inputs_outside
    assert "ALARM" in str(raised[0])


def test_the_summary_counts(session: SessionResult) -> None:
    summary = session.summary()
    assert summary["samples_in"] == DURATION_S * 500
    assert summary["predictions_out"] == len(session.predictions.time_ns)
    assert 0.0 < summary["latency_ms_p50"] <= summary["latency_ms_p99"]


def test_live_equals_replay(session: SessionResult, folder: Path) -> None:
    output = folder / "replayed.mcap"
    replay(AerodynamicModel.load(folder / "model"), Vehicle.load(VEHICLE), folder / "hover.mcap", output)
    predictions, alarms = read_outputs(output)
    for item in fields(predictions):
        np.testing.assert_allclose(
            getattr(session.predictions, item.name), getattr(predictions, item.name), rtol=1e-9, atol=1e-12
        )
    np.testing.assert_array_equal(session.alarms.time_ns, alarms.time_ns)
    np.testing.assert_array_equal(session.alarms.level, alarms.level)
    assert session.alarms.inputs_outside == alarms.inputs_outside


@pytest.mark.usefixtures("ros_domain")
def test_nodes_in_processes_of_their_own(folder: Path) -> None:
    nodes = {
        "estimator_node": ["-p", f"vehicle:={VEHICLE}"],
        "monitor_node": ["-p", f"vehicle:={VEHICLE}", "-p", f"model:={folder / 'model'}"],
    }
    children = [
        subprocess.Popen([sys.executable, "-m", f"quadpi_ros.{module}", "--ros-args", *arguments])
        for module, arguments in nodes.items()
    ]
    try:
        with Collector(START_NS) as collector:
            assert collector.spin_until(lambda: collector.connected, 60.0)
            player = subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    "quadpi_ros.player",
                    str(folder / "hover.mcap"),
                    "--topics",
                    "imu",
                    "rotor_speeds",
                    "mocap/pose",
                ]
            )
            children.append(player)
            collector.spin_until(lambda: player.poll() is not None, 20.0)
            collector.spin_until(lambda: collector.silent_for(0.5), 5.0)
            predictions, odometry = collector.predictions(), collector.odometry()
    finally:
        for child in children:
            child.terminate()
    assert [child.wait(10.0) for child in children] == [0, 0, 0]
    assert len(predictions.time_ns) > 1000
    assert np.isin(predictions.time_ns, odometry.time_ns).all()


def test_a_missing_model_is_one_line_and_leaves_nothing_behind(folder: Path) -> None:
    before = dict(os.environ)
    start = time.monotonic()
    with pytest.raises(ChildError, match="no_such_model") as caught:
        run_session(folder / "hover.mcap", folder / "no_such_model", vehicle=VEHICLE)
    assert "\n" not in str(caught.value)
    assert os.environ == before
    assert time.monotonic() - start < 60.0


def test_a_bag_without_mocap_is_refused(folder: Path) -> None:
    with pytest.raises(SessionError, match=r"blind\.mcap: topic mocap/pose"):
        run_session(folder / "blind.mcap", folder / "model", vehicle=VEHICLE)
