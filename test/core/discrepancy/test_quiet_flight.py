# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Signals without their white noise, and what they explain of a simulation with noisy inputs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.external_simulations import CallableSimulation, Recorded, RecordedSimulation
from quadpi_core.discrepancy.instruments import explained, instruments
from quadpi_core.discrepancy.quiet_flight import quiet
from quadpi_core.discrepancy.simulations import VehicleSimulation
from quadpi_core.signals.filters import zero_phase

NOISE_RAD_S = 8.0


def noisy(flight, seed):
    """Rotor speeds with white noise, which the low-pass of flights has passed."""
    white = NOISE_RAD_S * np.random.default_rng(seed).standard_normal(flight.rotor_speeds.shape)
    return replace(
        flight, rotor_speeds=flight.rotor_speeds + zero_phase(white, 30.0, flight.rate_hz, slice(0)).value
    )


def test_motion_stays_and_noise_goes(flown):
    flight = flown()[0]
    loud = noisy(flight, 1)
    error = {
        name: np.sqrt(np.mean(np.square(one.rotor_speeds - flight.rotor_speeds)))
        for name, one in {"loud": loud, "quiet": quiet(loud), "untouched": quiet(flight)}.items()
    }
    assert error["quiet"] < 0.7 * error["loud"]
    assert error["untouched"] < 0.3
    for name in ("velocity", "rates"):
        moved = getattr(quiet(flight), name) - getattr(flight, name)
        assert np.sqrt(np.mean(np.square(moved))) < 0.02


def test_a_slow_log_stays_as_it_is(flown):
    flight = flown()[0].slice(slice(None, None, 20))
    assert quiet(flight) is flight


def test_instruments_explain_the_simulation_and_not_its_noise(flown):
    simulation, flights = VehicleSimulation.load("bebop2"), flown()
    functions = [instruments(f, simulation.vehicle, simulation.hover_rotor_speed) for f in flights]
    true = [simulation.wrench(f)[:, :, None] for f in flights]
    rng = np.random.default_rng(2)
    noise = [0.05 * np.abs(one).mean(axis=0) * rng.standard_normal(one.shape) for one in true]
    found = explained([one + more for one, more in zip(true, noise, strict=True)], functions)
    left = np.vstack(found)[:, :, 0] - np.vstack(true)[:, :, 0]
    # A fifth of the pitching moment of the Bebop's polynomials is the most that they miss.
    assert np.all(left.std(axis=0) < 0.25 * np.vstack(true)[:, :, 0].std(axis=0))
    drawn = np.vstack(noise)[:, :, 0]
    assert np.all(np.sum(left * drawn, axis=0) < 0.05 * np.sum(drawn**2, axis=0))


def multiples(flights, simulation):
    """Of every tolerance, what a fit without any effect moves it by."""
    regression = Regression.of(
        Compared.together(flights, simulation), candidates(simulation.vehicle, ["payload"])
    )
    found = regression.fit(())
    assert found is not None
    return dict(zip(regression.columns.tolerance_names, found.of(regression.columns.tolerances), strict=True))


def test_noise_of_the_inputs_does_not_shrink_the_simulation(flown):
    """Rotor speeds so noisy that they make most of the noise of a moment move no tolerance by two."""
    base = VehicleSimulation.load("bebop2")
    flights = [noisy(flight, seed) for seed, flight in enumerate(flown())]
    function = CallableSimulation("function", base.vehicle, base.wrench, base.tolerances)
    moved = multiples(flights, function)
    assert max(map(abs, moved.values())) < 2.0, moved


def test_noise_of_a_recorded_simulation_does_not_shrink_it(flown):
    """A wrench of noisy velocities, as a log has them, moves the tolerance of drag by less than two."""
    base, flights, wrenches = VehicleSimulation.load("bebop2"), flown(), {}
    renamed = [replace(flight, source=f"flight {index}") for index, flight in enumerate(flights)]
    for index, flight in enumerate(renamed):
        rng = np.random.default_rng(index)
        rough = replace(flight, velocity=flight.velocity + 0.1 * rng.standard_normal(flight.velocity.shape))
        stamps = flight.start_ns + np.round(1e9 * flight.time).astype(np.int64)
        wrench = zero_phase(base.wrench(rough), 30.0, flight.rate_hz, slice(0)).value
        wrenches[flight.source] = Recorded(stamps, wrench)
    hover = base.vehicle.mass_kg * base.vehicle.gravity_m_s2 / (4.0 * base.hover_rotor_speed**2)
    moved = multiples(renamed, RecordedSimulation(base.vehicle, wrenches, hover, base.tolerances))
    drag = {name: value for name, value in moved.items() if name in ("Fx of the rest", "Fy of the rest")}
    assert max(map(abs, drag.values())) < 2.0, moved
