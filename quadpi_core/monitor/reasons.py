# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What is behind an alarm, in plain words."""

from __future__ import annotations

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.envelope import LEVERAGE_HEADROOM, WIDTH_HEADROOM
from quadpi_core.monitor.data_quality import fault_words
from quadpi_core.results import BAD_DATA, EXTRAPOLATION, LEVEL_OK, MISCOVERAGE, Alarms

# Of each kind of evidence, the strongest.
_MOST = 3
# Of the sequential test's limit, from which on an axis is named: where its warning begins.
_MISCOVERAGE_NAMED = 0.5
# Of half the training range, from which on an input is named: it may be what leverage and width come from.
_OUTSIDE = 1.05


def reasons(alarms: Alarms, row: int, causes: int | None = None) -> tuple[str, ...]:
    """Why the causes are not ok in one row, the strongest evidence first; empty where all is well.

    An input is told as its distance from the middle of its training range over half of that range, leverage
    and width over the largest in training, miscoverage as the share of recent samples outside the interval.

    Args:
        alarms: as the monitor gives them.
        row: which one.
        causes: bits of those to tell; the row's own unless given.
    """
    wanted = int(alarms.causes[row]) if causes is None else causes
    told: list[str] = []
    if alarms.level[row] == LEVEL_OK and causes is None:
        return ()
    if wanted & EXTRAPOLATION:
        ratio = 1.0 + 2.0 * alarms.input_excess[row]
        told += [f"{INPUT_NAMES[k]} {ratio[k]:.1f} x the training range" for k in _beyond(ratio, _OUTSIDE)]
        for name, ratios, scores, headroom in (
            ("leverage", alarms.leverage_ratio[row], alarms.leverage[row], LEVERAGE_HEADROOM),
            ("width", alarms.width_ratio[row], alarms.width[row], WIDTH_HEADROOM),
        ):
            # Beyond the limit of the warning or, where that is nearer, of the alarm.
            far = np.where((ratios > headroom) | (scores > 1.0), ratios, 0.0)
            told += [f"{AXES[k]} {name} {far[k]:.1f} x its peak in training" for k in _beyond(far, 0.0)]
    if wanted & MISCOVERAGE:
        told += [
            f"{AXES[k]} outside its interval {100.0 * alarms.miss_share[row, k]:.0f} % of the time"
            for k in _beyond(alarms.miscoverage[row], _MISCOVERAGE_NAMED)
        ]
    if wanted & BAD_DATA:
        told += fault_words(int(alarms.faults[row]))
    return tuple(told)


def reasons_by_row(alarms: Alarms) -> list[tuple[str, ...]]:
    """Why the causes are not ok, for each row of a block, as :func:`reasons`."""
    return [reasons(alarms, row) for row in range(len(alarms))]


def _beyond(scores: np.ndarray, limit: float) -> list[int]:
    """Places of the largest scores beyond the limit, the largest first."""
    order = np.argsort(-scores, kind="stable")[:_MOST]
    return [int(k) for k in order if scores[k] > limit]
