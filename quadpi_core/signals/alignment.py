# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Time offset between two sources by cross-correlation of a signal that both measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from quadpi_core.errors import SignalError
from quadpi_core.flight import MAX_GAP_NS, ImuStream, OdometryStream, PoseStream, RotorSpeedStream, Stamps
from quadpi_core.frames import Array, body_rates
from quadpi_core.records import Threshold
from quadpi_core.signals.chain import interpolate, zero_phase
from quadpi_core.vehicle import Vehicle

MIN_CORRELATION = 0.5
MIN_OVERLAP_S = 2.0
OVERLAP = Threshold(
    "overlap at an offset",
    0.25,
    "of the shorter source",
    "what was recorded together overlaps nearly whole; short overlaps are alike by chance",
    "real flights of imrc_brushless and neurobem: the best rivals overlap by less than a half",
)
RIVAL = Threshold(
    "evidence of another offset",
    0.6,
    "of that of the best",
    "sound flights have at most 0.35, figure-eights cut to full periods 0.9",
    "bundled bags; real flights of imrc_brushless, imrc_payload, neurobem and indiflight",
)
# Differentiating motion-capture attitudes amplifies noise; a quadrotor's rotations are slower than this.
POSE_CUTOFF_HZ = 8.0
# Drag and trim change slowly; manoeuvres are quicker.
_TURNS_ABOVE_HZ = 1.0
# Attitudes closer together are not differentiated: digits of stored quaternions would count as turns.
_DIFFERENCE_NS = 8_000_000
# Poses farther apart than this do not show the motion between them.
_POSE_GAP_NS = 300_000_000
# Places on the grid: 9 minutes at 500 Hz; longer flights have a coarser one.
_GRID_MAX = 2**18
# Correlations beyond say no more about the offset.
_CORRELATION_MAX = 0.9999


@dataclass(frozen=True)
class Alignment:
    """Offset of the clock of one source from the reference's.

    Attributes:
        offset_s: to be added to the other source's stamps.
        correlation: of the shared signal at that offset, −1 to 1.
        overlap_s: time that both sources cover at that offset.
        matches: samples compared at that offset.
        rival_s: another offset that fits nearly as well, as of a motion that repeats; None without one.
    """

    offset_s: float
    correlation: float
    overlap_s: float
    matches: int
    rival_s: float | None = None

    @property
    def offset_ns(self) -> int:
        """The offset in nanoseconds."""
        return round(1e9 * self.offset_s)


