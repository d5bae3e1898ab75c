# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of tolerances, effects and the form of laws."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.discrepancy import CallableSimulation

from .regressions import (
    DRAG,
    PAYLOAD,
    WIND,
    regression_of,
    rows,
    rows_in,
)


def test_what_no_flight_feels_is_no_column_and_what_one_feels_is_one_of_all(simulation, flights):
    """A force along x in one of two flights, none along y in either."""

    def pushing(flight):
        wrench = simulation.wrench(flight)
        wrench[:, 0] = 0.1 if flight.source == flights[1].source else 0.0
        wrench[:, 1] = 0.0
        return wrench

    outside = CallableSimulation("outside", simulation.vehicle, pushing)
    tolerances = regression_of(outside, flights[:2], []).tolerances
    names = tolerances.names
    assert not any(name.startswith("Fy of ") for name in names)
    force = names.index("Fx of rotors")
    felt = [rows(tolerances.coefficients, place)[:, :, force].any() for place in range(2)]
    assert felt == [False, True]
    assert {law for law in tolerances.laws if law} < set(names)
    # Of the body all, last: moves change them.
    assert sum("." in name for name in names[-tolerances.body.width :]) == tolerances.body.width
    assert len(names) == len(tolerances.laws) == tolerances.coefficients.width + tolerances.body.width


def test_about_its_point_a_curved_candidate_contributes_what_it_does(sounded):
    """Its columns at the parameters, in prior deviations, less the last; others stay, and have none."""
    at = np.array([1.0, -0.5, 0.2])
    moved, wind = sounded.moved({WIND: at}), sounded.candidates[WIND]
    block = moved.blocks[WIND]
    assert [own.curved for own in moved.blocks] == [False, False, True]
    assert moved.blocks[:WIND] == sounded.blocks[:WIND]
    np.testing.assert_allclose(block.at * wind.scale, at)
    np.testing.assert_allclose(sounded.blocks[DRAG].highest * sounded.candidates[DRAG].scale, 0.1)
    for place, flight in enumerate(sounded.flights):
        contribution = rows_in(sounded, place, flight.added(wind.effect, wind.values(at)))
        found = rows(block.columns, place) @ [*block.at, -1.0]
        np.testing.assert_allclose(found, contribution, atol=1e-9)


def test_columns_of_the_form_are_shares_of_the_contribution(sounded):
    """One for each axis of the law, then one for each modulator; none for an exact law or no effect."""
    at = np.array([0.004, 0.01, 0.002])
    moved = sounded.moved({DRAG: at, PAYLOAD: np.array([0.05])})
    block, drag = moved.blocks[DRAG], sounded.candidates[DRAG]
    assert moved.blocks[PAYLOAD].form is moved.moved({DRAG: 0.0 * at}).blocks[DRAG].form is None
    assert block.formed_at == pytest.approx(np.linalg.norm(at / drag.scale))
    flight, modulators = sounded.flights[0], sounded.modulators
    contribution = flight.added(drag.effect, drag.values(at))
    shares = [1.5 * contribution * unit for unit in np.eye(6)[:3]]
    shares += [contribution * modulator[:, None] for modulator in modulators.values[0].T]
    expected = flight.spectrum(0.15 * np.dstack(shares)).rows
    np.testing.assert_allclose(rows(block.form, 0), expected, atol=1e-9)
    everything = np.concatenate(modulators.values)
    np.testing.assert_allclose([everything.mean(axis=0), everything.std(axis=0) - 1.0], 0.0, atol=1e-9)
