# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates of a search: variants, sizes, exclusions, and their columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.candidates import candidates, linearise, typical_sizes
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.errors import DiscrepancyError
from quadpi_core.rotations import rotate_world_to_body
from quadpi_core.simulation.effect_registry import EFFECTS
from quadpi_core.vehicle import Vehicle

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
