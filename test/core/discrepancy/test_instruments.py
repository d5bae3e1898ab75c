# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a flight explains of a simulation with noisy inputs of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.discrepancy.external_simulations import Recorded, RecordedSimulation
from quadpi_core.discrepancy.instruments import explained, instruments
from quadpi_core.discrepancy.simulations import VehicleSimulation
from quadpi_core.signals.filters import zero_phase


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


def test_noise_of_a_recorded_simulation_does_not_shrink_it(flown, moved_tolerances):
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
    moved = moved_tolerances(renamed, RecordedSimulation(base.vehicle, wrenches, hover, base.tolerances))
    drag = {name: value for name, value in moved.items() if name in ("Fx of the rest", "Fy of the rest")}
    assert max(map(abs, drag.values())) < 2.0, moved