def time_offset(
    reference_ns: Stamps,
    reference: Array,
    other_ns: Stamps,
    other: Array,
    *,
    above_hz: float | None = None,
    cutoff_hz: float | None = None,
    max_gap_ns: int = MAX_GAP_NS,
    what: str = "alignment",
) -> Alignment:
    """Find the offset of `other` that makes it most like `reference`.

    Both are brought to one uniform grid; the normalised correlation r is taken over the samples that overlap
    at each lag, at least MIN_OVERLAP_S and a share of the shorter source. Of all lags the one with the most
    evidence counts, artanh(r) √n (Fisher's transformation over its standard error); a parabola through its
    peak gives a fraction of the grid's step. Clocks of unrelated epochs are allowed.

    Args:
        reference_ns: (N,) stamps.
        reference: (N, C) the shared signal, for example body rates in rad/s.
        other_ns: (M,) stamps.
        other: (M, C) the same signal as measured by the other source.
        above_hz: of a high-pass, where a slow part of each is its own; channels then have equal weights, as
            of quantities in different units.
        cutoff_hz: of a zero-phase low-pass of both signals, where noise would hide what they share.
        max_gap_ns: longest pause across which a source is interpolated.
        what: name of the pair, for messages.

    Raises:
        SignalError: if nothing overlaps or the correlation stays below MIN_CORRELATION; the message prints
            both ranges, the best offset and the match count.
    """
    longest_ns = max(int(stamps[-1] - stamps[0]) for stamps in (reference_ns, other_ns))
    step_ns = int(
        max(min(np.median(np.diff(reference_ns)), np.median(np.diff(other_ns))), longest_ns / _GRID_MAX)
    )
    try:
        x, x_there = _on_grid(reference_ns, reference, step_ns, cutoff_hz, max_gap_ns)
        y, y_there = _on_grid(other_ns, other, step_ns, cutoff_hz, max_gap_ns)
        if above_hz is not None:
            both = ((x, x_there), (y, y_there))
            x, y = (_quick_part(one, there, above_hz, 1e9 / step_ns) for one, there in both)
    except SignalError as error:
        raise SignalError(f"{what}: too short to align: {error}") from error
    lags = np.arange(-(len(y) - 1), len(x))
    start_difference_s = 1e-9 * float(reference_ns[0] - other_ns[0])
    offsets_s = start_difference_s + 1e-9 * step_ns * lags
    matches = np.rint(_correlate(x_there, y_there)).astype(np.int64)
    correlation = _normalised(x, x_there, y, y_there)
    shorter = min(int(np.count_nonzero(there)) for there in (x_there, y_there))
    fewest = max(1e9 * MIN_OVERLAP_S / step_ns, OVERLAP.value * shorter)
    allowed = matches >= fewest
    correlation[~allowed] = -1.0
    evidence = np.arctanh(np.clip(correlation, -_CORRELATION_MAX, _CORRELATION_MAX)) * np.sqrt(
        np.maximum(matches, 0)
    )

    best = int(np.argmax(np.where(allowed, evidence, -np.inf)))
    if not allowed.any() or correlation[best] < MIN_CORRELATION:
        raise SignalError(
            f"{what}: no overlap: reference spans {span_of(reference_ns)}, other {span_of(other_ns)}; "
            f"best offset {offsets_s[best]:.3f} s with correlation {correlation[best]:.2f} over "
            f"{matches[best] if allowed.any() else 0} matching samples"
        )
    low, high = _peak(correlation, best)
    # Near 1 the evidence no longer grows.
    best = low + int(np.argmax(correlation[low:high]))
    rival = _rival(evidence, low, high, best)
    return Alignment(
        offset_s=float(offsets_s[best]) + 1e-9 * step_ns * _peak_shift(correlation, best),
        correlation=float(correlation[best]),
        overlap_s=1e-9 * step_ns * float(matches[best]),
        matches=int(matches[best]),
        rival_s=None if rival is None else float(offsets_s[rival]),
    )


def _peak(correlation: Array, best: int) -> tuple[int, int]:
    """First lag of the peak around the best one, and the one behind its last."""
    low = np.flatnonzero(correlation <= 0.5 * correlation[best])
    place = int(np.searchsorted(low, best))
    return int(low[place - 1]) + 1 if place else 0, int(low[place]) if place < len(low) else len(correlation)


def _rival(evidence: Array, low: int, high: int, best: int) -> int | None:
    """The best lag outside of the peak of the best one, if it has nearly as much evidence."""
    outside = np.ones(len(evidence), dtype=np.bool_)
    outside[low:high] = False
    if not outside.any():
        return None
    rival = int(np.argmax(np.where(outside, evidence, -np.inf)))
    return rival if evidence[rival] >= RIVAL.value * evidence[best] else None


def turn_offset(imu: ImuStream, state: PoseStream | OdometryStream, what: str) -> Alignment:
    """The offset at which a state turns as the gyro says; see :func:`time_offset`."""
    rows = np.searchsorted(state.time_ns, np.arange(state.time_ns[0], state.time_ns[-1] + 1, _DIFFERENCE_NS))
    rows = np.unique(rows)
    if len(rows) < 3 or len(imu) < 2:
        raise SignalError(f"{what}: too few samples to align")
    time_ns = state.time_ns[rows]
    return time_offset(
        imu.time_ns,
        imu.angular_velocity,
        time_ns[:-1] + np.diff(time_ns) // 2,
        body_rates(time_ns, state.attitude[rows]),
        cutoff_hz=POSE_CUTOFF_HZ,
        max_gap_ns=_POSE_GAP_NS,
        what=what,
    )


