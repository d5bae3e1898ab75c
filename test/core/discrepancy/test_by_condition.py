# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where simulation and flights disagree: found where it was put, silent where there is nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from quadpi_core.discrepancy.by_condition import (
    Range,
    bin_edges,
    judged_cells,
    largest_deviation,
    locate,
    over_time,
    residuals,
    within_tolerance,
)
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.search import Prepared, search
from quadpi_core.discrepancy.whitening import spectrum
from quadpi_core.flight import AXES

NULLS = 20
NOISE = np.array([0.03, 0.03, 0.03, 3e-3, 3e-3, 3e-3])


def searched(simulation, flights):
    compared = [Compared(flight, simulation) for flight in flights]
    return search(
        Prepared.from_flights(compared, candidates(simulation.vehicle, ("body_drag", "rate_damping")))
    )


@pytest.mark.slow
def test_nothing_is_located_in_flights_without_a_discrepancy(simulation, flights, pushed):
    """Family-wise at 5 %: both what is reported, and the p-values alone, without the rule of what matters.

    Flights have the wrench of the simulation, its coefficients within tolerances, and noise that is made in
    time and of another spectrum than the library's bands have: white, with a part that lasts for a second.
    """
    compared = [Compared(flight, simulation) for flight in flights[:2]]
    smallest = []
    for seed in range(NULLS):
        rng = np.random.default_rng(seed)
        off = rng.standard_normal(len(compared[0].uncertain()))
        made = []
        for own in compared:
            error, walk = rng.standard_normal((2, *own.measured.shape)) * NOISE
            slow = lfilter([0.02], [1.0, -0.99], walk, axis=0)
            columns = np.stack([column.wrench for column in own.uncertain()], axis=2)
            made.append(pushed(own.thinned, simulation.vehicle, columns @ off + error + slow - own.residual))
        found = searched(simulation, made)
        smallest.append(judged_cells(found, residuals(found), seed).p_value.min())
        where = locate(found, seed)
        assert not where.ranges
        assert not where.segments
    # 5 % of bins and 5 % of seconds: 4 and fewer of 20 in 95 of 100 such tests.
    assert np.sum(np.array(smallest) <= 0.05) <= 5
    # Draws that were too wide would never come near.
    assert min(smallest) < 0.5


def test_drag_is_located_at_speed_on_the_axes_of_the_force(found):
    where = found.where
    assert {part.axis for part in where.ranges} <= {"Fx", "Fy", "Fz"}
    for axis, variables in (("Fx", {"u", "speed"}), ("Fy", {"v", "speed"})):
        telling = [part for part in where.telling if part.axis == axis]
        assert telling, axis
        assert {part.variable for part in telling} <= variables
        assert sum(part.share for part in telling) > 0.5
        assert sum(part.time_share for part in telling) < 0.5
        assert all(part.p_value <= 0.025 for part in telling)
    for axis in AXES:
        assert sum(s.share for s in where.segments if s.axis == axis) <= 1.0 + 1e-9
        for variable in {part.variable for part in where.ranges}:
            own = [p for p in where.ranges if (p.axis, p.variable) == (axis, variable)]
            assert sum(part.share for part in own) <= 1.0 + 1e-9
    for profile in where.profiles[:2]:
        assert np.max(profile.beyond / profile.allowed) > 2.0
        assert np.max(profile.after / profile.allowed) < 1.2


@pytest.mark.parametrize("name", ["before", "after"])
def test_residuals_have_the_mean_squares_of_the_gap(found, name):
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
    height = replace(part, variable="height").conditions
    assert height == text.replace("airspeed", "height").replace("m/s", "m")


def test_coefficients_within_tolerance_explain_what_they_can_and_no_more():
    columns = np.random.default_rng(1).standard_normal((200, 4)) * 30.0
    most = largest_deviation(4)
    assert 2.0 < most < 3.5
    truth = np.array([[0.5, 0.5], [-1.0, -1.0], [0.2, 0.2], [1.0, 9.0]])
    gram = columns.T @ columns
    inside, outside = within_tolerance(gram, gram @ truth).T
    assert inside == pytest.approx(truth[:, 0], abs=0.01)
    assert outside[3] == pytest.approx(most)
    assert np.abs(outside).max() <= most + 1e-9


@pytest.mark.parametrize("samples", [1000, 1001])
def test_rows_come_back_as_the_signal_that_they_were_made_of(samples):
    """Within the band and away from the ends, that rise and fall; and squares stay the same."""
    rate_hz = 125.0
    time = np.arange(samples) / rate_hz
    signal = np.sin(2.0 * np.pi * 3.0 * time + 0.4) + 0.5
    columns = np.repeat((signal[:, None] * np.arange(1.0, 7.0))[:, :, None], 2, axis=2)
    rows = spectrum(columns, rate_hz).rows
    at, series = over_time(rows, samples)
    assert series.shape == (len(at), 6, 2)
    assert np.square(series).mean(axis=0) == pytest.approx(np.square(rows).sum(axis=1) / samples)
    inner = (time[at] > 1.0) & (time[at] < time[-1] - 1.0)
    # The taper takes a little of the whole, which the scale gives back.
    fitted = series[inner, 0, 0] @ signal[at][inner] / (signal[at][inner] @ signal[at][inner])
    assert 1.0 < fitted < 1.1
    assert series[inner, 0, 0] == pytest.approx(fitted * signal[at][inner], abs=0.08)


@pytest.mark.parametrize(
    ("heights", "edges"),
    [
        ((0.05, 0.15, 0.3, 0.7, 1.5, 3.0, 7.0, 15.0), [0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0]),
        ((30.0, 70.0, 200.0), [0.0, 50.0, 100.0, 200.0]),
    ],
)
def test_bins_of_the_height_grow_with_it(heights, edges):
    assert bin_edges("height", np.repeat(heights, 100)).tolist() == edges
