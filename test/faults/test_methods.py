# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What no method can be identified on, and what training needs: exit status 2, one line, no model left."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.flight import OdometryStream
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.models import kinds
from quadpi_core.models.ensemble import Ensemble
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.plugins import names_in
from quadpi_core.vehicle import Vehicle
from test.conftest import run_without_torch

pytestmark = pytest.mark.slow

METHODS = names_in(kinds)
ENSEMBLES = [method for method in METHODS if isinstance(kind_named(method), Ensemble)]
# With the settings that each method has.
SETTINGS = [
    (method, settings)
    for method in METHODS
    for settings in ("default", "paper")
    if settings == "default" or kind_named(method).has_paper_settings
]


def can_be_identified(method):
    """Skip what this environment cannot train."""
    if method in ENSEMBLES:
        pytest.importorskip("torch", reason="training needs PyTorch")


@pytest.fixture(params=METHODS)
def method(request):
    """Each method that can be identified here."""
    can_be_identified(request.param)
    return request.param


@pytest.fixture
def unread(tmp_path):
    """What is noticed too late if it is noticed after this flight."""
    return tmp_path / "is_not_there.mcap"


def test_one_flight_is_too_few_to_calibrate(refused, bags, tmp_path, method):
    message = (
        "too few flights: 1 given, 2 or more needed to calibrate; --settings paper takes one, uncalibrated"
    )
    options = ("--vehicle", "neurobem", "--method", method, "-o", tmp_path / "model")
    refused(message, "identify", bags[0], *options)


@pytest.mark.parametrize(("method", "settings"), SETTINGS)
def test_no_flight_at_all(method, settings):
    can_be_identified(method)
    with pytest.raises(ModelError, match=r"flights.* needed"):
        identify(
            [],
            Vehicle.load("neurobem"),
            load_pools("quadrotor"),
            IdentifyOptions(cutoff_hz=30.0, method=method, settings=settings),
        )


@pytest.fixture(scope="module")
def sliding(bags, tmp_path_factory):
    """Flights that slide without turning: no moment is measured, and no force to the side."""
    folder = tmp_path_factory.mktemp("sliding")
    flights = [folder / bag.name for bag in bags[:2]]
    for bag, path in zip(bags, flights, strict=False):
        good = read_recording(bag, None)
        stamps, position, still = good.pose.time_ns, good.pose.position, 0.0 * good.pose.position
        level = np.tile([1.0, 0.0, 0.0, 0.0], (len(stamps), 1))
        force = np.zeros_like(good.imu.specific_force)
        force[:, 0], force[:, 2] = 0.1 * np.sin(0.01 * np.arange(len(force))), -9.81
        imu = replace(good.imu, angular_velocity=0.0 * force, specific_force=force)
        odometry = OdometryStream(stamps, position, level, still, still)
        write_bag(path, replace(good, imu=imu, pose=None, odometry=odometry))
    return flights


@pytest.mark.parametrize(("method", "settings"), SETTINGS)
def test_constant_target_is_named(refused, sliding, tmp_path, method, settings):
    can_be_identified(method)
    options = ("--vehicle", "neurobem", "--method", method, "--settings", settings, "-o", tmp_path / "model")
    message = "Mz: the target is constant: there is nothing to identify"
    refused(message, "identify", *sliding, "--axes", "Mz", *options)


def test_a_method_of_all_axes_names_one_that_was_not_asked_for(refused, sliding, tmp_path):
    options = ("--vehicle", "neurobem", "--method", "physical", "-o", tmp_path / "model")
    message = "Fy: the target is constant: there is nothing to identify"
    refused(message, "identify", *sliding, "--axes", "Fx", *options)


def test_samples_that_are_not_finite_are_counted(bags, method):
    """Of flights that were prepared elsewhere: those that quadpi reads are refused as they are read."""
    vehicle = Vehicle.load("neurobem")
    flights = prepare_flights(bags[:2], vehicle, 30.0)
    flights[1].wrench[[7, 9], 2] = np.nan
    flights[1].inputs[9, 0] = np.inf
    message = rf"^flight1: 2 of {len(flights[1].time)} samples are not finite, the first is sample 7$"
    with pytest.raises(ModelError, match=message):
        identify(flights, vehicle, load_pools("quadrotor"), IdentifyOptions(cutoff_hz=30.0, method=method))


@pytest.mark.parametrize("method", [method for method in METHODS if method != "polynomial"])
def test_stop_rule_of_another_method(refused, unread, tmp_path, method):
    options = ("--vehicle", "neurobem", "--method", method, "--stop", "pse", "-o", tmp_path / "model")
    refused(f"--stop: an option of --method polynomial, not of {method}", "identify", unread, *options)


@pytest.mark.parametrize("method", ENSEMBLES)
def test_inputs_missing_from_the_candidates(refused, unread, pool, tmp_path, method):
    options = ("--vehicle", "neurobem", "--method", method, "--candidates", pool, "-o", tmp_path / "model")
    refused("Fx: the candidate file lists no `inputs` for networks", "identify", unread, *options)


@pytest.mark.parametrize("method", ENSEMBLES)
def test_graphics_card_that_is_not_there(refused, unread, tmp_path, method):
    torch = pytest.importorskip("torch")
    if torch.cuda.is_available():
        pytest.skip("there is one")
    options = ("--vehicle", "neurobem", "--method", method, "--device", "cuda", "-o", tmp_path / "model")
    refused("device 'cuda' is not there: ", "identify", unread, *options)


@pytest.mark.parametrize("method", ENSEMBLES)
def test_training_without_pytorch_names_the_extra(unread, tmp_path, method):
    options = ("--vehicle", "neurobem", "--method", method, "-o", tmp_path / "model")
    command = "from quadpi_core.cli import main\nmain()"
    ran = run_without_torch(command, "identify", unread, *options)
    message = "quadpi: training needs PyTorch, installed by quadpi-monitor[train]: No module named 'torch'\n"
    assert (ran.returncode, ran.stdout, ran.stderr) == (2, "", message)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("method", [(), ("--method", "polynomial")])
def test_flights_without_rotor_speeds_serve_no_method(refused, bags, tmp_path, method):
    flights = [tmp_path / bag.name for bag in bags[:2]]
    for bag, path in zip(bags, flights, strict=False):
        write_bag(path, replace(read_recording(bag, None), rotor_speeds=None))
    options = ("--vehicle", "neurobem", *method, "-o", tmp_path / "model")
    message = "flight0.mcap: topic rotor_speeds is missing, which every kind of model needs"
    refused(message, "identify", *flights, *options)


def test_rotor_speeds_that_pause_are_named(quadpi, bags, tmp_path):
    good, path = read_recording(bags[0], None), tmp_path / "pause.mcap"
    rotors = good.rotor_speeds
    measured = np.abs(rotors.time_ns - rotors.time_ns[len(rotors.time_ns) // 2]) > 250_000_000
    paused = replace(rotors, time_ns=rotors.time_ns[measured], speeds=rotors.speeds[measured])
    write_bag(path, replace(good, rotor_speeds=paused))
    options = ("--vehicle", "neurobem", "-o", tmp_path / "model")
    identified = quadpi("identify", path, bags[1], *options)
    assert identified.status == 0
    assert re.search(
        r"pause: topic rotor_speeds: pauses from [\d.]+ to [\d.]+ s at sample 1500", identified.output
    )
    assert re.search(r"pause: topic imu: left out 2\d\d of \d+ samples while the rotor", identified.output)
