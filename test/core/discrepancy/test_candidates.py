# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates of a search and tolerances of an unknown simulation: variants, sizes, and their columns."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.candidates import (
    EVEN,
    LINEAR,
    ROTORS,
    SQUARED,
    TOGETHER,
    Part,
    candidates,
    first_point,
    linearise,
    of_coefficient,
    part_columns,
    typical_sizes,
)
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.simulations import Tolerances
from quadpi_core.discrepancy.unmeasured_states import Started
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES
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


TOLERANCES = Tolerances(thrust=0.01, coefficient=0.1, inertia=0.02)
SAMPLES = 7


def drawn(seed):
    return np.random.default_rng(seed).standard_normal((SAMPLES, 6))


@pytest.fixture
def parts():
    """Of each law one, but two of the first order in the motion."""
    return [
        Part(ROTORS, drawn(0), ROTORS),
        Part("rates", drawn(1), LINEAR),
        Part("airspeed", drawn(2), LINEAR),
        Part(EVEN, drawn(3), EVEN),
        Part(SQUARED, drawn(4), SQUARED),
    ]


def by_name(parts):
    columns = part_columns(parts, TOLERANCES)
    found = {column.name: column for column in columns}
    assert len(found) == len(columns)
    return found


def test_own_and_shared_variance_are_that_of_the_tolerance(parts):
    """Of each part alone in its law, in every axis and at every instant."""
    for part in parts[1:]:
        columns = by_name([part])
        variance = sum(np.square(column.wrench) for column in columns.values())
        np.testing.assert_allclose(variance, np.square(0.1 * part.wrench))


def test_half_of_the_variance_of_a_law_is_that_of_all_its_axes(parts):
    assert TOGETHER.value == 0.5
    (part,) = parts[3:4]
    columns = by_name([part])
    whole = np.square(columns["Fz, Mx and My of airspeed, even"].wrench[:, 2:5])
    np.testing.assert_allclose(whole, 0.5 * np.square(0.1 * part.wrench[:, 2:5]))


def test_thrust_and_torque_of_rotors_are_known_axis_by_axis(parts):
    columns = by_name(parts[:1])
    shares = {"Fz": 0.01, "Mx": 0.02, "My": 0.02, "Fx": 0.1, "Fy": 0.1, "Mz": 0.1}
    assert set(columns) == {f"{axis} of rotors" for axis in AXES} == {f"{axis} of rotors" for axis in shares}
    for index, axis in enumerate(AXES):
        column = columns[f"{axis} of rotors"]
        assert column.law == ""
        np.testing.assert_allclose(column.wrench[:, index], shares[axis] * parts[0].wrench[:, index])


def test_a_column_of_a_part_is_of_one_axis(parts):
    columns = by_name(parts)
    for part in parts:
        for index, axis in enumerate(AXES):
            others = np.delete(columns[f"{axis} of {part.name}"].wrench, index, axis=1)
            assert not others.any()


def test_parts_of_one_law_are_wrong_together(parts):
    columns = by_name(parts)
    shared = {name for name in columns if " and " in name}
    laws = (LINEAR, EVEN, SQUARED)
    assert shared == {f"{axes} of {law}" for axes in ("Fz, Mx and My", "Fx, Fy and Mz") for law in laws}
    both = parts[1].wrench + parts[2].wrench
    forces = columns[f"Fx, Fy and Mz of {LINEAR}"].wrench
    kept = [AXES.index(axis) for axis in ("Fx", "Fy", "Mz")]
    np.testing.assert_allclose(forces[:, kept], 0.1 * np.sqrt(0.5) * both[:, kept])
    assert not np.delete(forces, kept, axis=1).any()


def test_the_law_of_a_column_names_the_one_that_holds_its_axis(parts):
    columns = by_name(parts)
    for name, column in columns.items():
        if not column.law:
            assert name.endswith(" of rotors") or " and " in name
            continue
        axis = name.partition(" of ")[0]
        assert columns[column.law].law == ""
        assert columns[column.law].wrench[:, AXES.index(axis)].any()


def test_a_coefficient_is_wrong_by_what_its_columns_add_up_to(parts):
    """Multiples of its own column and of the shared one, in tolerances of the part."""
    part, own, shared = parts[4], 1.7, -0.4
    columns = by_name([part])
    for index, axis in enumerate(AXES):
        column = columns[f"{axis} of {part.name}"]
        added = own * column.wrench + shared * columns[column.law].wrench
        expected = of_coefficient(own, shared) * 0.1 * part.wrench[:, index]
        np.testing.assert_allclose(added[:, index], expected)


def test_a_law_wrong_as_a_whole_costs_less_than_one_wrong_by_axis(parts):
    """By prior: squares of the multiples that make every coefficient of a law wrong by one tolerance."""
    columns = by_name(parts[4:])
    one = 0.1 * parts[4].wrench.ravel()
    table = np.stack([column.wrench.ravel() for column in columns.values()], axis=1)
    together = np.linalg.lstsq(table, one, rcond=None)[0]
    signs = np.tile([1.0, -1.0, 1.0, -1.0, 1.0, -1.0], SAMPLES)
    apart = np.linalg.lstsq(table, one * signs, rcond=None)[0]
    # Of each of two groups of three axes: the inverse covariance, halves beside halves, of three ones.
    inverse = np.linalg.inv(0.5 * np.eye(3) + 0.5 * np.ones((3, 3)))
    assert together @ together == pytest.approx(2.0 * inverse.sum())
    assert apart @ apart > 1.5 * (together @ together)


def test_every_flight_has_the_same_columns(parts):
    """Even one in which parts and axes are zero, as one that stands still in the air."""
    still = [part._replace(wrench=np.zeros_like(part.wrench)) for part in parts[1:]]
    flat = parts[0]._replace(wrench=parts[0].wrench * [0.0, 0.0, 1.0, 1.0, 1.0, 1.0])
    moving, hovering = part_columns(parts, TOLERANCES), part_columns([flat, *still], TOLERANCES)
    assert [(c.name, c.law) for c in moving] == [(c.name, c.law) for c in hovering]
