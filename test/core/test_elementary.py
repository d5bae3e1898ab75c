# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Elementary functions of the core: exact to two units in the last place, and the same bits everywhere."""

from __future__ import annotations

from collections.abc import Callable
from hashlib import sha256
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from quadpi_core import core
from quadpi_core.core import compiled
from quadpi_core.frames import Array

Exact = Callable[[NDArray[np.longdouble]], Any]
RANGE = np.random.default_rng(1)
# Of all sizes, of usual size, and near multiples of π/2 and of ln 2, where a reduction could lose bits.
SIZES = np.concatenate([10.0 ** RANGE.uniform(-300.0, 5.0, 20_000) * sign for sign in (-1.0, 1.0)])
USUAL = RANGE.uniform(-10.0, 10.0, 50_000)
MULTIPLES = np.outer(np.arange(-2000, 2001), [np.pi / 2.0, np.log(2.0)]).ravel()
ARGUMENTS = np.concatenate((SIZES, USUAL, MULTIPLES))
EXPONENTS = ARGUMENTS[np.abs(ARGUMENTS) < 700.0]
# Units in the last place.
SINGLE: dict[str, tuple[Any, Exact, Array, float]] = {
    "sine": (compiled.sine, np.sin, ARGUMENTS, 1.0),
    "cosine": (compiled.cosine, np.cos, ARGUMENTS, 1.0),
    "exponential": (compiled.exponential, np.exp, EXPONENTS, 1.0),
    "hyperbolic_tangent": (compiled.hyperbolic_tangent, np.tanh, EXPONENTS, 2.5),
}
more_exact_than_a_double = pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="long double is no longer than double here"
)


def units_off(values: Array, exact: NDArray[np.longdouble]) -> float:
    """Largest error in units in the last place of the exact value."""
    return float(np.max(np.abs(values - exact) / np.spacing(np.abs(exact).astype(float))))


@more_exact_than_a_double
@pytest.mark.parametrize("name", SINGLE)
def test_errors_are_few_units_in_the_last_place(name: str) -> None:
    function, exact, arguments, most = SINGLE[name]
    values = np.empty_like(arguments)
    function(arguments, values)
    assert units_off(values, exact(arguments.astype(np.longdouble))) < most


@more_exact_than_a_double
def test_the_angle_of_a_point_is_right_in_every_quadrant() -> None:
    y = np.concatenate((SIZES, USUAL, SIZES[::-1]))
    x = np.concatenate((SIZES[::-1], USUAL[::-1], SIZES * 1.06))
    values = np.empty_like(y)
    compiled.arctangent(y, x, values)
    exact = np.arctan2(y.astype(np.longdouble), x.astype(np.longdouble))
    normal = np.abs(exact) > 1e-300
    assert units_off(values[normal], exact[normal]) < 2.0
    np.testing.assert_allclose(values[~normal], exact[~normal].astype(float), atol=1e-315)


def test_angles_beyond_all_flights_are_as_good_as_the_angle_itself() -> None:
    angles = RANGE.uniform(1e7, 1e15, 10_000)
    values = np.empty_like(angles)
    compiled.sine(angles, values)
    assert np.all(np.abs(values - np.sin(angles)) < 0.5 * np.spacing(angles) + 1e-15)


def test_arrays_of_any_shape_and_numbers() -> None:
    angles = RANGE.uniform(-1.5, 1.5, (2, 3, 4))[:, ::2]
    np.testing.assert_allclose(core.sine(angles), np.sin(angles), rtol=1e-15)
    np.testing.assert_allclose(core.cosine(angles), np.cos(angles), rtol=1e-14)
    np.testing.assert_allclose(core.arctangent(angles, angles[0]), np.arctan2(angles, angles[0]), rtol=1e-15)
    np.testing.assert_allclose(core.arcsine(np.sin(angles)), angles, rtol=1e-14)
    assert core.exponential(-1) == pytest.approx(np.exp(-1.0), rel=1e-15)
    assert core.hyperbolic_tangent([0.5])[0] == pytest.approx(np.tanh(0.5), rel=1e-15)


def test_limits_and_what_is_no_number() -> None:
    given = np.array([0.0, -0.0, 1e-310, np.inf, -np.inf, np.nan, 710.0, -746.0])
    values = np.empty_like(given)
    compiled.exponential(given, values)
    np.testing.assert_array_equal(values, [1.0, 1.0, 1.0, np.inf, 0.0, np.nan, np.inf, 0.0])
    compiled.hyperbolic_tangent(given, values)
    np.testing.assert_array_equal(values, [0.0, 0.0, 1e-310, 1.0, -1.0, np.nan, 1.0, -1.0])
    compiled.cosine(given[:6], values[:6])
    np.testing.assert_array_equal(values[:6], [1.0, 1.0, 1.0, np.nan, np.nan, np.nan])


def test_angles_of_points_with_zeros_and_infinities_are_those_of_ieee_754() -> None:
    special = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 5e-324, 1.7e308]
    y, x = (side.ravel() for side in np.meshgrid(special, special))
    values = np.empty_like(y)
    compiled.arctangent(np.ascontiguousarray(y), np.ascontiguousarray(x), values)
    np.testing.assert_allclose(values, np.arctan2(y, x), rtol=2e-16, atol=0.0)
    np.testing.assert_array_equal(np.signbit(values[values == 0.0]), np.signbit(y[values == 0.0]))


def test_bits_are_those_of_every_other_computer() -> None:
    # Arguments by additions and products alone: numpy's own functions differ by processor.
    arguments = (np.arange(-20_000, 20_000) + 0.37) * 0.00173
    arguments = np.concatenate((arguments, arguments * 1e-6, arguments * arguments * arguments))
    arguments = arguments[np.abs(arguments) < 700.0]
    digest = sha256()
    for function, *_ in SINGLE.values():
        values = np.empty_like(arguments)
        function(arguments, values)
        digest.update(values.tobytes())
    values = np.empty_like(arguments)
    compiled.arctangent(arguments, arguments[::-1].copy(), values)
    digest.update(values.tobytes())
    assert digest.hexdigest() == ("fad80db40c27153cb2774058140573db55f31d88eaa223803d25137e04433c90")