def rotor_offset(imu: ImuStream, rotors: RotorSpeedStream, vehicle: Vehicle, what: str) -> Alignment:
    """The offset at which the rotors lift and turn the vehicle as the IMU says.

    Thrust is compared with the specific force, moments about roll and pitch with the angular accelerations.

    Raises:
        SignalError: see :func:`time_offset`; for fewer than two samples.
    """
    if len(rotors) < 2 or len(imu) < 2:
        raise SignalError(f"{what}: too few samples to align")
    squares = rotors.speeds**2
    positions = vehicle.rotor_positions
    levers = np.stack((np.ones(len(positions)), -positions[:, 1], positions[:, 0]))
    accelerations = np.gradient(imu.angular_velocity[:, :2], 1e-9 * (imu.time_ns - imu.time_ns[0]), axis=0)
    return time_offset(
        imu.time_ns,
        np.column_stack((-imu.specific_force[:, 2], accelerations)),
        rotors.time_ns,
        squares @ levers.T,
        above_hz=_TURNS_ABOVE_HZ,
        cutoff_hz=POSE_CUTOFF_HZ,
        max_gap_ns=_POSE_GAP_NS,
        what=what,
    )


def _quick_part(values: Array, there: Array, above_hz: float, rate_hz: float) -> Array:
    """What a high-pass leaves of columns (N, C), each of one size."""
    quick = (values - zero_phase(values, above_hz, rate_hz).value) * there[:, np.newaxis]
    return quick / np.maximum(np.sqrt(np.mean(quick**2, axis=0)), np.finfo(float).tiny)


def _on_grid(
    time_ns: Stamps, values: Array, step_ns: int, cutoff_hz: float | None, max_gap_ns: int
) -> tuple[Array, Array]:
    """Values (K, C) on a uniform grid, mean removed and zero in gaps, and 1 where there is a value (K,)."""
    grid = np.arange(time_ns[0], time_ns[-1] + 1, step_ns, dtype=np.int64)
    resampled, valid = interpolate(time_ns, values, grid, max_gap_ns)
    if cutoff_hz is not None:
        resampled = zero_phase(resampled, cutoff_hz, 1e9 / step_ns).value
    there = valid.astype(np.float64)
    mean = resampled[valid].mean(axis=0) if valid.any() else 0.0
    return (resampled - mean) * there[:, None], there


def _correlate(x: Array, y: Array) -> Array:
    """Σ x(n + k) y(n) for k of -(len(y) - 1) to len(x) - 1."""
    # scipy.signal has it, but takes longer to import than all else that a live node needs.
    lags = len(x) + len(y) - 1
    length = 1 << (lags - 1).bit_length()
    circular = np.fft.irfft(np.fft.rfft(x, length) * np.conj(np.fft.rfft(y, length)), length)
    return np.roll(circular, len(y) - 1)[:lags]


def _normalised(x: Array, x_there: Array, y: Array, y_there: Array) -> Array:
    """Correlation coefficient at each lag over the samples that overlap there."""
    product = sum(_correlate(x[:, channel], y[:, channel]) for channel in range(x.shape[1]))
    x_power = _correlate(np.sum(x * x, axis=1), y_there)
    y_power = _correlate(x_there, np.sum(y * y, axis=1))
    return product / (_root(x_power) * _root(y_power))


def _root(power: Array) -> Array:
    """Square root with a floor: the transform leaves rounding errors of either sign near zero."""
    floor = max(1e-12 * float(power.max()), np.finfo(float).tiny)
    return np.sqrt(np.maximum(power, floor))


def _peak_shift(values: Array, peak: int) -> float:
    """Offset from `peak`, in samples, of the maximum of the parabola through it and its neighbours."""
    if peak in {0, len(values) - 1}:
        return 0.0
    left, middle, right = values[peak - 1 : peak + 2]
    curvature = left - 2.0 * middle + right
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5)) if curvature < 0.0 else 0.0


def span_of(time_ns: Stamps) -> str:
    """First and last stamp, in words."""
    return f"{1e-9 * time_ns[0]:.3f} to {1e-9 * time_ns[-1]:.3f} s"
