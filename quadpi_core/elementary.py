# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sine, exponential and others over arrays, the same bits on every computer: those of the compiled core.

Those of numpy and of the C library differ by processor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from quadpi_core.core import compiled

Array: TypeAlias = NDArray[np.float64]


def sine(angles: ArrayLike) -> Array:
    """Sine of each of angles (...) rad."""
    return _of_each(compiled.sine, angles)


def cosine(angles: ArrayLike) -> Array:
    """Cosine of each of angles (...) rad."""
    return _of_each(compiled.cosine, angles)


def arctangent(y: ArrayLike, x: ArrayLike) -> Array:
    """Angles (...) rad, from -π to π, of points (x, y), both (...)."""
    return _of_each(compiled.arctangent, y, x)


def arcsine(sines: ArrayLike) -> Array:
    """Angles (...) rad, from -π/2 to π/2, of sines (...) from -1 to 1."""
    given = np.asarray(sines, float)
    return arctangent(given, np.sqrt((1.0 - given) * (1.0 + given)))


def exponential(exponents: ArrayLike) -> Array:
    """E to the power of each of (...)."""
    return _of_each(compiled.exponential, exponents)


def hyperbolic_tangent(arguments: ArrayLike) -> Array:
    """Hyperbolic tangent of each of (...)."""
    return _of_each(compiled.hyperbolic_tangent, arguments)


# The numpy function of the same values, for code that is to run without quadpi.
IN_NUMPY: Mapping[Callable[..., Array], str] = {
    sine: "np.sin",
    cosine: "np.cos",
    arctangent: "np.arctan2",
    arcsine: "np.arcsin",
    exponential: "np.exp",
    hyperbolic_tangent: "np.tanh",
}


def _of_each(function: Callable[..., None], *arguments: ArrayLike) -> Array:
    given = np.broadcast_arrays(*(np.asarray(one, float) for one in arguments))
    values = np.empty(given[0].shape)
    function(*map(np.ascontiguousarray, given), values)
    result: Array = values[()]
    return result
