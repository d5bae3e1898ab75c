# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A small validation: two simulated flights, and a polynomial identified on one of them under noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import Flight
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.inputs import flight_derivatives, flight_inputs
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import CandidatePool
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import StateNoise, contaminate
from quadpi_core.simulation.simulated_bags import fly_plan
from quadpi_core.validation.validation_case import ValidationCase
from quadpi_core.vehicle import Vehicle

SCENARIO = """
description: two short flights
vehicle: bebop2
seed: 3
duration_s: 3
flights:
  ahead: {motion: {x: [{sine: {amplitude_m: 0.6, frequency_hz: 0.7, start_s: 0}}]}}
  up: {motion: {height: [{sine: {amplitude_m: 0.3, frequency_hz: 0.8, start_s: 0}}]}}
"""
POOLS = {
    "Fx": CandidatePool.parse(["mu_x"], ["P^2(mu_x, mu_z)"]),
    "Fz": CandidatePool.parse(["omega_avg"], ["P^2(omega_avg)"]),
}
NOISE = StateNoise(velocity=0.03, attitude=0.01, rates=0.01, specific_force=0.03, rotor_speeds=5.0)


@pytest.fixture(scope="session")
def scenario(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenario") / "short.yaml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture(scope="session")
def clean(scenario):
    plans = load_scenario(scenario).flights
    return tuple(fly_plan(plan, SimulatedVehicle.load(plan.vehicle)).flight() for plan in plans)


def prepared(flight: Flight, vehicle: Vehicle) -> PreparedFlight:
    return PreparedFlight(
        name=flight.name,
        sha256="",
        time=flight.time,
        inputs=flight_inputs(flight, vehicle),
        derivatives=flight_derivatives(flight),
        wrench=measured_wrench(flight, vehicle),
        height=-flight.position[:, 2],
    )


@pytest.fixture(scope="session")
def vehicle():
    return Vehicle.load("bebop2")


@pytest.fixture(scope="session")
def training(clean, vehicle):
    return [prepared(contaminate(flight, NOISE, seed=k), vehicle) for k, flight in enumerate(clean)]


@pytest.fixture(scope="session")
def model(training, vehicle):
    options = IdentifyOptions(method="polynomial", cutoff_hz=250.0, settings="paper")
    identified = identify(training, vehicle, POOLS, options)
    return replace(identified, name="fitted")


@pytest.fixture
def case(model, clean, vehicle):
    return ValidationCase(vehicle, {"fitted": model}, clean, NOISE, confidence=0.95, seed=7)


@pytest.fixture(scope="session")
def same():
    """same(one, other): whether two tallies hold the same numbers, bit for bit."""

    def compare(one, other):
        return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in vars(one))

    return compare
