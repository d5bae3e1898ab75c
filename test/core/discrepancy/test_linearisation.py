# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of the regression: what they hold, and what a move of a candidate changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy import CallableSimulation
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.effect_response import Compared, share_of_wrench
from quadpi_core.discrepancy.linearisation import Linearisation, Modulators, table_starts
from quadpi_core.discrepancy.whitening import EDGES_HZ
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES
from quadpi_core.models.sound_flights import SoundFlights

NAMES = ["body_drag", "payload", "wind"]
DRAG, PAYLOAD, WIND = range(3)


@pytest.fixture(scope="module")
def columns(simulation, flights):
    compared = [Compared(flight.slice(slice(0, 1000)), simulation) for flight in flights[:2]]
    chosen = {own.name: own for own in candidates(simulation.vehicle, NAMES)}
    return Linearisation.of(compared, [chosen[name] for name in NAMES])


def rows_of(columns, place, wrench):
    """Rows (6, B) of a wrench (M, 6) of a flight."""
    return columns.flights[place].spectrum(wrench[:, :, None]).rows[:, :, 0]


def test_the_first_column_is_the_residual_and_tolerances_follow(columns):
    for place, flight in enumerate(columns.flights):
        residual, *tolerances = np.moveaxis(columns.rows(place, np.arange(1 + len(columns.tolerances))), 2, 0)
        np.testing.assert_allclose(residual, rows_of(columns, place, flight.residual))
        for found, column in zip(tolerances, flight.uncertain(), strict=True):
            np.testing.assert_allclose(found, rows_of(columns, place, column.wrench), atol=1e-12)
    assert columns.tolerance_names == tuple(column.name for column in columns.flights[0].uncertain())


def test_what_no_flight_feels_is_no_column_and_what_one_feels_is_one_of_all(simulation, flights):
    """A force along x in one of two flights, none along y in either."""

    def pushing(flight):
        wrench = simulation.wrench(flight)
        wrench[:, 0] = 0.1 if flight.source == flights[0].source else 0.0
        wrench[:, 1] = 0.0
        return wrench

    outside = CallableSimulation("outside", simulation.vehicle, pushing)
    compared = [Compared(flight.slice(slice(0, 500)), outside) for flight in flights[:2]]
    columns = Linearisation.of(compared, ())
    names = columns.tolerance_names
    assert len(names) == len(columns.tolerance_laws) == len(columns.tolerances)
    assert len(names) < len(compared[0].uncertain())
    assert "Fx of rotors" in names
    assert not any(name.startswith("Fy of ") for name in names)
    of_force = columns.tolerances[[names.index("Fx of rotors")]]
    first, second = (columns.rows(place, of_force).any() for place in range(2))
    assert first
    assert not second
    # Of the body, all: moves change them.
    body = [name for name in (column.name for column in compared[0].uncertain()) if "." in name]
    assert names[-len(body) :] == tuple(body)
    for law in filter(None, columns.tolerance_laws):
        assert law in names


def of_sound_flights(simulation, name):
    """The simulation, of which sound flights show that it lacks 0.02 ± 0.01 kg, and 0.003 of each flight."""
    bands = np.ones((len(AXES), len(EDGES_HZ.value) - 1))
    error = np.array([0.02]), np.array([[0.01**2]]), np.array([0.003])
    sound = SoundFlights(8, EDGES_HZ.value, bands, bands, np.zeros(len(AXES)), ((name, "mass_kg"),), *error)
    return replace(simulation, sound=sound)


@pytest.mark.parametrize("sought", [["payload", "wind"], ["wind"]])
def test_the_residual_is_less_what_sound_flights_leave(columns, simulation, flights, sought):
    """Whether what they show is looked for, or not; their deviations are no columns."""
    compared = [
        Compared(flight.slice(slice(0, 1000)), of_sound_flights(simulation, "payload"))
        for flight in flights[:2]
    ]
    less = Linearisation.of(compared, candidates(simulation.vehicle, sought))
    for place in range(2):
        payload = columns.rows(place, columns.blocks[PAYLOAD].parameters) / columns.candidates[PAYLOAD].scale
        first = np.zeros(1, dtype=int)
        np.testing.assert_allclose(
            less.rows(place, first), columns.rows(place, first) - 0.02 * payload, atol=1e-9
        )
        np.testing.assert_allclose(less.errors[place], payload * [0.01 * np.sqrt(2.0), 0.003], atol=1e-9)
    assert len(less.tolerances) == len(columns.tolerances)


