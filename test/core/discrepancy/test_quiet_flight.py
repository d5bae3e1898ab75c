# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights without the white noise of their signals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from quadpi_core.discrepancy.other_simulations import CallableSimulation
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


def test_noise_of_the_inputs_does_not_shrink_the_simulation(flown, moved_tolerances):
    """Rotor speeds so noisy that they make most of the noise of a moment move no tolerance by two.

    Of the moments of the rotors that they make, which are known to a fiftieth, they move a twentieth at most.
    """
    base = VehicleSimulation.load("bebop2")
    flights = [noisy(flight, seed) for seed, flight in enumerate(flown())]
    function = CallableSimulation("function", base.vehicle, base.wrench, base.tolerances)
    moved = moved_tolerances(flights, function)
    share = base.tolerances.inertia
    moments = [share * abs(moved.pop(f"{axis} of rotors")) for axis in ("Mx", "My")]
    assert max(moments) < 0.05, moments
    assert max(map(abs, moved.values())) < 2.0, moved
