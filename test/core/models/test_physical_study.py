# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.kinds.physical import PhysicalStudy, delays_not_ruled_out
from quadpi_core.models.physical_fit import PhysicalFlight, Sensing
from quadpi_core.models.physical_terms import TERM_INDEX
from test.core.models.physical_flights import NOISE, VEHICLE, flown, swept


@pytest.mark.parametrize("delay_s", [0.0, 0.0075])
@pytest.mark.parametrize("noise", [0.1, 2.0])
def test_the_delay_of_rotor_speeds_is_found(delay_s: float, noise: float) -> None:
    flights = [swept(10.0, seed, delay_s=delay_s, noise=noise) for seed in (1, 2)]
    study = PhysicalStudy.from_flights(flights, VEHICLE)
    assert study.sensing == Sensing(delay_s, None)
    assert [step.of for step in study.log[:2]] == ["0 ms", "2.5 ms"]


def test_the_bandwidth_of_a_smoothed_force_is_found() -> None:
    smooth = []
    for flight in (swept(20.0, seed, noise=0.1, fastest_hz=20.0) for seed in (1, 2)):
        wrench = flight.wrench.copy()
        wrench[:, :3] = flight.recorded(wrench[:, :3, np.newaxis], Sensing(0.0, 7.0))[:, :, 0]
        smooth.append(replace(flight, wrench=wrench))
    found = PhysicalStudy.from_flights(smooth, VEHICLE).sensing.force_bandwidth_hz
    assert found is not None
    assert 6.0 <= found <= 8.0


def test_flights_left_out_are_predicted_as_well_as_noise_allows() -> None:
    flights = [flown(20.0, seed) for seed in (1, 2, 3)]
    study = PhysicalStudy.from_flights(flights, VEHICLE, sensing=Sensing())
    fit = study.fit(choose=True, left_out=0)
    faster = flown(20.0, 9, speed=6.0)
    for flight in (flights[0], faster):
        squares = np.square(flight.errors(fit.values, fit.vehicle, fit.sensing))
        assert np.all(np.sqrt(np.mean(squares, axis=0)) < 1.5 * NOISE)
    gains = {step.of: step.error for step in fit.log if step.step == "gain of a group kept"}
    assert gains["rotor drag"] > -0.05


def test_a_group_that_harms_flights_left_out_leaves() -> None:
    """Products of rates that act one way on one flight and the other way on the next."""

    def with_products(flight: PhysicalFlight, sign: float) -> PhysicalFlight:
        wrench, rates = flight.wrench.copy(), flight.motion["rates"]
        wrench[:, 5] += sign * 2e-3 * rates[:, 0] * rates[:, 1]
        return replace(flight, wrench=wrench)

    flights = [with_products(swept(20.0, seed, noise=0.1), sign) for seed, sign in ((1, 1.0), (2, -1.0))]
    fit = PhysicalStudy.from_flights(flights, VEHICLE, sensing=Sensing()).fit(choose=True)
    assert "without inertia" in {step.of for step in fit.log}
    assert TERM_INDEX["inertia_z"] not in fit.kept
    assert TERM_INDEX["thrust"] in fit.kept


def test_no_flights_are_refused() -> None:
    with pytest.raises(ModelError, match="no flights"):
        PhysicalStudy.from_flights([], VEHICLE)


def test_delays_of_nearly_the_greatest_likelihood_are_not_ruled_out() -> None:
    """Twice the logarithm of the likelihood falls by 3 at a neighbour, and by 5 at the next."""
    count = np.array([100.0, 1.0, 1.0])
    fall = np.array([900.0, 400.0, 5.0, 0.0, 3.0, 5.0, 900.0])
    squares = np.exp(np.column_stack((fall / 100.0, np.zeros(7), np.zeros(7))))
    assert delays_not_ruled_out(squares, count, 3) == (0.0075, 0.01)


def test_a_delay_that_is_used_against_the_likelihood_widens_the_range_up_to_itself() -> None:
    """Two axes with few errors of their own prefer 2.5 ms, one with many 7.5 ms: 12.5 ms is ruled out."""
    places = np.arange(7.0)
    squares = 1.0 + 0.1 * np.abs(places[:, np.newaxis] - np.array([1.0, 1.0, 3.0]))
    assert delays_not_ruled_out(squares, np.array([10.0, 10.0, 500.0]), 1) == (0.0025, 0.0075)
