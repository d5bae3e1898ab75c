# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Short windows spread over a recording, with every sensor on one grid, for the consistency check."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias, TypeGuard

import numpy as np
import numpy.typing as npt

from quadpi_core.flight import MAX_GAP_NS, OdometryStream, PoseStream, Recording, Stamps
from quadpi_core.frames import (
    Array,
    from_rotation_vector,
    inverses,
    products,
    rotate_body_to_world,
    to_rotation_vector,
)
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.signals.chain import interpolate_columns

# Windows are spread over the flight, so that the cost does not grow with its length.
WINDOWS, WINDOW_S = 24, 2.5
# Bodies of this size turn and accelerate below 20 Hz.
STEP_S = 0.01
# Fewest cells of a window that can be checked.
_FEWEST_CELLS = 100
# Poses farther apart than this do not show the motion between them.
_POSE_GAP_NS = 300_000_000
# Rotor speeds farther apart do not show accelerations: thinned to 25 Hz, those of bundled flights do; to 20
# Hz, an inertia looks 1.4 times too large, and to 11 Hz the rotors look like those of another flight.
_ROTOR_STEP_NS = 45_000_000
# Some logs begin with a sample of another time, which would leave a flight of 4 s without a window.
_STRAY_NS = 100_000_000
# Steps of positions that were measured differ from the velocity's by a hundredth of the largest and more.
_INTEGRAL_SHARE = 1e-6
# Largest delay of rotor speeds that is examined; a window includes their samples this far around it.
_MARGIN_S = 0.4

Pose: TypeAlias = PoseStream | OdometryStream


@dataclass(frozen=True)
class Excerpt:
    """W windows of K cells of STEP_S: states at the borders of the cells, means of other sensors over them.

    Attributes:
        topic: of the state.
        step_s: width of a cell.
        attitude: (W, K + 1, 4) body to world.
        position: (W, K + 1, 3) m, world.
        rates: (W, K, 3) rad/s, means over the cells.
        force: (W, K, 3) specific force m/s², means over the cells.
        velocity: (W, K + 1, 3) m/s, body axes, where the position is its integral by this attitude, so that
            another attitude makes another position; else None.
    """

    topic: str
    step_s: float
    attitude: Array
    position: Array
    rates: Array
    force: Array
    velocity: Array | None = None


@dataclass(frozen=True)
class RotorExcerpt:
    """Windows with rotor speeds; L cells of margin on both sides of the K cells of a window.

    Attributes:
        step_s: width of a cell.
        rates: (W, K, 3) rad/s.
        force: (W, K, 3) m/s².
        squares: (W, K + 2 L, 4) squared rotor speeds, rad²/s².
        margin: L.
    """

    step_s: float
    rates: Array
    force: Array
    squares: Array
    margin: int


def excerpt(recording: Recording, state: Pose) -> Excerpt | None:
    """Windows in which the IMU and a state have samples without a pause; None if there are none."""
    parts = []
    places = [state.position, *([state.velocity] if _is_integral(state) else [])]
    for grid, *inertial in _windows(recording, state.time_ns):
        if _pauses(state.time_ns, grid, _POSE_GAP_NS):
            continue
        near = _near(state.time_ns, grid)
        time_s, at_s = ((time_ns - grid[0]) * 1e-9 for time_ns in (state.time_ns[near], grid))
        attitude, position, *velocity = (
            interpolate_columns(time_s, values, at_s)
            for values in (continuous(state.attitude[near]), *(place[near] for place in places))
        )
        attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
        parts.append((attitude, position, *inertial, *velocity))
    if not parts:
        return None
    return Excerpt(state.topic, STEP_S, *map(np.stack, zip(*parts, strict=True)))


def _is_integral(state: Pose) -> TypeGuard[OdometryStream]:
    """Whether nobody measured the position: it is the integral of the velocity, by the attitude."""
    if isinstance(state, PoseStream) or len(state) < 2:
        return False
    velocity = rotate_body_to_world(state.attitude, state.velocity)
    step_s = np.diff(state.time_ns)[:, np.newaxis] * 1e-9
    moved = 0.5 * (velocity[1:] + velocity[:-1]) * step_s
    off = np.abs(np.diff(state.position, axis=0) - moved).max()
    return bool(off <= _INTEGRAL_SHARE * np.abs(moved).max())


def rotor_excerpt(recording: Recording) -> RotorExcerpt | None:
    """Windows in which the IMU and the rotor speeds have samples without a pause; None if there are none.

    Nor of rotor speeds that come so seldom that they do not follow the motion.
    """
    rotors = recording.rotor_speeds
    if rotors is None or (len(rotors) > 1 and np.median(np.diff(rotors.time_ns)) > _ROTOR_STEP_NS):
        return None
    margin = round(_MARGIN_S / STEP_S)
    parts = []
    for grid, *inertial in _windows(recording, rotors.time_ns, _MARGIN_S):
        wide = np.arange(-margin, len(grid) + margin) * round(STEP_S * 1e9) + grid[0]
        if not _pauses(rotors.time_ns, wide, MAX_GAP_NS):
            near = _near(rotors.time_ns, wide)
            squares = _means(rotors.time_ns[near], rotors.speeds[near] ** 2, wide, grid[0])
            parts.append((*inertial, squares))
    if not parts:
        return None
    rates, force, squares = map(np.stack, zip(*parts, strict=True))
    return RotorExcerpt(STEP_S, rates, force, squares, margin)


