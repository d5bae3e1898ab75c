# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a model leaves in every flight where inputs change: a ridge regression on blocks of 0.1 s.

Rotors, wake and sensors answer within some tenths of a second in a way that a model of the instant does not
know, and that repeats from flight to flight: it is no evidence that the vehicle has changed. The regression
knows changes of the inputs alone. Were it to know the inputs, it would take a rotor that must turn faster for
good for part of the manoeuvre, and hide it (experiments/results/alarm.md).

How much the slopes shrink is chosen on each axis for flights left out; where none helps there, the axis has
no slopes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.alarm_limits import INPUT_CHANGES, RepeatingPart
from quadpi_core.records import Records

# Shares of the summed squares of the changes, scaled to a variance of 1, that are added to them.
_RIDGES = (1e-3, 1e-2, 1e-1, 1.0)
# Inputs that follow from the others: they would only add to what must be learned.
_FOLLOWS = np.array([name.endswith("v_in") or name.startswith("mu") for name in INPUT_NAMES])
# Flights are left out in as many groups at most.
GROUPS = 12


class Learned(NamedTuple):
    """What flights leave each time, and their blocks less what the others tell of it.

    Attributes:
        part: None where it helps on no axis.
        blocks: of each flight.
    """

    part: RepeatingPart | None
    blocks: list[Records]


def learn_repeating(flights: Sequence[Records], axes: Sequence[str]) -> Learned:
    """Learn it from the blocks (N,) of at least two flights."""
    changes = [input_changes(blocks) for blocks in flights]
    lower, upper = (np.array([end(one, axis=(0, 1)) for one in changes]) for end in (np.min, np.max))
    spread = np.concatenate(changes).std(axis=(0, 1))
    spread[(spread == 0.0) | _FOLLOWS] = np.inf
    columns = [AXES.index(axis) for axis in axes]
    residuals = [_centred(blocks["residual"][:, columns]) for blocks in flights]
    scaled = [_flat(one / spread) for one in changes]
    grams = np.array([one.T @ one for one in scaled])
    sides = np.array([one.T @ of for one, of in zip(scaled, residuals, strict=True)])
    counts = np.array([len(one) for one in changes])

    def slopes(of: npt.NDArray[np.bool_], ridge: float) -> Array:
        """Those (INPUT_CHANGES · 19, axes) of some of the flights."""
        more = ridge * counts[of].sum() * np.eye(grams.shape[1])
        return np.linalg.solve(grams[of].sum(axis=0) + more, sides[of].sum(axis=0))

    # What the others say of each flight (N, ridges, axes), 0 first.
    said = [np.zeros((count, 1 + len(_RIDGES), len(axes))) for count in counts]
    groups = np.arange(len(flights)) % min(GROUPS, len(flights))
    for group in range(groups.max() + 1):
        others = groups != group
        low, high = lower[others].min(axis=0), upper[others].max(axis=0)
        of_others = [slopes(others, ridge) for ridge in _RIDGES]
        for k in np.flatnonzero(~others):
            inside = _flat(np.clip(changes[k], low, high) / spread)
            said[k][:, 1:] = np.stack([inside @ one for one in of_others], axis=1)
    errors = sum(
        np.square(_centred(of[:, np.newaxis] - answers)).sum(axis=0)
        for of, answers in zip(residuals, said, strict=True)
    )
    best = np.argmin(errors, axis=0)
    blocks = [one.copy() for one in flights]
    own: dict[str, dict[str, tuple[float, float]]] = {}
    for place in map(int, np.flatnonzero(best)):
        for one, answers in zip(blocks, said, strict=True):
            one["residual"][:, columns[place]] -= answers[:, best[place], place]
        found = slopes(groups >= 0, _RIDGES[best[place] - 1])[:, place].reshape(INPUT_CHANGES, -1)
        found = (found / spread).tolist()
        own[axes[place]] = {name: (found[0][k], found[1][k]) for k, name in enumerate(INPUT_NAMES)}
    if not own:
        return Learned(None, blocks)
    ends = (lower.min(axis=0), upper.max(axis=0))
    lowest, highest = (dict(zip(INPUT_NAMES, values.tolist(), strict=True)) for values in ends)
    return Learned(RepeatingPart(lowest, highest, own), blocks)


def input_changes(blocks: Records) -> Array:
    """Changes (N, INPUT_CHANGES, 19) of the inputs of blocks, the latest first.

    To a block that is missing nothing has changed, and all of it from there.
    """
    numbers, later = blocks["number"], blocks["inputs"]
    changes = np.empty((len(blocks), INPUT_CHANGES, len(INPUT_NAMES)))
    for back in range(INPUT_CHANGES):
        places = np.searchsorted(numbers, numbers - back - 1)
        there = numbers[places] == numbers - back - 1
        before = np.where(there[:, np.newaxis], blocks["inputs"][places], later)
        changes[:, back], later = later - before, before
    return changes


def _flat(changes: Array) -> Array:
    return changes.reshape(len(changes), -1)


def _centred(of_flight: Array) -> Array:
    """Less the mean of the flight: its constant does not repeat."""
    return of_flight - of_flight.mean(axis=0)
