# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags with motor commands and no rotor speeds, from `identify` to `replay`."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.identification.commanded_flights import prepare_with_motors
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.library.flights import load_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import read_outputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kinds.physical import Physical
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.paths import bags_directory
from quadpi_core.reading_options import ReadingOptions, TimeRange
from quadpi_core.vehicle import Vehicle

from ..commanded_bags import LAG_S, write_bag
from ..messages.adapters.vendor_messages import DEFINITIONS, Messages

FLIGHTS = ("train_1", "train_2", "train_3", "train_4")
SECONDS = 14.0


@pytest.fixture(scope="module")
def recordings():
    """Four bundled flights of the simulated Bebop 2."""
    part = ReadingOptions(part=TimeRange(0.0, SECONDS))
    vehicle = Vehicle.load("bebop2")
    return [
        replace(read_recording(bags_directory() / f"{name}.mcap", vehicle, part), name=name)
        for name in FLIGHTS
    ]


@pytest.fixture(scope="module", params=["px4_motors", "mavros_rc_out"])
def bags(recordings, request, tmp_path_factory):
    """The last one with rotor speeds where the first of two autopilots flew, else none."""
    folder, messages = tmp_path_factory.mktemp("bags"), Messages(DEFINITIONS)
    with_speeds = request.param == "px4_motors"
    return request.param, [
        write_bag(folder / one.name, messages, one, request.param, measured=with_speeds and place > 1)
        for place, one in enumerate(recordings)
    ]


@pytest.mark.slow
def test_flights_without_rotor_speeds_become_a_model_that_replays(bags, recordings, tmp_path, quadpi):
    adapter, paths = bags
    model = tmp_path / "model"
    told = quadpi(
        "identify", *paths, "--vehicle", "bebop2", "-o", model, "--method", "polynomial", "--axes", "Fz,Mx"
    )
    assert told.status == 0, told.errors
    said = " ".join(told.output.split())
    assert f"rotor speeds of all flights are made of their motor commands ({adapter})" in said
    assert ("by 2 flights with rotor speeds" if adapter == "px4_motors" else "their scale is assumed") in said
    motors = AerodynamicModel.load(model).load_vehicle("bebop2").motors
    assert motors.source == adapter
    assert motors.lag_s == pytest.approx(LAG_S, abs=0.012)

    vehicle = replace(Vehicle.load("bebop2"), motors=motors)
    truth, found = recordings[0].rotor_speeds, read_recording(paths[0], vehicle).rotor_speeds
    speeds = np.stack(
        [np.interp(truth.time_ns, found.time_ns, found.speeds[:, rotor]) for rotor in range(4)], axis=1
    )
    scale = np.sum(speeds * truth.speeds) / np.sum(speeds**2)
    assert scale == pytest.approx(1.0, abs=0.02 if adapter == "px4_motors" else 0.6)
    error = np.sqrt(np.mean((scale * speeds - truth.speeds)[200:-200] ** 2)) / np.mean(truth.speeds)
    assert error < (0.012 if adapter == "px4_motors" else 0.06)

    output, summary = tmp_path / "replayed.mcap", tmp_path / "summary.json"
    replayed = quadpi("replay", model, paths[0], "-o", output, "--json", summary)
    assert replayed.status == 0, replayed.errors
    predictions, _ = read_outputs(output)
    assert len(predictions.time_ns) > 0.8 * len(recordings[0].imu)
    assert json.loads(summary.read_text())


def test_the_library_says_that_speeds_are_made_of_commands(bags, caplog):
    _, paths = bags
    flights = load_flights([str(path) for path in paths[:2]], "bebop2")
    assert flights.vehicle.motors is not None
    assert "rotor speeds of all flights are made of their motor commands" in caplog.text


def test_real_flights_by_commands_err_and_cover_as_by_tachometers(shared_data):
    """A Crazyflie with an RPM deck, with and without it; on flights that neither model knows."""
    paths = sorted((shared_data / "imrc_brushless").glob("eckart*"))
    learned, unseen, vehicle = paths[:7], paths[7:17], Vehicle.load("crazyflie_rpm")
    results, options = {}, IdentifyOptions(method=Physical(multi_step=False))
    for from_commands in (False, True):
        read = prepare_with_motors(learned, vehicle, 30.0, from_commands=from_commands)
        model = identify(read.flights, read.vehicle, load_pools("quadrotor"), options)
        flights = prepare_flights(unseen, read.vehicle)
        results[from_commands] = [(model.evaluate(flight), flight.wrench) for flight in flights]

    def figures(judged):
        errors = [told.predicted - wrench for told, wrench in judged]
        held = [(told.lower <= wrench) & (wrench <= told.upper) for told, wrench in judged]
        return np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)), np.mean(np.concatenate(held), axis=0)

    (measured, _), (commanded, coverage) = figures(results[False]), figures(results[True])
    # Goals of three forces and three moments.
    assert np.all(commanded / measured <= [1.1, 1.1, 1.1, 1.3, 1.1, 2.0])
    assert np.all(coverage >= 0.93)
