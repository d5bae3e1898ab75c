# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bring streams to another time grid: linear between samples, never beyond them nor across a gap."""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.signals.chain import make_continuous

Mask: TypeAlias = npt.NDArray[np.bool_]


class Resampled(NamedTuple):
    """Values (M, C) at the wanted stamps, and which of them lie between samples close enough.

    Rows where `valid` is False hold the nearest sample.
    """

    values: Array
    valid: Mask


def interpolate(time_ns: Stamps, values: Array, at_ns: Stamps, max_gap_ns: int) -> Resampled:
    """Interpolate vectors (N, C), sampled at increasing stamps (N,), linearly to stamps (M,)."""
    after = np.clip(np.searchsorted(time_ns, at_ns), 1, max(len(time_ns) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(time_ns) - 1)
    gap = np.maximum(time_ns[after] - time_ns[before], 1)
    fraction = np.clip((at_ns - time_ns[before]) / gap, 0.0, 1.0)[:, None]
    resampled = values[before] + fraction * (values[after] - values[before])
    exact = (at_ns == time_ns[before]) | (at_ns == time_ns[after])
    inside = (at_ns >= time_ns[0]) & (at_ns <= time_ns[-1]) & (gap <= max_gap_ns)
    return Resampled(resampled, exact | inside)


def interpolate_attitude(time_ns: Stamps, attitude: Array, at_ns: Stamps, max_gap_ns: int) -> Resampled:
    """Interpolate unit quaternions (N, 4) of any signs: linear in components, then normalised.

    Between samples that differ by an angle a this strays from the constant-rate rotation by less than a³/200
    rad: 5e-6 rad for 0.1 rad.
    """
    continuous = np.array(attitude, dtype=np.float64)
    make_continuous(continuous, continuous[0])
    values, valid = interpolate(time_ns, continuous, at_ns, max_gap_ns)
    return Resampled(values / np.linalg.norm(values, axis=1, keepdims=True), valid)


def uniform_stamps(time_ns: Stamps) -> Stamps:
    """Stamps from the first to the last at most, spaced by the median step: the nominal grid of a sensor."""
    return np.arange(time_ns[0], time_ns[-1] + 1, int(np.median(np.diff(time_ns))), dtype=np.int64)


def first_gap(time_ns: Stamps, max_gap_ns: int) -> int | None:
    """Index of the first sample that comes more than `max_gap_ns` after the one before; None if none does."""
    late = np.diff(time_ns) > max_gap_ns
    return int(np.argmax(late)) + 1 if late.any() else None
