# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Residuals of flights over time, in the band of the comparison: as they are, beyond tolerance, explained.

The regression goes among frequencies; people and bins want time. A flight has as many samples here as it has
rows there, and mean squares are the same in both.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import residual_weights
from quadpi_core.discrepancy.search import Found
from quadpi_core.frames import Array, rotation_matrix

# Chance that some coefficient of a simulation is further off than it is allowed to be here.
_BEYOND = 0.025
VARIABLES = ("speed", "u", "v", "w", "height", "rotor_speed", "rates", "heading", "north", "east", "time")


class Residual(NamedTuple):
    """One flight; wrenches (B, 6) in N and Nm, body axes, measured less simulated, up to the band's end.

    Attributes:
        flight: its name.
        time: (B,) s since the flight began.
        variables: (B,) each, by names of `VARIABLES`: m/s through the air, m above the world's origin,
            rad/s (mean of the rotors; magnitude of the rates), degrees, m north and east of that origin, s
            since the first sample.
        before: as it is.
        beyond: with coefficients where, beside the effects, they fit best within their tolerances.
        after: with effects and coefficients as found on all other flights.
    """

    flight: str
    time: Array
    variables: dict[str, Array]
    before: Array
    beyond: Array
    after: Array


def residuals(found: Found) -> list[Residual]:
    """Residuals of the flights of a search, in their order."""
    design = found.design
    tolerances = design.tolerances
    # Beside the effects that were found: alone, coefficients would bend to take their place.
    without = found.fit.left.copy()
    without[tolerances] = 0.0
    projected = design.gram[tolerances, : len(without)] @ without
    fitted = within_tolerance(design.gram[np.ix_(tolerances, tolerances)], projected[:, None])[:, 0]
    before = residual_weights(len(without), ())
    beyond = before.copy()
    beyond[tolerances] -= fitted
    result = []
    for place, (flight, held_out) in enumerate(zip(design.flights, found.closing.left_out, strict=True)):
        samples = len(flight.thinned)
        at = places(len(design.bands[place]), samples)
        rows = [design.combined(place, weights) for weights in (before, beyond, held_out.left)]
        series = over_time(np.stack(rows, axis=2), samples)
        result.append(
            Residual(
                flight=flight.thinned.name,
                time=flight.thinned.time[at],
                variables={name: values[at] for name, values in variables(flight).items()},
                before=series[:, :, 0],
                beyond=series[:, :, 1],
                after=series[:, :, 2],
            )
        )
    return result


def over_time(rows: Array, samples: int) -> Array:
    """Rows (6, B, C) among frequencies, as `whitening.spectrum` gives them, over time (B, 6, C).

    Args:
        rows: see :class:`quadpi_core.discrepancy.whitening.Spectrum`.
        samples: of the flight that they are of.
    """
    count = rows.shape[1]
    kept = (count + 1) // 2
    transformed = rows[:, :kept].astype(complex)
    transformed[:, 1:] = (rows[:, 1:kept] + 1j * rows[:, kept:]) / np.sqrt(2.0)
    series = np.fft.irfft(transformed, n=count, axis=1, norm="ortho") * np.sqrt(count / samples)
    return np.ascontiguousarray(np.moveaxis(series, 0, 1))


def places(count: int, samples: int) -> npt.NDArray[np.intp]:
    """Indices (count,) of the samples that lie where :func:`over_time` has its own."""
    at: npt.NDArray[np.intp] = np.minimum(
        np.round(np.arange(count) * (samples / count)).astype(np.intp), samples - 1
    )
    return at


def most_off(count: int) -> float:
    """Tolerances that the furthest of so many coefficients may be off: nearly all simulations are within."""
    return float(norm.isf(_BEYOND / (2.0 * count)))


def within_tolerance(gram: Array, projected: Array) -> Array:
    """Coefficients (K, D) that fit best, none further off than :func:`most_off`.

    One that would go further is held at its bound, and the others are fitted again.

    Args:
        gram: (K, K) of the columns of tolerances, whitened.
        projected: (K, D) of D residuals on them.
    """
    matrix, most = gram + np.eye(len(gram)), most_off(len(gram))
    best = np.linalg.solve(matrix, projected).astype(float)
    for draw in np.flatnonzero((np.abs(best) > most).any(axis=0)):
        own = best[:, draw]
        held = np.zeros(len(own), dtype=bool)
        while (beyond := ~held & (np.abs(own) > most)).any():
            held |= beyond
            own[held] = np.clip(own[held], -most, most)
            free = ~held
            rest: Array = projected[free, draw] - matrix[np.ix_(free, held)] @ own[held]
            own[free] = np.linalg.solve(matrix[np.ix_(free, free)], rest)
    return best


def variables(compared: Compared) -> dict[str, Array]:
    """What a residual may depend on, (M,) each, by the names of `VARIABLES`."""
    states = compared.states
    velocity = states["velocity_air"]
    ahead = rotation_matrix(states["attitude"])[:, :2, 0]
    time = compared.thinned.time
    return {
        "speed": np.linalg.norm(velocity, axis=1),
        "u": velocity[:, 0],
        "v": velocity[:, 1],
        "w": velocity[:, 2],
        "height": -states["position"][:, 2],
        "rotor_speed": states["rotor_speeds"].mean(axis=1),
        "rates": np.linalg.norm(states["rates"], axis=1),
        "heading": np.degrees(np.arctan2(ahead[:, 1], ahead[:, 0])),
        "north": states["position"][:, 0],
        "east": states["position"][:, 1],
        "time": time - time[0],
    }
