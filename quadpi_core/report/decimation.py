# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fewer samples to draw, without losing a peak."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array

_FEWEST_BINS, _MOST_BINS = 150, 1000


def bins_within(samples: int, lines: int) -> int:
    """Parts to cut each flight into so that `lines` lines draw about so many samples; enough to be read."""
    return max(_FEWEST_BINS, min(_MOST_BINS, samples // (2 * max(1, lines))))


def extreme_samples(low: Array, high: Array, bins: int) -> npt.NDArray[np.intp]:
    """Indices to draw of a band (N,): in each of `bins` equal parts where it is lowest and highest.

    A line is a band with `low` equal to `high`. Ends are kept, so at most 2 · bins + 2 indices, sorted.
    """
    size = len(low)
    if size <= 2 * bins:
        return np.arange(size)
    starts = np.arange(bins + 1) * size // bins
    parts = [slice(start, stop) for start, stop in pairwise(starts)]
    lowest = [part.start + np.argmin(low[part]) for part in parts]
    highest = [part.start + np.argmax(high[part]) for part in parts]
    return np.unique(np.concatenate(([0, size - 1], lowest, highest)))
