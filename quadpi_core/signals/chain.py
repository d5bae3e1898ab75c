# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One low-pass for all signals of a flight, so that they share one delay, offline and live."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled, cosine, sine
from quadpi_core.errors import SignalError
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, Quaternion4, Records, record_dtype

ORDER = 4
SECTIONS = 2
DELAYS = 2
# The slowest pole of the filter decays by e^(-0.38 · 2π · 6) = 6e-7 in this many periods of the cut-off.
SETTLING_PERIODS = 6.0


class Section:
    """One second-order section: gain (1 + z⁻¹)² / (1 + a1 z⁻¹ + a2 z⁻²), of unit gain at zero frequency."""

    gain: float
    a1: float
    a2: float


class LowPass:
    """The filter's coefficients: a record, see :mod:`quadpi_core.records`."""

    first: Section
    second: Section
    rate_hz: float


_LOW_PASS = record_dtype(LowPass)


class Filtered(NamedTuple):
    """Low-passed samples (N, C) and their time derivative (N, C) in units per second."""

    value: Array
    derivative: Array


def design_low_pass(cutoff_hz: float, rate_hz: float) -> Records:
    """Design the filter, a :class:`LowPass` (1,); its gain at `cutoff_hz` is √½.

    Raises:
        SignalError: if the cut-off is not between zero and half the sample rate.
    """
    if not 0.0 < cutoff_hz < 0.5 * rate_hz:
        raise SignalError(
            f"cut-off {cutoff_hz:g} Hz must lie between 0 and half the sample rate ({0.5 * rate_hz:g} Hz)"
        )
    # As scipy.signal.butter, whose import takes as long as all else of a live node. The prototype's poles lie
    # on a half circle, in conjugate pairs at these angles off the negative axis; then the bilinear transform.
    half = math.pi * cutoff_hz / rate_hz
    cutoff = float(sine(half) / cosine(half))
    design = np.zeros(1, _LOW_PASS)
    for name, angle in (("first", math.pi / (2 * ORDER)), ("second", 3.0 * math.pi / (2 * ORDER))):
        across, square = 2.0 * float(cosine(angle)) * cutoff, cutoff * cutoff
        a1 = 2.0 * (square - 1.0) / (1.0 + across + square)
        a2 = (1.0 - across + square) / (1.0 + across + square)
        design[name] = (1.0 + a1 + a2) / 4.0, a1, a2
    design["rate_hz"] = rate_hz
    return design


def zero_phase(
    signal: Array, cutoff_hz: float, rate_hz: float, derivative_of: slice = slice(None)
) -> Filtered:
    """Filter samples (N, C) forward, then backward, without delay; the gain is |H|².

    The derivative covers the channels `derivative_of`, all of them by default.

    The derivative is the forward derivative filter followed by the same backward low-pass: it has the phase
    of a derivative and the gain |ω| |H|², and trapezoidal integration gives back the filtered signal. Both
    ends are extended by odd reflection over the settling time of the filter.

    Raises:
        SignalError: if the cut-off is impossible, the signal is shorter than the settling time of the
            filter, or a value is not finite.
    """
    design = design_low_pass(cutoff_hz, rate_hz)
    samples = np.ascontiguousarray(signal, dtype=np.float64)
    finite = np.isfinite(samples).all(axis=1)
    if not finite.all():
        raise SignalError(f"sample {int(np.argmin(finite))} to be filtered is not finite")
    padding = int(np.ceil(SETTLING_PERIODS * rate_hz / cutoff_hz))
    if len(samples) <= padding:
        raise SignalError(
            f"{len(samples)} samples are too few to filter at {cutoff_hz:g} Hz: need more than {padding}"
        )
    head = 2.0 * samples[0] - samples[padding:0:-1]
    tail = 2.0 * samples[-1] - samples[-2 : -padding - 2 : -1]
    forward = filter_settled(design, np.concatenate((head, samples, tail)))
    keep = slice(padding, padding + len(samples))
    value = filter_settled(design, forward.value[::-1]).value[::-1]
    derivative = filter_settled(design, forward.derivative[::-1, derivative_of]).value[::-1]
    return Filtered(value[keep].copy(), derivative[keep].copy())


