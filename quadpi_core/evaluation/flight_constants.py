# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How flights differ: the constant that each leaves of a model on an axis, beside those of the others."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.alarm_limits import ChangeLimits
from quadpi_core.monitor.change import AXIS_NOISE, BLOCK_S

# Fewest blocks of a flight, 1 s, and flights, that are compared.
_FEWEST_BLOCKS, _FEWEST_FLIGHTS = 10, 3
# Deviations of a difference that is told, the largest of those between all flights.
_TOLD = 4.0
# Least deviation that is told, N and Nm.
_FINEST = 1e-6
# What a residual to the positive and to the negative side says, and the unit.
_SIDES = {
    "Fx": ("more force forward", "more force backward", "mN"),
    "Fy": ("more force to the right", "more force to the left", "mN"),
    "Fz": ("more force downward", "more force upward", "mN"),
    "Mx": ("more moment to the right in roll", "more moment to the left in roll", "mNm"),
    "My": ("more moment nose up", "more moment nose down", "mNm"),
}


class Constant(NamedTuple):
    """A constant of a flight and its standard deviation, N or Nm."""

    value: float
    deviation: float


def flight_constants(limits: ChangeLimits, time: Array, errors: Array) -> dict[str, Constant]:
    """What a flight leaves of the model all the time, by axis: least squares with the noise of sound flights.

    Args:
        limits: of the model.
        time: (N,) s.
        errors: (N, 6) measured − predicted.
    """
    numbers, starts, counts = np.unique(
        np.floor(time / BLOCK_S).astype(np.int64), return_index=True, return_counts=True
    )
    if len(numbers) < _FEWEST_BLOCKS:
        return {}
    means = np.add.reduceat(errors, starts, axis=0) / counts[:, np.newaxis]
    constants = {}
    for axis, left in limits.axes.items():
        noise = np.zeros(1, AXIS_NOISE)
        for name in ("keep", "process", "white"):
            noise[name] = getattr(left, name)
        whitened, _, ones, _ = room = np.empty((4, len(numbers)))
        compiled.whiten_blocks(noise, np.ascontiguousarray(means[:, AXES.index(axis)]), numbers, *room)
        known = float(ones @ ones)
        value = float(ones @ whitened) / known
        spread = float(np.sqrt(np.mean(np.square(whitened - value * ones))))
        # The mean of a walk deviates by a third of the variance at its end.
        walked = left.walk * len(numbers) / 3.0
        constants[axis] = Constant(value, float(np.sqrt(spread * spread / known + walked)))
    return constants


def differences(flights: Mapping[str, Mapping[str, Constant]]) -> Iterator[str]:
    """Sentences on the flights that differ most from the others, one an axis, if by more than noise."""
    for axis, (positive, negative, unit) in _SIDES.items():
        own = {name: constants[axis] for name, constants in flights.items() if axis in constants}
        if len(own) < _FEWEST_FLIGHTS:
            continue
        names = sorted(own, key=lambda name: own[name].value)
        values, squares = np.array([(own[name].value, own[name].deviation ** 2) for name in names]).T
        split = int(np.argmax(np.diff(values))) + 1
        parts = (slice(0, split), slice(split, None))
        fewer, others = sorted(parts, key=lambda part: len(names[part]))
        difference = float(values[fewer].mean() - values[others].mean())
        variance = sum(float(squares[part].sum()) / len(names[part]) ** 2 for part in parts)
        gap = float(values[split] - values[split - 1])
        if gap <= _TOLD * float(np.sqrt(squares[split] + squares[split - 1])):
            continue
        side = positive if difference > 0.0 else negative
        unsure = max(float(np.sqrt(variance)), _FINEST)
        # To the first digit that is not sure.
        place = -math.floor(math.log10(1e3 * unsure))
        size, more_or_less = (f"{round(1e3 * of, place):g}" for of in (abs(difference), unsure))
        yield f"{', '.join(sorted(names[fewer]))}: {size} ± {more_or_less} {unit} {side} than the others"
