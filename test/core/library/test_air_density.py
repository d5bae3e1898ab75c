# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One vehicle in ten airs: with their densities it has one thrust coefficient, else an interval as wide."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import quadpi_core as qp
from quadpi_core.errors import ArgumentError
from quadpi_core.identification.identify import identify
from quadpi_core.models.kinds.physical import Physical
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.models.small_model import THRUST, headlines
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_bags import fly_plan
from quadpi_core.simulation.truth import Truth

# Degrees Celsius and metres above the sea, and the pressure there by the standard atmosphere.
AIRS = [
    (-10, 0),
    (0, 200),
    (5, 2500),
    (10, 50),
    (15, 0),
    (20, 1000),
    (25, 400),
    (30, 1500),
    (35, 0),
    (30, 3000),
]
SINE = "{{sine: {{amplitude_m: {0}, frequency_hz: {1}, start_s: 0.5, duration_s: 19.0, fade_s: 3.0}}}}"
PLAN = """
description: to and fro
vehicle: bebop2
seed: 1
flights:
  one:
    duration_s: 20.0
    motion:
      x: [{x}]
      y: [{y}]
      height: [{height}]
      yaw: [{{sine: {{amplitude_deg: 40.0, frequency_hz: 0.2, start_s: 0.5, duration_s: 19.0, fade_s: 3.0}}}}]
"""


def densities() -> np.ndarray:
    celsius, height = np.array(AIRS, dtype=float).T
    pressure = 101325.0 * (1.0 - 2.25577e-5 * height) ** 5.25588
    return pressure / (287.053 * (celsius + 273.15))


def flown(folder: Path, number: int, density: float) -> Truth:
    rng, law = np.random.default_rng(number), RotorLocalModel.load("bebop2")
    thin = replace(law.vehicle, air_density_kg_m3=density)
    vehicle = SimulatedVehicle(RotorLocalModel(thin, law.coefficients.scaled(law.vehicle, thin)), 0.033)
    sines = {
        axis: SINE.format(f"{rng.uniform(*size):.2f}", f"{rng.uniform(0.15, 0.35):.3f}")
        for axis, size in (("x", (1.0, 2.0)), ("y", (1.0, 2.0)), ("height", (0.3, 0.8)))
    }
    path = folder / f"air{number}.yaml"
    path.write_text(PLAN.format(**sines))
    return fly_plan(load_scenario(path).flights[0], vehicle)


@pytest.fixture(scope="module")
def truths(tmp_path_factory) -> list[Truth]:
    folder = tmp_path_factory.mktemp("airs")
    return [flown(folder, number, density) for number, density in enumerate(densities())]


def flights(truths: list[Truth], air: np.ndarray | None) -> qp.Flights:
    """With small noise, of the Bebop 2 as its file says, in air of 1.225 kg/m³ unless given."""
    rng, parts = np.random.default_rng(0), []
    for number, truth in enumerate(truths):
        own = slice(None, None, 2)
        parts.append(
            {
                "time_ns": truth.time_ns[own],
                "velocity": truth.velocity[own],
                "attitude": truth.attitude[own],
                "rates": truth.rates[own],
                "specific_force": truth.specific_force[own] + rng.normal(0.0, 0.1, truth.rates[own].shape),
                "rotor_speeds": truth.rotor_speeds[own],
                "flight": np.full(len(truth.time_ns[own]), f"air{number}"),
            }
        )
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    known = None if air is None else np.repeat(air, [len(part["time_ns"]) for part in parts])
    return qp.Flights.from_arrays(**whole, vehicle="bebop2", air_density=known)


def thrust_errors(model: qp.AerodynamicModel, flown: qp.Flights) -> np.ndarray:
    """Share by which the measured thrust of each flight exceeds the predicted."""
    shares = []
    for one in flown.prepared:
        told = model.evaluate(one.inputs, derivatives=one.derivatives).predicted[:, 2]
        shares.append(told @ one.wrench[:, 2] / (told @ told) - 1.0)
    return np.array(shares)


@pytest.mark.slow
def test_thrust_of_ten_airs(truths) -> None:
    vehicle, found = qp.Vehicle.load("bebop2"), {}
    for name, air in (("known", densities()), ("unknown", None)):
        given = flights(truths, air)
        options = IdentifyOptions(method=Physical(multi_step=False))
        model = identify(list(given.prepared), vehicle, load_pools("quadrotor"), options)
        line = next(one for one in headlines(model, vehicle) if one.quantity == THRUST)
        found[name] = line, thrust_errors(model, given)
    line, errors = found["known"]
    wide, spread = found["unknown"]
    assert np.abs(errors).max() < 0.01
    assert np.ptp(spread) > 0.2
    # Of airs by 8 % thinner in the mean it is lower; the interval holds what each single air gives.
    low, high = wide.interval()
    assert wide.error > 10.0 * line.error
    assert low < line.value < high
    alone = wide.value * (1.0 + spread)
    assert np.all(alone / 1.15 < line.value)
    assert np.all(line.value < alone / 0.62)
    assert line.interval()[1] - line.interval()[0] < 0.02 * line.value


def test_a_density_that_no_air_has_is_refused(truths) -> None:
    with pytest.raises(ArgumentError, match="no density of air"):
        flights(truths[:1], np.array([1225.0]))


def test_the_density_of_the_file_changes_nothing(truths) -> None:
    plain, given = (flights(truths[:1], air).prepared[0] for air in (None, np.array([1.225])))
    assert np.array_equal(plain.inputs, given.inputs)
    for name in plain.derivatives.dtype.names:
        assert np.array_equal(plain.derivatives[name], given.derivatives[name])