def filter_settled(design: Records, samples: Array) -> Filtered:
    """Filter a whole signal (N, C) from the settled state of its first sample, as live."""
    samples = np.ascontiguousarray(samples)
    filtered = Filtered(np.empty_like(samples), np.empty_like(samples))
    state = np.empty((SECTIONS, DELAYS, samples.shape[1]))
    compiled.settle(design, state, samples[0])
    compiled.low_pass(design, state, samples, filtered.value, filtered.derivative)
    return filtered


# Columns of the signals of a sample, offline and live: velocity over ground [m/s] in body axes, attitude body
# to world, rates [rad/s], specific force [m/s²] in body axes, rotor speeds [rad/s], as many as the vehicle
# has rotors, and wind [m/s] in the world.
VELOCITY, ATTITUDE, RATES, SPECIFIC_FORCE = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
ROTOR_SPEEDS, WIND = slice(13, -3), slice(-3, None)


def channels(rotors: int) -> int:
    """Number of signals of a vehicle, by the number of its rotors."""
    return 16 + rotors


class FilteredSignals(NamedTuple):
    """The signals that a model and its measured wrench need, after the low-pass.

    Attributes:
        velocity: (K, 3) m/s over ground, body axes.
        attitude: (K, 4) body to world, of unit norm.
        rates: (K, 3) rad/s.
        specific_force: (K, 3) m/s², body axes.
        rotor_speeds: (K, rotors) rad/s.
        wind: (K, 3) m/s, world.
        angular_acceleration: (K, 3) rad/s², the derivative of `rates`.
    """

    velocity: Array
    attitude: Array
    rates: Array
    specific_force: Array
    rotor_speeds: Array
    wind: Array
    angular_acceleration: Array


class ChainMemory:
    """What the causal low-pass over all signals remembers; all zeros before the first sample."""

    # Of a vehicle with fewer rotors, its channels one after the other, and the rest unused.
    delays: Annotated[Array, SECTIONS, DELAYS, channels(ROTORS_MAX)]
    attitude: Quaternion4  # the last one, with the sign that it was filtered with
    started: bool


def filter_zero_phase(
    velocity_body: Array,
    attitude: Array,
    rates: Array,
    specific_force: Array,
    rotor_speeds: Array,
    wind: Array,
    *,
    rate_hz: float,
    cutoff_hz: float,
) -> FilteredSignals:
    """Filter a whole flight without delay (see :func:`quadpi_core.signals.chain.zero_phase`)."""
    samples = _pack(velocity_body, attitude, rates, specific_force, rotor_speeds, wind)
    samples[:, ATTITUDE] = make_continuous(attitude)
    filtered = zero_phase(samples, cutoff_hz, rate_hz, derivative_of=RATES)
    return _unpack(filtered.value, filtered.derivative)


def make_continuous(attitude: Array) -> Array:
    """The quaternions (N, 4), each with the sign nearest to the previous one.

    q and −q are the same attitude, but their mean is not an attitude.
    """
    continuous = np.array(attitude, dtype=np.float64, order="C")
    compiled.make_continuous(continuous, np.zeros(4))
    return continuous


def _pack(*signals: Array) -> Array:
    return np.concatenate(signals, axis=1)


def _unpack(value: Array, angular_acceleration: Array) -> FilteredSignals:
    attitude = value[:, ATTITUDE]
    return FilteredSignals(
        velocity=value[:, VELOCITY],
        attitude=attitude / np.sqrt(np.sum(attitude * attitude, axis=1, keepdims=True)),
        rates=value[:, RATES],
        specific_force=value[:, SPECIFIC_FORCE],
        rotor_speeds=value[:, ROTOR_SPEEDS],
        wind=value[:, WIND],
        angular_acceleration=angular_acceleration,
    )


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
    return (1.0 - share) * values[before] + share * values[after]


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
    return np.minimum(time_ns[0] + np.rint(step_ns * np.arange(count)).astype(np.int64), time_ns[-1])


def first_gap(time_ns: Stamps, max_gap_ns: int) -> int | None:
    """Index of the first sample more than `max_gap_ns` after the previous one; None if there is none."""
    late = np.diff(time_ns) > max_gap_ns
    return int(np.argmax(late)) + 1 if late.any() else None
