# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Time offset between two sources by cross-correlation of a signal that both measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import correlate

from quadpi_core.errors import SignalError
from quadpi_core.flight import MAX_GAP_NS, Recording, Stamps
from quadpi_core.frames import Array
from quadpi_core.rotations import body_rates
from quadpi_core.signals.filters import zero_phase
from quadpi_core.signals.resample import interpolate

MIN_CORRELATION = 0.5
MIN_OVERLAP_S = 2.0
# Differentiating motion-capture attitudes amplifies noise; a quadrotor's rotations are slower than this.
POSE_CUTOFF_HZ = 8.0


@dataclass(frozen=True)
class Alignment:
    """Offset of the clock of one source from the reference's.

    Attributes:
        offset_s: to be added to the other source's stamps.
        correlation: of the shared signal at that offset, −1 to 1.
        overlap_s: time that both sources cover at that offset.
        matches: samples compared at that offset.
    """

    offset_s: float
    correlation: float
    overlap_s: float
    matches: int

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
    max_offset_s: float = np.inf,
    cutoff_hz: float | None = None,
    what: str = "alignment",
) -> Alignment:
    """Find the offset of `other` that makes it most like `reference`.

    Both are brought to one uniform grid; the normalised correlation is taken over the samples that overlap at
    each lag (at least MIN_OVERLAP_S), and a parabola through its peak gives a fraction of the grid's step.
    Clocks of unrelated epochs are allowed.

    Args:
        reference_ns: (N,) stamps.
        reference: (N, C) the shared signal, for example body rates in rad/s.
        other_ns: (M,) stamps.
        other: (M, C) the same signal as measured by the other source.
        max_offset_s: largest offset that is searched, in either direction.
        cutoff_hz: of a zero-phase low-pass of both signals, where noise would hide what they share.
        what: name of the pair, for messages.

    Raises:
        SignalError: if nothing overlaps or the correlation stays below MIN_CORRELATION; the message prints
            both ranges, the best offset and the match count.
    """
    step_ns = int(min(np.median(np.diff(reference_ns)), np.median(np.diff(other_ns))))
    x, x_there = _on_grid(reference_ns, reference, step_ns, cutoff_hz)
    y, y_there = _on_grid(other_ns, other, step_ns, cutoff_hz)

    lags = np.arange(-(len(y) - 1), len(x))
    start_difference_s = 1e-9 * float(reference_ns[0] - other_ns[0])
    offsets_s = start_difference_s + 1e-9 * step_ns * lags
    matches = np.rint(_correlate(x_there, y_there)).astype(np.int64)
    correlation = _normalised(x, x_there, y, y_there)
    allowed = (matches * step_ns >= 1e9 * MIN_OVERLAP_S) & (np.abs(offsets_s) <= max_offset_s)
    correlation[~allowed] = -1.0

    best = int(np.argmax(correlation))
    if not allowed.any() or correlation[best] < MIN_CORRELATION:
        raise SignalError(
            f"{what}: no overlap: reference spans {_span(reference_ns)}, other {_span(other_ns)}; "
            f"best offset {offsets_s[best]:.3f} s with correlation {correlation[best]:.2f} over "
            f"{matches[best] if allowed.any() else 0} matching samples"
        )
    return Alignment(
        offset_s=float(offsets_s[best]) + 1e-9 * step_ns * _peak_shift(correlation, best),
        correlation=float(correlation[best]),
        overlap_s=1e-9 * step_ns * float(matches[best]),
        matches=int(matches[best]),
    )


def align_pose(recording: Recording, max_offset_s: float = 1.0) -> tuple[Recording, Alignment]:
    """Move the stamps of the poses so that the rates of their attitude match the gyro.

    Raises:
        SignalError: if the recording has no pose, or as :func:`time_offset` does.
    """
    if recording.pose is None:
        raise SignalError(f"{recording.source}: topic mocap/pose is missing: nothing to align")
    pose = recording.pose
    middle_ns = pose.time_ns[:-1] + np.diff(pose.time_ns) // 2
    alignment = time_offset(
        recording.imu.time_ns,
        recording.imu.angular_velocity,
        middle_ns,
        body_rates(pose.time_ns, pose.attitude),
        max_offset_s=max_offset_s,
        cutoff_hz=POSE_CUTOFF_HZ,
        what=f"{recording.source}: gyro and mocap/pose",
    )
    return replace(recording, pose=replace(pose, time_ns=pose.time_ns + alignment.offset_ns)), alignment


def _on_grid(time_ns: Stamps, values: Array, step_ns: int, cutoff_hz: float | None) -> tuple[Array, Array]:
    """Values (K, C) on a uniform grid, mean removed and zero in gaps, and 1 where there is a value (K,)."""
    grid = np.arange(time_ns[0], time_ns[-1] + 1, step_ns, dtype=np.int64)
    resampled, valid = interpolate(time_ns, values, grid, MAX_GAP_NS)
    if cutoff_hz is not None:
        resampled = zero_phase(resampled, cutoff_hz, 1e9 / step_ns).value
    there = valid.astype(np.float64)
    return (resampled - resampled[valid].mean(axis=0)) * there[:, None], there


def _correlate(x: Array, y: Array) -> Array:
    correlation: Array = correlate(x, y, mode="full", method="fft")
    return correlation


def _normalised(x: Array, x_there: Array, y: Array, y_there: Array) -> Array:
    """Correlation coefficient at each lag over the samples that overlap there."""
    product = sum(_correlate(x[:, channel], y[:, channel]) for channel in range(x.shape[1]))
    x_power = _correlate(np.sum(x * x, axis=1), y_there)
    y_power = _correlate(x_there, np.sum(y * y, axis=1))
    normalised: Array = product / (_root(x_power) * _root(y_power))
    return normalised


def _root(power: Array) -> Array:
    """Square root with a floor: the transform leaves rounding errors of either sign near zero."""
    floor = max(1e-12 * float(power.max()), np.finfo(float).tiny)
    root: Array = np.sqrt(np.maximum(power, floor))
    return root


def _peak_shift(values: Array, peak: int) -> float:
    """Offset from `peak`, in samples, of the maximum of the parabola through it and its neighbours."""
    if peak in {0, len(values) - 1}:
        return 0.0
    left, middle, right = values[peak - 1 : peak + 2]
    curvature = left - 2.0 * middle + right
    return float(np.clip(0.5 * (left - right) / curvature, -0.5, 0.5)) if curvature < 0.0 else 0.0


def _span(time_ns: Stamps) -> str:
    return f"{1e-9 * time_ns[0]:.3f} to {1e-9 * time_ns[-1]:.3f} s"
