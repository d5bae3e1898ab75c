# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where simulation and flights disagree: found where it was put, silent where there is nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.discrepancy.by_condition import Range, locate
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_regression import NONE_HELD
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.residual_bins import (
    Cells,
    against_draws,
    residuals,
)
from quadpi_core.discrepancy.search import search
from quadpi_core.flight import AXES

NULLS = 20
SOUGHT = ("body_drag", "rate_damping")
NOISE = np.array([0.03, 0.03, 0.03, 3e-3, 3e-3, 3e-3])


def searched(simulation, flights, names=SOUGHT):
    compared = [Compared(flight, simulation) for flight in flights]
    return search(compared, candidates(simulation.vehicle, names), NONE_HELD)


@pytest.fixture(scope="module")
def null(simulation, flights, pushed):
    """null(seed): flights with the wrench of the simulation, its coefficients within tolerances, and noise.

    The noise is made in time and of another spectrum than the library's bands have: white, with a part that
    lasts for a second.
    """
    compared = [Compared(flight, simulation) for flight in flights]

    def make(seed):
        rng = np.random.default_rng(seed)
        off = rng.standard_normal(len(compared[0].uncertain()))
        made = []
        for own in compared:
            error = rng.standard_normal(own.measured.shape) * NOISE
            slow = lfilter([0.02], [1.0, -0.99], rng.standard_normal(own.measured.shape), axis=0) * NOISE
            columns = np.stack([column.wrench for column in own.uncertain()], axis=2)
            wrench = columns @ off + error + slow - own.residual
            made.append(pushed(own.thinned, simulation.vehicle, wrench))
        return searched(simulation, made)

    return make


@pytest.mark.slow
def test_nothing_is_located_in_flights_without_a_discrepancy(null):
    """Family-wise at 5 %: both what is reported, and the p-values alone, without the rule of what matters."""
    located, smallest = 0, []
    for seed in range(NULLS):
        found = null(seed)
        flights = residuals(found)
        smallest.append(against_draws(found, flights, Cells.of(flights), seed).p_value.min())
        where = locate(found, seed)
        located += bool(where.ranges or where.segments)
    assert located == 0
    # 5 % of bins and 5 % of seconds: 4 and fewer of 20 in 95 of 100 such tests.
    assert np.sum(np.array(smallest) <= 0.05) <= 5
    # Draws that were too wide would never come near.
    assert min(smallest) < 0.5


class TestDrag:
    def test_is_located_at_speed_on_the_axes_of_the_force(self, found):
        assert {part.axis for part in found.where.ranges} <= {"Fx", "Fy", "Fz"}
        for axis, variables in (("Fx", {"u", "speed"}), ("Fy", {"v", "speed"})):
            telling = [part for part in found.where.telling if part.axis == axis]
            assert telling, axis
            assert {part.variable for part in telling} <= variables
            assert sum(part.share for part in telling) > 0.5
            assert sum(part.time_share for part in telling) < 0.5
            assert all(part.p_value <= 0.025 for part in telling)

    def test_shares_of_an_axis_add_up_to_no_more_than_all(self, found):
        for axis in AXES:
            assert sum(s.share for s in found.where.segments if s.axis == axis) <= 1.0 + 1e-9
            for variable in {part.variable for part in found.where.ranges}:
                own = [p for p in found.where.ranges if (p.axis, p.variable) == (axis, variable)]
                assert sum(part.share for part in own) <= 1.0 + 1e-9

    def test_what_was_found_brings_the_profile_down_to_what_is_allowed(self, found):
        for profile in found.where.profiles[:2]:
            assert np.max(profile.beyond / profile.allowed) > 2.0
            assert np.max(profile.after / profile.allowed) < 1.2

    def test_residuals_have_the_mean_squares_of_the_gap(self, found):
        for name in ("before", "after"):
            everything = np.concatenate([getattr(own, name) for own in found.where.residuals])
            # The gap counts samples of flights, not rows.
            rms = np.sqrt(np.mean(np.square(everything), axis=0))
            assert rms == pytest.approx(getattr(found.discovery.gap, name), rel=0.02)


def test_a_force_in_one_place_is_found_there_and_whenever_a_flight_is_there(simulation, flights, pushed):
    """No effect of those that are looked for explains it."""
    border = 1.0
    altered = []
    for flight in flights:
        wrench = np.zeros((len(flight), 6))
        wrench[flight.position[:, 0] > border, 1] = 0.3
        altered.append(pushed(flight, simulation.vehicle, wrench))
    where = locate(searched(simulation, altered))
    (part,) = [part for part in where.telling if part.axis == "Fy"]
    assert part.variable == "north"
    assert (part.low, part.high) == (pytest.approx(border, abs=0.25), None)
    assert part.share > 0.6
    for segment in where.segments:
        flight = next(own for own in flights if own.name == segment.flight)
        during = (flight.time >= segment.start_s) & (flight.time <= segment.end_s)
        assert segment.axis == "Fy"
        assert flight.position[during, 0].max() > border
    assert len(where.segments) > 3


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (4.0, None, "airspeed above 4 m/s"),
        (None, 0.5, "airspeed below 0.5 m/s"),
        (1.0, 2.0, "airspeed from 1 to 2 m/s"),
        (None, None, "any airspeed"),
    ],
)
def test_ranges_in_words(low, high, text):
    part = Range("Fx", "speed", low, high, 0.83, 0.2, 0.01)
    assert part.text == f"Fx at {text}: 83 % of the residual energy in 20 % of the time"
    assert replace(part, variable="height").conditions == text.replace("airspeed", "height").replace(
        "m/s", "m"
    )