def test_an_error_of_an_effect_that_is_not_known_is_refused(simulation, flights):
    compared = [Compared(flights[0].slice(slice(0, 1000)), of_sound_flights(simulation, "warp"))]
    with pytest.raises(DiscrepancyError, match=r"^bebop2: knows an error of warp, which is no effect here"):
        Linearisation.of(compared, ())


def test_blocks_follow_each_other_and_only_curved_candidates_have_an_offset(columns):
    drag, payload, wind = columns.blocks
    first = 1 + len(columns.tolerances)
    assert drag.parameters.tolist() == [first, first + 1, first + 2]
    assert payload.parameters.tolist() == [first + 3]
    assert wind.parameters.tolist() == [first + 4, first + 5, first + 6]
    assert (drag.offset, payload.offset, wind.offset) == (None, None, first + 7)
    assert columns.width == first + 8
    assert columns.linear_columns.tolist() == list(range(1, first + 4))
    # Bounds are in units of the prior.
    np.testing.assert_allclose(drag.highest * columns.candidates[DRAG].scale, 0.1)


def test_a_sum_of_columns_takes_them_by_their_weights(columns):
    weights = np.random.default_rng(0).standard_normal(columns.width)
    weights[5:9] = 0.0
    for place in range(2):
        whole = columns.rows(place, np.arange(columns.width)) @ weights
        np.testing.assert_allclose(columns.combined(place, weights), whole, atol=1e-9)
    # Weights that end early: further columns have none.
    np.testing.assert_allclose(
        columns.combined(0, weights[:3]), columns.rows(0, np.arange(3)) @ weights[:3], atol=1e-12
    )


def test_a_candidate_that_moves_gets_a_new_block_and_leaves_the_others(columns):
    at = np.array([1.0, -0.5, 0.2])
    moved = columns.moved({WIND: at})
    assert [block.parameters.tolist() for block in moved.blocks[:2]] == [
        block.parameters.tolist() for block in columns.blocks[:2]
    ]
    assert moved.blocks[WIND].parameters[0] == columns.width
    assert columns.points[WIND].tolist() == [0.0, 0.0, 0.0]
    before = np.arange(columns.width)
    np.testing.assert_array_equal(moved.rows(0, before), columns.rows(0, before))


def test_remade_columns_are_those_of_another_simulation_and_all_others_stay(simulation, flights):
    """Wind and a rotor's tilt, at their points; of a payload, which is not asked for, nothing changes."""
    chosen = {own.label: own for own in candidates(simulation.vehicle, ["rotor_tilt", "wind", "payload"])}
    order = [chosen["rotor_tilt (rotor 2)"], chosen["wind"], chosen["payload"]]
    compared = [Compared(flight.slice(slice(0, 1000)), simulation) for flight in flights[:2]]
    points = {0: np.array([2.0, -1.0]), 1: np.array([1.0, 0.5, 0.2])}
    before = Linearisation.of(compared, order).moved(points)
    other = simulation.with_coefficients({"thrust": 5.0, "rotor_force_along": -3.0})
    # What the first simulation was asked for before must not be what the other answers.
    beside = [flight.compared_with(other) for flight in compared]
    remade = before.remade(beside, (0, 1))
    anew = [Compared(flight.slice(slice(0, 1000)), other) for flight in flights[:2]]
    expected = Linearisation.of(anew, order).moved(points)
    assert remade.flights == before.flights
    assert remade.blocks[2] == before.blocks[2]
    for place in range(2):
        kept = np.arange(before.width)
        np.testing.assert_array_equal(remade.rows(place, kept), before.rows(place, kept))
        for index in (0, 1):
            own, same = remade.blocks[index], expected.blocks[index]
            assert own.parameters.min() >= before.width
            # A tilt has no columns of its form.
            assert (len(own.form) > 0) == (len(same.form) > 0) == (index == 1)
            mine, theirs = (np.concatenate((block.parameters, block.form)) for block in (own, same))
            np.testing.assert_allclose(remade.rows(place, mine), expected.rows(place, theirs), atol=1e-12)
        tilt = remade.rows(place, remade.blocks[0].parameters)
        stated = before.rows(place, before.blocks[0].parameters)
        # Five tolerances of thrust.
        assert np.linalg.norm(tilt) / np.linalg.norm(stated) == pytest.approx(1.05, abs=0.01)


