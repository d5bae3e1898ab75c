# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Columns of tolerances of a simulation that is known by its wrench alone."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.discrepancy.simulations import Tolerances
from quadpi_core.discrepancy.uncertain_parts import (
    EVEN,
    LINEAR,
    ROTORS,
    SQUARED,
    TOGETHER,
    Part,
    of_coefficient,
    part_columns,
)
from quadpi_core.flight import AXES

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
