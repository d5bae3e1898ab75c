# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A good flight and a good model to spoil, and what it means to be refused on the command line."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from quadpi_core.flight import OdometryStream, WindStream
from quadpi_core.identification import identify, prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.models import AerodynamicModel, load_pools
from quadpi_core.models.methods import METHODS
from quadpi_core.vehicle import Vehicle

CUTOFF_HZ = 30.0
POOL = """
Fx: {fixed: [u], candidates: ["P^2(u, |v|, w)"]}
Mx: {fixed: [U_p], candidates: ["P^1(p)"]}
"""


@pytest.fixture(scope="session")
def pool(tmp_path_factory):
    path = tmp_path_factory.mktemp("pool") / "pool.yaml"
    path.write_text(POOL)
    return path


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
    identify(flights, vehicle, load_pools(pool), cutoff_hz=CUTOFF_HZ).save(folder)
    return folder


@pytest.fixture(scope="session", params=METHODS)
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


@pytest.fixture
def refused(quadpi, tmp_path):
    """refused(message, command, …): the command fails as it should and leaves the folder as it was."""

    def run(message, *arguments):
        before = contents(tmp_path)
        result = quadpi(*arguments)
        assert result.status == 2, result
        assert re.fullmatch(rf"quadpi: [^\n]*{message}[^\n]*\n", result.errors), result.errors
        assert contents(tmp_path) == before

    return run


def contents(folder):
    return {path: path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


@pytest.fixture
def refused_everywhere(refused, bad, bags, model, pool, tmp_path):
    """Every command that uses a flight refuses it with the same message, which names the file."""

    def run(message, commands=("import", "identify", "evaluate", "replay")):
        vehicle = ("--vehicle", "neurobem")
        arguments = {
            "import": (bags[1], bad, *vehicle, "-o", tmp_path / "bags"),
            "identify": (bags[1], bad, *vehicle, "--candidates", pool, "-o", tmp_path / "model"),
            "evaluate": (model, bags[1], bad, "--json", tmp_path / "data.json", "--html", tmp_path / "page"),
            "replay": (model, bad, "-o", tmp_path / "out.mcap", "--json", tmp_path / "data.json"),
        }
        for command in commands:
            refused(f"{re.escape(str(bad))}: {message}", command, *arguments[command])

    return run
