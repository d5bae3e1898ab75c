# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Resampling of streams to another time grid: linear between samples, never beyond them or across a gap."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.signals.chain import make_continuous

RATE_SPAN = compiled.RATE_SPAN
# Share of a step by which the last sample may be early, as stamps are whole nanoseconds.
_ROUNDING = 1e-4

Mask: TypeAlias = npt.NDArray[np.bool_]


class Resampled(NamedTuple):
    """Values (M, C) at the requested stamps, and a mask of those between samples without a gap.

    Rows where `valid` is False hold the nearest sample.
    """

    values: Array
    valid: Mask


def interpolate(time_ns: Stamps, values: Array, at_ns: Stamps, max_gap_ns: int) -> Resampled:
    """Interpolate vectors (N, C), sampled at increasing stamps (N,), linearly to stamps (M,)."""
    first = int(np.searchsorted(time_ns, at_ns[0])) if len(at_ns) else 0
    if np.array_equal(time_ns[first : first + len(at_ns)], at_ns):
        return Resampled(values[first : first + len(at_ns)].copy(), np.ones(len(at_ns), dtype=bool))
    after = np.clip(np.searchsorted(time_ns, at_ns), 1, max(len(time_ns) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(time_ns) - 1)
    gap = np.maximum(time_ns[after] - time_ns[before], 1)
    fraction = np.clip((at_ns - time_ns[before]) / gap, 0.0, 1.0)[:, None]
    resampled = values[before] + fraction * (values[after] - values[before])
    exact = (at_ns == time_ns[before]) | (at_ns == time_ns[after])
    inside = (at_ns >= time_ns[0]) & (at_ns <= time_ns[-1]) & (gap <= max_gap_ns)
    return Resampled(resampled, exact | inside)


def interpolate_columns(time: Array | Stamps, values: Array, at: Array | Stamps) -> Array:
    """Values (M, C) at times (M,), linear between samples (N, C) at times (N,), constant beyond them."""
    # np.interp rounds otherwise by processor.
    time, at = time.astype(np.float64), np.clip(at, time[0], time[-1]).astype(np.float64)
    before = np.clip(np.searchsorted(time, at, side="right") - 1, 0, max(len(time) - 2, 0))
    after = np.minimum(before + 1, len(time) - 1)
    since, span = at - time[before], time[after] - time[before]
    share = np.divide(since, span, out=np.zeros_like(since), where=span > 0.0)[:, None]
    interpolated: Array = (1.0 - share) * values[before] + share * values[after]
    return interpolated


def interpolate_attitude(time_ns: Stamps, attitude: Array, at_ns: Stamps, max_gap_ns: int) -> Resampled:
    """Interpolate unit quaternions (N, 4) of any signs: linear in components, then normalised.

    Between samples that differ by an angle a this strays from the constant-rate rotation by less than a³/200
    rad: 5e-6 rad for 0.1 rad.
    """
    values, valid = interpolate(time_ns, make_continuous(attitude), at_ns, max_gap_ns)
    return Resampled(values / np.linalg.norm(values, axis=1, keepdims=True), valid)


def nominal_rate(time_ns: Stamps) -> float:
    """Sample rate in Hz of a sensor, whether or not samples were lost.

    The median over spans of ten samples: neither lost samples nor stamps rounded to a millisecond change it.
    """
    span = min(RATE_SPAN, len(time_ns) - 1)
    return float(1e9 * span / np.median(time_ns[span:] - time_ns[:-span]))


def uniform_stamps(time_ns: Stamps) -> Stamps:
    """The grid of stamps at the nominal rate that lies between the first sample and the last."""
    step_ns = 1e9 / nominal_rate(time_ns)
    count = int((time_ns[-1] - time_ns[0]) / step_ns + _ROUNDING) + 1
    stamps: Stamps = np.minimum(
        time_ns[0] + np.rint(step_ns * np.arange(count)).astype(np.int64), time_ns[-1]
    )
    return stamps


def first_gap(time_ns: Stamps, max_gap_ns: int) -> int | None:
    """Index of the first sample more than `max_gap_ns` after the previous one; None if there is none."""
    late = np.diff(time_ns) > max_gap_ns
    return int(np.argmax(late)) + 1 if late.any() else None