def needed_spans(stamps: Mapping[str, Stamps]) -> Iterator[tuple[int, int]]:
    """First and last stamp of each part of a recording that excerpts are made of.

    Args:
        stamps: (N,) those of each stream, by its field of the recording.
    """
    around_ns = round(_MARGIN_S * 1e9) + _POSE_GAP_NS
    for field in ("pose", "odometry", "rotor_speeds"):
        if field in stamps:
            margin_s = _MARGIN_S if field == "rotor_speeds" else 0.0
            for grid in _grids([stamps["imu"], stamps[field]], margin_s):
                yield int(grid[0]) - around_ns, int(grid[-1]) + around_ns


def _grids(stamps: list[Stamps], margin_s: float = 0.0) -> list[Stamps]:
    """Borders (K + 1,) of the cells of each window, in ns."""
    if any(len(time_ns) < 2 for time_ns in stamps):
        return []
    ends = [_without_strays(time_ns) for time_ns in stamps]
    first = max(begin for begin, _ in ends) + round(margin_s * 1e9)
    last = min(end for _, end in ends) - round(margin_s * 1e9)
    step = round(STEP_S * 1e9)
    cells = min((last - first) // step, round(WINDOW_S / STEP_S))
    if cells < _FEWEST_CELLS:
        return []
    count = min(WINDOWS, max(1, (last - first) // (cells * step)))
    starts = np.linspace(first, last - cells * step, count).astype(np.int64)
    return [start + step * np.arange(cells + 1) for start in starts]


def _without_strays(time_ns: Stamps) -> tuple[int, int]:
    """First and last stamp, but for samples that a pause parts from the others within _STRAY_NS of an end."""
    pauses = np.flatnonzero(np.diff(time_ns) > MAX_GAP_NS)
    early = pauses[time_ns[pauses] - time_ns[0] < _STRAY_NS]
    late = pauses[time_ns[-1] - time_ns[pauses + 1] < _STRAY_NS]
    first = early[-1] + 1 if len(early) else 0
    last = late[0] if len(late) else -1
    return int(time_ns[first]), int(time_ns[last])


def _windows(
    recording: Recording, time_ns: Stamps, margin_s: float = 0.0
) -> Iterator[tuple[Stamps, Array, Array]]:
    """Borders of the cells, rates and force of windows with another topic in which the IMU has no pause."""
    imu = recording.imu
    for grid in _grids([imu.time_ns, time_ns], margin_s):
        if not _pauses(imu.time_ns, grid, MAX_GAP_NS):
            near = _near(imu.time_ns, grid)
            rates, force = (
                _means(imu.time_ns[near], values[near], grid, grid[0])
                for values in (imu.angular_velocity, imu.specific_force)
            )
            yield grid, rates, force


def _near(time_ns: Stamps, grid: Stamps) -> slice:
    """The samples in a window, and one on each side."""
    first, last = np.searchsorted(time_ns, grid[0], "right"), np.searchsorted(time_ns, grid[-1])
    return slice(max(int(first) - 1, 0), int(last) + 1)


def _pauses(time_ns: Stamps, grid: Stamps, longest_ns: int) -> bool:
    """Whether a topic pauses in a window or does not cover it, or its stamps do not increase."""
    stamps = time_ns[_near(time_ns, grid)]
    steps = np.diff(stamps)
    return bool(
        len(stamps) < 2
        or stamps[0] > grid[0]
        or stamps[-1] < grid[-1]
        or steps.max() > longest_ns
        or steps.min() <= 0
    )


def continuous(attitude: Array) -> Array:
    """The same rotations (..., N, 4), each with the sign nearest to the previous one."""
    opposite = np.sum(attitude[..., 1:, :] * attitude[..., :-1, :], axis=-1) < 0.0
    signs = np.cumprod(np.where(opposite, -1.0, 1.0), axis=-1)
    return np.concatenate((attitude[..., :1, :], attitude[..., 1:, :] * signs[..., np.newaxis]), axis=-2)


def _means(time_ns: Stamps, values: Array, grid: Stamps, start_ns: int) -> Array:
    """Means (K, C) over cells of values (N, C) that are linear between samples."""
    time_s, grid_s = (1e-9 * (stamps - start_ns).astype(np.float64) for stamps in (time_ns, grid))
    integral = np.zeros_like(values)
    integral[1:] = np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s)[:, np.newaxis], axis=0)
    means = np.diff(interpolate_columns(time_s, integral, grid_s), axis=0) / np.diff(grid_s)[:, np.newaxis]
    return np.asarray(means)


# The gyro is integrated over TURN_S; the position is differentiated twice over 2 FALL_S.
TURN_S, FALL_S = 0.1, 0.2
# Innovations of flights without mistakes: the units of the cost.
TURN_RAD_S, FALL_M_S2 = 0.1, 0.3
_SHARE_OF_MOTION = 0.1
# Share of the innovations that count, the smallest: crashes and jumps of the state estimate are left out.
KEPT_SHARE = 0.9
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Innovation:
    """M pairs of measured and expected values whose differences are the innovations.

    Attributes:
        turned: (M, 3) rad/s, mean turn rate by the gyro, body axes.
        turned_attitude: (M, 3) rad/s, mean turn rate by the attitude, body axes.
        force: (M, 3) m/s², weighted mean over 2 FALL_S of the specific force in the world.
        needed: (M, 3) m/s², acceleration of the position over the same time, minus gravity.
        attitude: (M, 4) in the middle of that time.
    """

    turned: Array
    turned_attitude: Array
    force: Array
    needed: Array
    attitude: Array

    @property
    def turn_rad_s(self) -> float:
        """Root mean square innovation of the attitude [rad/s]."""
        return _size(self.turned - self.turned_attitude)

    @property
    def fall_m_s2(self) -> float:
        """Root mean square innovation of the acceleration [m/s²]."""
        return _size(self.force - self.needed)

    @property
    def motion(self) -> tuple[float, float]:
        """Root mean square of the gyro's turn rate, and of the specific force about its mean."""
        return _size(self.turned), _size(self.force - np.mean(self.force, axis=0))


def innovation(sample: Excerpt) -> Innovation:
    """Innovations of an excerpt, about twenty per second."""
    cells = sample.rates.shape[1]
    span, half = round(TURN_S / sample.step_s), round(FALL_S / sample.step_s)
    stride = max(1, span // 2)
    begin = np.arange(0, cells + 1 - span, stride)
    cell_turns = from_rotation_vector(sample.rates * sample.step_s)
    by_gyro = cell_turns[:, begin]
    for cell in range(1, span):
        by_gyro = products(by_gyro, cell_turns[:, begin + cell])
    by_attitude = products(inverses(sample.attitude[:, begin]), sample.attitude[:, begin + span])
    turned, turned_attitude = (
        to_rotation_vector(turn) / (span * sample.step_s) for turn in (by_gyro, by_attitude)
    )
    middle = sample.attitude[:, 1:] + sample.attitude[:, :-1]
    middle = middle / np.linalg.norm(middle, axis=2, keepdims=True)
    in_world = rotate_body_to_world(middle.reshape(-1, 4), sample.force.reshape(-1, 3)).reshape(
        sample.force.shape
    )
    at = _middles(sample)
    # The second difference of a position weights accelerations by a triangle.
    weights = (1.0 - np.abs(np.arange(-half, half) + 0.5) / half) / half
    windows = np.lib.stride_tricks.sliding_window_view(in_world, 2 * half, axis=1)[:, at - half]
    needed = second_difference(sample, _path(sample)) - STANDARD_GRAVITY * _UP
    return Innovation(
        turned.reshape(-1, 3),
        turned_attitude.reshape(-1, 3),
        (windows @ weights).reshape(-1, 3),
        needed.reshape(-1, 3),
        sample.attitude[:, at].reshape(-1, 4),
    )


def _path(sample: Excerpt) -> Array:
    """Position (W, K + 1, 3) m, up to where each window begins."""
    if sample.velocity is None:
        return sample.position
    flat = rotate_body_to_world(sample.attitude.reshape(-1, 4), sample.velocity.reshape(-1, 3))
    velocity = flat.reshape(sample.velocity.shape)
    return np.asarray(sample.step_s * (np.cumsum(velocity, axis=1) - 0.5 * velocity))


def second_difference(sample: Excerpt, values: Array) -> Array:
    """Second derivative (W, P, ...) over 2 FALL_S of values (W, K + 1, ...) at the borders of the cells."""
    at, half = _middles(sample), round(FALL_S / sample.step_s)
    second = values[:, at + half] - 2.0 * values[:, at] + values[:, at - half]
    return np.asarray(second / (half * sample.step_s) ** 2)


def _middles(sample: Excerpt) -> npt.NDArray[np.int64]:
    """Borders of cells (P,) about which accelerations are measured."""
    half = round(FALL_S / sample.step_s)
    stride = max(1, round(TURN_S / sample.step_s) // 2)
    return np.arange(half, sample.rates.shape[1] + 1 - half, stride)


def cost(found: Innovation, motion: tuple[float, float]) -> float:
    """Sum of the squared innovations in units of those of correct data; `motion` is of the data as read."""
    turn = found.turn_rad_s / (TURN_RAD_S + _SHARE_OF_MOTION * motion[0])
    fall = found.fall_m_s2 / (FALL_M_S2 + _SHARE_OF_MOTION * motion[1])
    return turn**2 + fall**2


def _size(differences: Array) -> float:
    """Root mean square norm of vectors (M, 3), without the largest."""
    squares = np.sort(np.sum(differences**2, axis=1))
    return float(np.sqrt(np.mean(squares[: max(1, round(KEPT_SHARE * len(squares)))])))
