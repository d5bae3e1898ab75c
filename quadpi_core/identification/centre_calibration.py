# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How the centre of intervals moves with past errors, from flights left out: see `models.moving_centre`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.alarm_calibration import Judged, LiveErrors
from quadpi_core.models.interval_rules import FlightErrors, HeldOutRule, inside_range
from quadpi_core.models.model_kind import Fitted
from quadpi_core.models.moving_centre import (
    MEMORIES_S,
    MovedAxis,
    MovingCentre,
    delay,
    delayed,
    means_of,
    regressed,
    usable,
)


class LeftErrors(NamedTuple):
    """What the live path would err on a flight by the model of the others.

    Attributes:
        rate_hz: of the samples.
        errors: by axis held; the spread is the half width of the interval.
    """

    rate_hz: float
    errors: Mapping[str, FlightErrors]


def calibrate_centre(flights: Sequence[LeftErrors], confidence: float) -> MovingCentre | None:
    """How intervals move; None where none of the flights lies mostly inside the range of the others.

    Args:
        flights: left out in turn.
        confidence: of their intervals.
    """
    axes = {}
    for axis in flights[0].errors if flights else ():
        own = [(rate_hz, errors[axis]) for rate_hz, errors in flights if errors[axis].usual]
        if not own:
            return None
        known = usable(min(rate for rate, _ in own))
        means = [means_of(delayed(one.error, delay(rate)), rate)[:, known] for rate, one in own]
        coefficients = np.zeros(len(MEMORIES_S))
        coefficients[known], moves = regressed(
            [(one.error, m) for (_, one), m in zip(own, means, strict=True)]
        )
        moved = [
            FlightErrors(one.error - by, one.spread, one.inside).factors()
            for (_, one), by in zip(own, moves, strict=True)
        ]
        narrower = HeldOutRule(np.stack(moved), len(moved)).factor(confidence)
        axes[axis] = MovedAxis(coefficients, min(narrower, 1.0))
    return MovingCentre(axes) if axes else None


def errors_left(
    flights: Sequence[Judged], live: Sequence[LiveErrors], left_out: Sequence[Fitted], factors: Array
) -> list[LeftErrors]:
    """Errors of each flight left out, at all samples if the models of the others are at hand.

    Args:
        flights: of the identification.
        live: their errors, of all samples or every k-th; see `alarm_calibration.live_errors`.
        left_out: the model without each flight in turn, or none.
        factors: (6,) half width of an interval per unit of spread.
    """
    found = []
    extremes = [np.stack((flight.inputs.min(axis=0), flight.inputs.max(axis=0))) for flight in flights]
    for k, (flight, (every, errors)) in enumerate(zip(flights, live, strict=True)):
        rows = np.flatnonzero(flight.judged.known) if left_out else every
        if len(rows) < 2 or not errors:
            continue
        halves = {
            axis: FlightErrors(one.error, one.spread * factors[AXES.index(axis)], one.inside)
            for axis, one in errors.items()
        }
        if left_out:
            others = np.concatenate([own for place, own in enumerate(extremes) if place != k])
            halves = _all_samples(flight, rows, left_out[k], factors, others, list(errors))
        found.append(LeftErrors(1.0 / float(np.median(np.diff(flight.time[rows]))), halves))
    return found


def _all_samples(
    flight: Judged,
    rows: npt.NDArray[np.int64],
    fitted: Fitted,
    factors: Array,
    others: Array,
    axes: Sequence[str],
) -> dict[str, FlightErrors]:
    inputs = flight.judged.inputs[rows]
    said = fitted.evaluate(inputs, factors, flight.judged.derivatives[rows])
    error = flight.judged.wrench[rows] - 0.5 * (said.lower + said.upper)
    half, inside = 0.5 * (said.upper - said.lower), inside_range(inputs, others)
    columns = {axis: AXES.index(axis) for axis in axes}
    return {axis: FlightErrors(error[:, k], half[:, k], inside) for axis, k in columns.items()}
