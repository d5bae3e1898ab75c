# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A good flight and a good model to spoil, and what it means to be refused on the command line."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.random_ensembles import FITTED, random_ensembles, simulation_inputs
from quadpi_core.errors import QuadpiError
from quadpi_core.estimator.filter_state import EstimatorStatus
from quadpi_core.flight import OdometryStream, WindStream
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.importing import import_logs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory
from quadpi_core.simulation.sensors import Fault
from quadpi_core.vehicle import Vehicle
from test.faults.onboard import Onboard, sent_by, spoilt

GOLDEN_MODEL = Path(__file__).parents[1] / "golden" / "model"
FLIGHT_S = 8.0
CUTOFF_HZ = 30.0


@pytest.fixture(scope="session")
def recording(bags):
    """A good flight with every topic that a bag can hold."""
    good = read_recording(bags[0], None)
    pose = good.pose
    velocity = np.gradient(pose.position, 1e-9 * (pose.time_ns - pose.time_ns[0]), axis=0)
    return replace(
        good,
        odometry=OdometryStream(pose.time_ns, pose.position, pose.attitude, velocity, 0.0 * velocity),
        wind=WindStream(pose.time_ns, 0.0 * velocity),
    )


@pytest.fixture(scope="session")
def short(recording):
    """Half of it."""
    end_ns = recording.imu.time_ns[len(recording.imu) // 2]
    streams = {name: getattr(recording, name) for name in ("imu", "rotor_speeds", "pose", "odometry", "wind")}
    halves = {name: stream.take(stream.time_ns < end_ns) for name, stream in streams.items()}
    return replace(recording, **halves)


@pytest.fixture
def bad(tmp_path):
    """The path of the bag that is bad."""
    return tmp_path / "bad.mcap"


@pytest.fixture(scope="session")
def model(bags, pool, tmp_path_factory):
    """The folder of a good model."""
    folder = tmp_path_factory.mktemp("models") / "model"
    vehicle = Vehicle.load("neurobem")
    flights = prepare_flights(bags[1:], vehicle, CUTOFF_HZ)
    identify(
        flights, vehicle, load_pools(pool), IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ)
    ).save(folder)
    return folder


@pytest.fixture(scope="session", params=["polynomial", *FITTED])
def each_model(request, model, bags, tmp_path_factory):
    """The folder of a good model of each method; ensembles have random weights."""
    if request.param == "polynomial":
        return model
    good = AerodynamicModel.load(model)
    X = prepare_flights(bags[:1], Vehicle.load("neurobem"), CUTOFF_HZ)[0].inputs
    inputs = {axis: simulation_inputs()[axis] for axis in good.axes}
    folder = tmp_path_factory.mktemp("models") / request.param
    replace(good, fitted=random_ensembles(request.param, X, inputs)).save(folder)
    return folder


def contents(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.fixture
def refused_by(bad, model, tmp_path):
    """refused_by(readers, message): each reader of bags refuses the bad one in one line that names it.

    That every command makes an exit status and one line of that is shown once for each command.
    """
    vehicle, out = Vehicle.load("neurobem"), tmp_path / "out"
    out.mkdir()
    readers = {
        "import": lambda: import_logs([bad], vehicle, out / "bags"),
        "prepare": lambda: prepare_flights([bad], vehicle, CUTOFF_HZ),
        "replay": lambda: replay(AerodynamicModel.load(model), vehicle, bad, out / "out.mcap"),
    }

    def run(names, message):
        for name in names:
            with pytest.raises(QuadpiError) as refusal:
                readers[name]()
            assert re.fullmatch(rf"{re.escape(str(bad))}: [^\n]*{message}[^\n]*", str(refusal.value)), name
            assert contents(out) == {}

    return run


@pytest.fixture(scope="session")
def bebop2():
    """Vehicle of the bundled bags, and the model of the golden trace, identified on the training flights."""
    return Vehicle.load("bebop2"), AerodynamicModel.load(GOLDEN_MODEL)


@pytest.fixture(scope="session")
def sensors(bebop2):
    """sensors(seconds): what the sensors sent at the beginning of a bundled flight without an alarm."""
    recording = read_recording(bags_directory() / "interpolation.mcap", bebop2[0])
    return lambda seconds=FLIGHT_S: sent_by(recording, seconds)


@pytest.fixture(scope="session")
def fly_onboard(bebop2):
    """fly_onboard(sent, …) → Flown: what estimator and monitor make of that, see :meth:`Onboard.fly`."""
    return lambda sent, *spoil, rate_hz=0.0: Onboard(*bebop2, rate_hz).fly(sent, *spoil)


@pytest.fixture(scope="session")
def calm(sensors, fly_onboard):
    """The flight without a fault: all is well, and every IMU sample from the first second on is predicted.

    The state has settled a moment after its start.
    """
    flown = fly_onboard(sensors())
    assert not flown.alarms.level.any()
    expected = flown.imu_ns[flown.imu_ns >= flown.odometry_ns[0]]
    np.testing.assert_array_equal(flown.predictions.time_ns, expected)
    assert flown.states(1.01, 1.3) == {EstimatorStatus.DEGRADED}
    assert flown.states(1.5, FLIGHT_S) == {EstimatorStatus.OK}
    return flown


@pytest.fixture
def failing(sensors, fly_onboard):
    """failing(kind, topic, at_s, for_s, …) → Flown with a fault of `quadpi_core.simulation.sensors`."""

    def fly(kind, topic, at_s, for_s, *, seconds=FLIGHT_S, **options):
        return fly_onboard(spoilt(sensors(seconds), Fault(kind, topic, at_s, for_s, **options)))

    return fly


@pytest.fixture
def altered(sensors, fly_onboard):
    """altered(topic, alter) → Flown: `alter` takes what a sensor sends, and the seconds at which."""

    def fly(topic, alter):
        sent = sensors()
        start_ns = sent["imu"].taken_ns[0]
        seconds = 1e-9 * (sent[topic].taken_ns - start_ns)
        return fly_onboard(sent | {topic: alter(sent[topic], seconds)})

    return fly
