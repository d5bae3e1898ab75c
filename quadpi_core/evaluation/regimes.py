# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage by flight regime: bins of speed, rotor speed and height."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array

MOST_BINS = 8


@dataclass(frozen=True)
class RegimeBins:
    """Samples, coverage and mean width (N or Nm) in each bin; the last two are None where a bin is empty."""

    n: list[int]
    picp: list[float | None]
    mpiw: list[float | None]


def round_edges(values: Array, most: int = MOST_BINS) -> Array:
    """Edges of at most so many equal bins over the values, each 1, 2 or 5 times a power of ten wide."""
    lowest, highest = float(values.min()), float(values.max())
    extent = highest - lowest
    if extent < 1e-6 * max(abs(lowest), abs(highest), 1.0):
        # A constant: what rounding left of it is no range.
        extent = 1.0
    scale = 10.0 ** np.floor(np.log10(extent / most))
    for step in scale * np.array([1.0, 2.0, 5.0, 10.0, 20.0]):
        first, last = np.floor(lowest / step), np.floor(highest / step) + 1.0
        if last - first <= most:
            break
    # Rounded to what the step resolves: 0.3, not 0.30000000000000004.
    digits = max(0, 1 - int(np.floor(np.log10(step))))
    edges: Array = np.round(np.arange(first, last + 1.0) * step, digits)
    return edges


def by_bin(values: Array, inside: npt.NDArray[np.bool_], width: Array, edges: Array) -> RegimeBins:
    """Samples, coverage and mean width in each bin [edge, next edge).

    Args:
        values: (N,) that the bins are of, all within the edges.
        inside: (N,) whether the measurement lay in its interval.
        width: (N,) of the interval.
        edges: (B + 1,) increasing.
    """
    bins = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(bins, minlength=len(edges) - 1)

    def mean(quantity: npt.NDArray[Any]) -> list[float | None]:
        sums = np.bincount(bins, weights=quantity, minlength=len(edges) - 1)
        return [float(total / n) if n else None for total, n in zip(sums, count, strict=True)]

    return RegimeBins(count.tolist(), mean(inside), mean(width))
