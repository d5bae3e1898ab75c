# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates of a search: variants, sizes, their columns, and those of tolerances and the form of laws."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.candidates import candidates, first_point, linearise, typical_sizes
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.discrepancy.unmeasured_states import Started
from quadpi_core.errors import DiscrepancyError
from quadpi_core.frames import rotate_world_to_body
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.vehicle import Vehicle

from .regressions import DRAG, PAYLOAD, WIND, regression_of, rows, rows_in

BEBOP = Vehicle.load("bebop2")


def one(name):
    (candidate,) = candidates(BEBOP, [name])
    return candidate


@pytest.fixture(scope="module")
def short(simulation, flights):
    """Four seconds of a flight, beside the simulation."""
    return Compared(flights[0].slice(slice(500, 1000)), simulation)


def test_each_whole_number_is_a_candidate_of_its_own():
    weak = candidates(BEBOP, ["weak_rotor"])
    assert [own.label for own in weak] == [f"weak_rotor (rotor {k})" for k in (1, 2, 3, 4)]
    assert {own.name for own in weak} == {"weak_rotor"}
    assert all(own.free == (1, 2) for own in weak)
    np.testing.assert_array_equal(weak[2].values(np.array([0.2, -0.1])), [3.0, 0.2, -0.1])


def test_a_whole_number_stays_within_the_bounds_of_its_effect(monkeypatch):
    weak = EFFECTS["weak_rotor"]
    first, *others = weak.parameters
    front = replace(weak, parameters=(replace(first, highest=2.0), *others))
    monkeypatch.setitem(EFFECTS, "weak_rotor", front)
    assert [one.start[0] for one in candidates(Vehicle.load("bebop2"), ["weak_rotor"])] == [1.0, 2.0]


def test_a_search_looks_for_effects_that_some_manoeuvre_shows():
    names = [own.name for own in candidates(BEBOP)]
    assert list(dict.fromkeys(names)) == [e.name for e in EFFECTS.values() if e.shown_by]
    assert "cross_flow" not in names
    with pytest.raises(DiscrepancyError, match="unknown effect `rotor_darg`; known: "):
        candidates(BEBOP, ["rotor_darg"])


def test_what_looks_alike_on_one_rotor_is_sought_once():
    weak, misread = candidates(BEBOP, ["weak_rotor"]), candidates(BEBOP, ["rotor_speed_scale"])
    first = {own.label: own for own in misread}["rotor_speed_scale (rotor 1)"]
    assert weak[0].excludes(weak[1])
    assert weak[0].excludes(first)
    assert first.excludes(weak[0])
    assert not weak[1].excludes(first)
    assert not one("body_drag").excludes(weak[0])


def test_parameters_stay_within_the_bounds_of_their_effect():
    drag = one("body_drag")
    np.testing.assert_array_equal(drag.within_bounds(np.array([-1.0, 0.05, 9.0])), [0.0, 0.05, 0.1])


def test_typical_sizes_grow_with_the_vehicle():
    """Twice the mass: twice the forces and moments. Twice the arm: moments twice, inertias four times."""
    heavy = replace(BEBOP, mass_kg=2.0 * BEBOP.mass_kg)
    wide = replace(BEBOP, rotor_positions=2.0 * BEBOP.rotor_positions)
    growth = {
        "force_bias": (2.0, 1.0),
        "moment_bias": (2.0, 2.0),
        "rate_damping": (2.0, 2.0),
        "gyroscopic": (2.0, 4.0),
        "payload": (2.0, 1.0),
        "cg_offset": (1.0, 2.0),
        "wind": (1.0, 1.0),
        "thrust_coefficient": (1.0, 1.0),
    }
    for name, (by_mass, by_arm) in growth.items():
        sizes = typical_sizes(EFFECTS[name], BEBOP)
        np.testing.assert_allclose(typical_sizes(EFFECTS[name], heavy), by_mass * sizes, err_msg=name)
        np.testing.assert_allclose(typical_sizes(EFFECTS[name], wide), by_arm * sizes, err_msg=name)


def test_a_parameter_whose_default_is_zero_is_as_large_as_its_neighbours():
    assert typical_sizes(EFFECTS["wind"], BEBOP).tolist() == [2.0, 2.0, 2.0]
    np.testing.assert_allclose(typical_sizes(EFFECTS["cg_offset"], BEBOP), 0.0035, rtol=0.01)


def test_the_law_of_wind_is_as_uncertain_as_the_aerodynamics():
    assert one("wind").form == EFFECTS["body_drag"].form == 0.15
    assert one("payload").form == 0.0


def test_no_flight_decides_where_a_load_is_linearised_first():
    """Two of three flights explain the most by half a metre; the third by another length, of no mass."""
    load = one("slung_load")

    def flight(length, most, least, strength):
        def started(_, values):
            explained = most if values[1] == length else least
            return Started(np.zeros(6), strength, explained, 0.0)

        return SimpleNamespace(started=started)

    flights = [flight(0.5, 0.5, 0.4, 0.03), flight(0.5, 0.6, 0.4, 0.04), flight(3.8, 1.0, 0.0, 0.0)]
    assert first_point(load, flights)[:2].tolist() == [0.03, 0.5]


def test_columns_of_a_linear_law_are_its_contribution_for_any_parameters(short):
    drag = one("body_drag")
    (here, columns), *_ = linearise(drag, [short], np.zeros(3))
    assert not here.any()
    parameters = np.array([0.004, 0.01, 0.002])
    np.testing.assert_allclose(
        columns @ (parameters / drag.scale), short.added(drag.effect, parameters), rtol=1e-9, atol=1e-12
    )


def test_columns_of_a_curved_effect_are_its_slope_where_it_is_linearised(short, simulation):
    """Wind: the change of the simulated wrench with the airspeed."""
    wind, at = one("wind"), np.array([1.0, -0.5, 0.2])
    ((here, columns),) = linearise(wind, [short], at)

    def simulated(blowing):
        flight = short.quiet
        moved = flight.velocity - rotate_world_to_body(flight.attitude, np.tile(blowing, (len(flight), 1)))
        return simulation.wrench(replace(flight, velocity=moved))

    np.testing.assert_allclose(here, simulated(at) - simulated(np.zeros(3)), atol=1e-9)
    for axis, scale in enumerate(wind.scale):
        step = 0.2 * scale * np.eye(3)[axis]
        slope = (simulated(at + step) - simulated(at - step)) / 0.4
        np.testing.assert_allclose(columns[:, :, axis], slope, atol=1e-9)


def test_typical_sizes_are_those_of_the_bebop_2():
    for name in ("payload", "moment_bias", "gyroscopic", "cg_offset"):
        sizes = typical_sizes(EFFECTS[name], BEBOP)
        defaults = [p.default or sizes[k] for k, p in enumerate(EFFECTS[name].parameters)]
        np.testing.assert_allclose(sizes, defaults, rtol=0.01, err_msg=name)


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