def test_about_its_point_a_curved_candidate_contributes_what_it_does(columns):
    """Columns at the parameters less the offset."""
    at = np.array([1.0, -0.5, 0.2])
    moved = columns.moved({WIND: at})
    block, wind = moved.blocks[WIND], columns.candidates[WIND]
    for place, flight in enumerate(columns.flights):
        weights = np.zeros(moved.width)
        weights[block.parameters], weights[block.offset] = at / wind.scale, -1.0
        contribution = rows_of(columns, place, flight.added(wind.effect, wind.values(at)))
        np.testing.assert_allclose(moved.combined(place, weights), contribution, atol=1e-9)


def test_columns_of_the_form_are_shares_of_the_contribution(columns):
    """One for each axis of the law, then one for each modulator; none for an exact law or no effect."""
    at = np.array([0.004, 0.01, 0.002])
    moved = columns.moved({DRAG: at, PAYLOAD: np.array([0.05])})
    block, drag = moved.blocks[DRAG], columns.candidates[DRAG]
    assert len(moved.blocks[PAYLOAD].form) == len(columns.moved({DRAG: 0.0 * at}).blocks[DRAG].form) == 0
    assert block.formed_at == pytest.approx(np.linalg.norm(at / drag.scale))
    assert len(block.form) == len(drag.effect.axes) + len(moved.modulators.mean)
    flight = columns.flights[0]
    contribution = flight.added(drag.effect, drag.values(at))
    last = 0.15 * contribution * moved.modulators.values[0][:, [-1]]
    np.testing.assert_allclose(moved.rows(0, block.form[-1:])[:, :, 0], rows_of(columns, 0, last), atol=1e-9)


def test_other_accelerations_change_the_columns_of_mass_and_inertia_alone(columns, simulation):
    changes = [0.1 * columns.rows(place, np.zeros(1, dtype=int))[:, :, 0] for place in range(2)]
    moved = columns.accelerated(changes)
    (payload,) = columns.blocks[PAYLOAD].parameters
    everything = np.arange(columns.width)
    for place, change in enumerate(changes):
        difference = moved.rows(place, everything) - columns.rows(place, everything)
        changed = {int(k) for k in np.flatnonzero(np.abs(difference).max(axis=(0, 1)))}
        inertia = {1 + columns.tolerance_names.index(f"inertia.{axis}_change") for axis in "xyz"}
        assert changed == inertia | {payload}
        effect, scale = columns.candidates[PAYLOAD].effect, columns.candidates[PAYLOAD].scale
        share = share_of_wrench(effect, simulation.vehicle, scale)
        np.testing.assert_allclose(difference[:, :, payload], share @ change, rtol=1e-6, atol=1e-12)


def test_modulators_are_standardised_over_all_flights(columns):
    everything = np.concatenate(Modulators.of(columns.flights).values)
    np.testing.assert_allclose(everything.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(everything.std(axis=0), 1.0, rtol=1e-9)


def test_tables_start_where_the_one_before_ends():
    assert table_starts([np.zeros((6, 2, width)) for width in (3, 1, 4)]) == [0, 3, 4]
    assert table_starts([]) == []


def test_squares_of_each_column_are_those_of_it_alone(columns):
    noise = np.random.default_rng(5).uniform(0.5, 2.0, (6, 20))
    wanted = columns.tolerances[:4]
    each = columns.squares_of_each(wanted, noise)
    for place, index in enumerate(wanted):
        np.testing.assert_allclose(each[:, place], columns.squares(np.eye(columns.width)[index], noise))
