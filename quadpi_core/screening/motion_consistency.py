# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Find mistakes in frames, axes, units or clocks from the disagreement of IMU and state about the motion.

Each known mistake is a hypothesis with a transformation of the data that reverses it. The mistake reported is
the hypothesis that reduces the innovations most, provided that it does so by a margin.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations, product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.findings import Finding
from quadpi_core.flight import ImuStream
from quadpi_core.frames import (
    Array,
    best_rotation,
    from_rotation_vector,
    inverses,
    products,
    quaternion_of,
    rotate_body_to_world,
    rotate_world_to_body,
    rotation_matrix,
    to_rotation_vector,
)
from quadpi_core.records import STANDARD_GRAVITY, Threshold
from quadpi_core.screening.excerpt import (
    FALL_M_S2,
    KEPT_SHARE,
    TURN_RAD_S,
    TURN_S,
    Excerpt,
    Innovation,
    Pose,
    continuous,
    cost,
    innovation,
    second_difference,
)
from quadpi_core.screening.rotors_in_flight import runs_of

# Scale factors of units and clocks that are tried: from 1/1000 to 1000, then finely around the best.
_FACTORS = np.geomspace(1e-3, 1e3, 121)
_FINE_FACTORS = np.geomspace(0.93, 1.07, 29)
# A scale factor counts if its cost is below this share of the cost of a state that does not move. With the
# true factor the bundled flights have at most 0.1; positions with 0.3 m of noise have at least 0.68.
_WORTH_SHARE = 0.5
# With a larger factor, windows of this length hold no flight dynamics; such stamps are refused elsewhere.
_LARGEST_CLOCK_FACTOR = 3.0
_EYE = np.eye(3)
_FLIP = np.diag([1.0, -1.0, -1.0])
_SWAP = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Hypothesis:
    """A possible mistake, and the change of the data that reverses it.

    Attributes:
        name: short, for programs.
        undo: returns the excerpt with the mistake reversed.
        looks: what the data look like, for a message.
        remedy: what the user can change, for a message.
        gyro: (3, 3) transformation of the rates that reverses it, if the mistake may lie in the IMU.
        angle_deg, scale: size of the mistake, if it is estimated.
    """

    name: str
    undo: Callable[[Excerpt], Excerpt]
    looks: str
    remedy: str
    gyro: Array | None = None
    angle_deg: float | None = None
    scale: float | None = None


def hypotheses(sample: Excerpt, found: Innovation) -> Iterator[Hypothesis]:
    """All known mistakes, the simplest first; `found` holds the innovations of the data as read."""
    topic = sample.topic
    yield Hypothesis(
        "attitude conjugated",
        lambda e: replace(e, attitude=inverses(e.attitude)),
        f"the attitude of {topic} looks conjugated (world to body)",
        "inverting it",
    )
    written = "looks written in NED and FRD where ENU and FLU are expected, or the other way round"
    for name, undo, looks in (
        ("ned frd", lambda e: _of_world(_of_body(e, _FLIP), _SWAP, _SWAP), f"{topic} {written}"),
        (
            "attitude ned frd",
            lambda e: _of_world(_of_body(e, _FLIP), _SWAP, _EYE),
            f"the attitude of {topic}, not its position, {written}",
        ),
        (
            "position ned",
            lambda e: _of_world(e, _EYE, _SWAP),
            f"the position of {topic}, not its attitude, looks written in NED where ENU is expected, or the "
            "other way round",
        ),
    ):
        yield Hypothesis(name, undo, looks, "converting it")
    yield Hypothesis(
        "position swapped",
        lambda e: _of_world(e, _EYE, _EYE[[1, 0, 2]]),
        f"x and y of the position of {topic} look swapped",
        "swapping them",
    )
    for shift, order in ((1, "xyzw"), (3, "wxyz")):
        yield Hypothesis(
            "quaternion order",
            partial(_reordered, shift=shift),
            f"the numbers of the attitude of {topic} look ordered {order} where the other order is expected",
            "reordering them",
        )
    for axis in "zxy":
        for degrees in (90, 180, -90):
            turn = rotation_matrix(from_rotation_vector(np.radians(degrees) * _EYE["xyz".index(axis)]))
            yield _of_axes(
                "imu turned",
                f"the axes of the IMU and those of {topic} look turned against each other by {degrees}° "
                f"about {axis}",
                turn,
                turn,
                remedy=f"turning the IMU by {degrees}° about {axis} of the body, or {topic} by {-degrees}°,",
            )
    for matrix in _signed_permutations():
        words, mirrored = _axes(matrix), "the axes of the IMU look mirrored:"
        if np.linalg.det(matrix) < 0.0:
            yield _of_axes("imu mirrored", f"{mirrored} its x, y, z seem to be {words}", matrix, matrix)
            yield _of_axes(
                "imu mirrored",
                f"{mirrored} x, y, z of its accelerometer seem to be {words}",
                -matrix,
                matrix,
                remedy="making them so, and the gyro's the other way round,",
            )
        yield _of_axes(
            "gyro axes",
            f"the axes of the gyro look wrong, those of the accelerometer not: x, y, z seem to be {words}",
            matrix,
            _EYE,
        )
        yield accelerometer_axes(matrix)
        yield Hypothesis(
            "position axes",
            partial(_of_world, attitude=_EYE, position=matrix),
            f"the axes of the position of {topic} look wrong, those of its attitude not: x, y, z seem to be "
            f"{words}",
            "making them so",
        )
    yield from _fitted(sample, found)


def _of_axes(name: str, looks: str, gyro: Array, force: Array, remedy: str = "making them so") -> Hypothesis:
    """Axes of the IMU that matrices (3, 3) put right."""
    undo = partial(_of_imu, gyro=gyro, accelerometer=force)
    return Hypothesis(name, undo, looks, remedy, gyro=gyro)


def accelerometer_axes(matrix: Array) -> Hypothesis:
    """An accelerometer, not the gyro, whose axes a signed permutation (3, 3) puts right."""
    return Hypothesis(
        "accelerometer axes",
        partial(_of_imu, gyro=_EYE, accelerometer=matrix),
        "the axes of the accelerometer look wrong, those of the gyro not: x, y, z seem to be "
        f"{_axes(matrix)}",
        "making them so",
    )


def _fitted(sample: Excerpt, found: Innovation) -> Iterator[Hypothesis]:
    """Mistakes whose size is estimated from the data."""
    topic = sample.topic
    body = _body_rotation(found)
    size, angle, words = _turn_of(body)
    tilted = bool(np.hypot(angle[0], angle[1]) > abs(angle[2]))
    yield Hypothesis(
        "body tilted" if tilted else "body yawed",
        lambda e: _of_imu(e, body.T, body.T),
        f"the axes of the IMU and those of {topic} look turned against each other by {words}",
        f"turning the rigid body of {topic}, or the IMU, so that both agree,",
        gyro=body.T,
        angle_deg=size,
    )
    world = best_rotation(found.needed, found.force)[0]
    size, _, words = _turn_of(world)
    yield Hypothesis(
        "world tilted",
        lambda e: _of_world(e, world.T, world.T),
        f"the world of {topic} looks tilted by {size:.0f}°: its z axis is not vertical",
        "levelling it",
        angle_deg=size,
    )
    yield Hypothesis(
        "world turned",
        lambda e: _of_world(e, world.T, _EYE),
        f"the worlds of attitude and position of {topic} look turned against each other by {words}",
        "giving both in one world",
        angle_deg=size,
    )
    fast = _best_scale(found, lambda s: (s, s**2))
    if max(fast, 1.0 / fast) <= _LARGEST_CLOCK_FACTOR:
        yield Hypothesis(
            "clock",
            lambda e: replace(e, step_s=e.step_s / fast),
            f"the clock looks {fast:.2f} times too fast",
            f"dividing all stamps by {fast:.2f}",
            scale=fast,
        )
    turning = 1.0 / _best_scale(found, lambda s: (s, 1.0))
    yield Hypothesis(
        "gyro scale",
        lambda e: replace(e, rates=e.rates * turning),
        f"the gyro reads {1.0 / turning:.2f} times what the attitude of {topic} turns by",
        f"dividing it by {1.0 / turning:.2f}",
        scale=turning,
    )
    larger = 1.0 / _best_scale(found, lambda s: (1.0, s))
    yield Hypothesis(
        "position scale",
        lambda e: replace(_of_velocity(e, _EYE / larger), position=e.position / larger),
        f"the position of {topic} looks {larger:.3g} times too large: another unit?",
        f"dividing it by {larger:.3g}",
        scale=larger,
    )


def _best_scale(found: Innovation, scales: Callable[[float], tuple[float, float]]) -> float:
    """The factor s of the smallest cost when `scales(s)` multiply turn rates and accelerations of the state.

    1 if a state that does not move at all would fit nearly as well.
    """
    motion, gravity = found.motion, STANDARD_GRAVITY * _EYE[2]
    accelerations = found.needed + gravity

    def cost_of(factor: float) -> float:
        turn, fall = scales(factor)
        scaled = replace(
            found, turned_attitude=turn * found.turned_attitude, needed=fall * accelerations - gravity
        )
        return cost(scaled, motion)

    coarse = min(_FACTORS, key=cost_of)
    best = float(min(coarse * _FINE_FACTORS, key=cost_of))
    # A factor near 0 suppresses any noise, so the best one must fit much better than no motion.
    return best if cost_of(best) < _WORTH_SHARE * cost_of(0.0) else 1.0


def _body_rotation(found: Innovation) -> Array:
    """Rotation (3, 3) from the body axes of the state to those of the IMU that fits both innovations best."""
    to_body = inverses(found.attitude)
    force, needed = (rotate_body_to_world(to_body, values) for values in (found.force, found.needed))
    of = np.concatenate((found.turned / TURN_RAD_S, force / FALL_M_S2))
    over = np.concatenate((found.turned_attitude / TURN_RAD_S, needed / FALL_M_S2))
    weights = np.ones(len(of))
    rotation = best_rotation(over, weights[:, np.newaxis] * of)[0]
    for _ in range(3):
        off = np.linalg.norm(of - over @ rotation.T, axis=1)
        for part in (slice(0, len(found.turned)), slice(len(found.turned), None)):
            weights[part] = off[part] <= np.quantile(off[part], KEPT_SHARE)
        rotation = best_rotation(over, weights[:, np.newaxis] * of)[0]
    return rotation


def _turn_of(rotation: Array) -> tuple[float, Array, str]:
    """Angle, rotation vector (3,) and words of a rotation (3, 3), in degrees."""
    angle = np.degrees(to_rotation_vector(quaternion_of(rotation)))
    size = float(np.linalg.norm(angle))
    return size, angle, f"{size:.0f}° about ({angle[0]:.0f}, {angle[1]:.0f}, {angle[2]:.0f})°"


def _of_imu(sample: Excerpt, gyro: Array, accelerometer: Array) -> Excerpt:
    return replace(sample, rates=sample.rates @ gyro.T, force=sample.force @ accelerometer.T)


def _reordered(sample: Excerpt, shift: int) -> Excerpt:
    return replace(sample, attitude=continuous(np.roll(sample.attitude, shift, axis=2)))


def _of_body(sample: Excerpt, turn: Array) -> Excerpt:
    return replace(_of_velocity(sample, turn), attitude=products(sample.attitude, quaternion_of(turn)))


def _of_velocity(sample: Excerpt, turn: Array) -> Excerpt:
    return sample if sample.velocity is None else replace(sample, velocity=sample.velocity @ turn)


def _of_world(sample: Excerpt, attitude: Array, position: Array) -> Excerpt:
    return replace(
        sample,
        attitude=products(quaternion_of(attitude), sample.attitude),
        position=sample.position @ position.T,
    )


def _signed_permutations() -> Iterator[Array]:
    """The 47 permutations and reversals of axes other than the identity, those with few changes first."""
    matrices = [
        np.diag(signs)[:, list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return iter(sorted(matrices, key=lambda m: -float(np.trace(m)))[1:])


def _axes(matrix: Array) -> str:
    """The axes that x, y and z become, such as `y, x, -z`."""
    return ", ".join(("-" if row.sum() < 0.0 else "") + "xyz"[int(np.argmax(np.abs(row)))] for row in matrix)


FROZEN_S = Threshold(
    "duration of a state that repeats while the gyro turns",
    0.3,
    "s",
    "sound flights repeat position and attitude together for less than 0.1 s",
    "122 real recordings of seven sets and the bundled bags",
)
FROZEN_TURN_RAD = Threshold(
    "turn by the gyro while a state repeats",
    0.05,
    "rad",
    "a gyro at rest drifts by less in a second; in 1.5 s of a figure-eight it turns by 0.16 rad at least",
    "imrc_brushless",
)


def without_repeats(state: Pose, imu: ImuStream) -> tuple[Pose, Finding | None]:
    """A state without samples that repeat for FROZEN_S and longer while the gyro turns, and their finding.

    Args:
        state: with finite values and increasing stamps.
        imu: likewise.
    """
    if len(state) < 2 or len(imu) < 2:
        return state, None
    same = np.all(np.diff(np.hstack((state.position, state.attitude)), axis=0) == 0.0, axis=1)
    time_s, imu_s = ((stream.time_ns - imu.time_ns[0]) * 1e-9 for stream in (state, imu))
    angle = np.zeros_like(imu.angular_velocity)
    angle[1:] = np.cumsum(imu.angular_velocity[1:] * np.diff(imu_s)[:, np.newaxis], axis=0)
    frozen: list[tuple[float, float, float]] = []
    usable = np.ones(len(state), dtype=np.bool_)
    for first, last in runs_of(same):
        begin_s, end_s = time_s[[first, last]].tolist()
        within = angle[slice(*np.searchsorted(imu_s, (begin_s, end_s)))]
        turn = float(np.ptp(within, axis=0).max()) if len(within) else 0.0
        # A gyro that drifts turns steadily, and slowly.
        least = FROZEN_TURN_RAD.value * max(1.0, end_s - begin_s)
        if end_s - begin_s >= FROZEN_S.value and turn >= least:
            frozen.append((begin_s, end_s, turn))
            usable[first + 1 : last + 1] = False
    if not frozen:
        return state, None
    begin_s, end_s, turn = max(frozen, key=lambda one: one[1] - one[0])
    whole_s = sum(end - begin for begin, end, _ in frozen)
    text = (
        f"position and attitude repeat from {begin_s:.2f} to {end_s:.2f} s while the gyro turns by "
        f"{np.degrees(turn):.0f}°, and so for {whole_s:.1f} s in all: the tracking is lost or its driver "
        "repeats the last pose; leave these samples out"
    )
    return state.take(usable), Finding("frozen state", state.topic, text)


# In the body, the acceleration that a state needs is compared with the specific force: by correlation along x
# and y, and by a regression of their difference on what an origin r beside the IMU (the second derivative of
# R r, with the attitude R), a scale, a bias and a lag would add.

_FLIGHTS = "42 real flights with motion capture: imrc_brushless, indiflight, nanobench"
AXES_GAIN = Threshold(
    "gain of other axes of the accelerometer, of squares of two correlations",
    0.3,
    "1",
    "sound flights gain 0.01 at most; with x and y swapped or reversed bare Crazyflies gain 1.25 and more",
    _FLIGHTS,
)
SCALE_OFF = Threshold(
    "share by which an accelerometer reads too much or too little",
    0.025,
    "1",
    "sound flights reach 0.012, those scaled by 1.05 begin at 0.045",
    _FLIGHTS,
)
ORIGIN_ASIDE_M = Threshold(
    "distance of the origin of motion capture from the IMU, beside or below it",
    0.038,
    "m",
    "sound flights reach 0.026 m; moved by 0.08 m they begin at 0.042 m",
    _FLIGHTS,
)
ORIGIN_ABOVE_M = Threshold(
    "height of the origin of motion capture above the IMU",
    0.06,
    "m",
    "markers lie on top: sound flights reach 0.038 m; moved up by 0.08 m they begin at 0.079 m",
    _FLIGHTS,
)
SURE = Threshold(
    "size of an estimate over its standard error",
    4.0,
    "1",
    "calm flights do not tell the origin; of motion capture 0.2 s late they err by 3.7 standard errors",
    "neurobem, late by 0.05 to 0.3 s, early by 0.2 s",
)
# Columns of the regression: the origin, x and y of a bias, a lag, and the scale.
_ORIGIN, _BIAS, _LAG, _SCALE, _COLUMNS = slice(0, 3), (3, 4), 5, 6, 7
# Times that the largest residuals are left out.
_ROUNDS = 3
_UP = np.array([0.0, 0.0, 1.0])


class MotionFit(NamedTuple):
    """What the accelerations say of scale and origin, with standard errors.

    Attributes:
        scale, scale_error: what the accelerometer reads, over what it should.
        origin_m, origin_error_m: (3,) place of the state's origin from the IMU, in body axes.
    """

    scale: float
    scale_error: float
    origin_m: Array
    origin_error_m: Array


def small_mistakes(sample: Excerpt, found: Innovation, *, measured: bool) -> Iterator[Hypothesis]:
    """Mistakes of accelerometer and origin beyond their thresholds.

    Args:
        sample: as read.
        found: its innovations.
        measured: whether the state is measured by motion capture; the origin of an estimated one is the IMU.
    """
    turn, gain = better_axes(sample, found)
    if gain >= AXES_GAIN.value:
        yield accelerometer_axes(turn)
    else:
        yield from judged(sample.topic, motion_fit(sample, found), measured=measured)


def judged(topic: str, fit: MotionFit, *, measured: bool) -> Iterator[Hypothesis]:
    """Scale and origin, where they are off beyond thresholds and doubt; arguments as above."""
    off = abs(fit.scale - 1.0)
    if off >= max(SCALE_OFF.value, SURE.value * fit.scale_error):
        yield Hypothesis(
            "accelerometer scale",
            lambda e: replace(e, force=e.force / fit.scale),
            f"the accelerometer reads {fit.scale:.3f} times what gravity and the motion of {topic} need, "
            f"{9.8 * (fit.scale - 1.0):+.2f} m/s² in hover",
            f"dividing it by {fit.scale:.3f}",
        )
    below = fit.origin_m[2] > 0.0
    if measured and (
        _beyond(fit, np.array([1.0, 1.0, below]), ORIGIN_ASIDE_M.value)
        or _beyond(fit, np.array([0.0, 0.0, not below]), ORIGIN_ABOVE_M.value)
    ):
        (x, y, z), (dx, dy, dz) = 100.0 * fit.origin_m, 100.0 * fit.origin_error_m
        yield Hypothesis(
            "mocap origin",
            lambda e: replace(e, position=e.position - rotate_body_to_world(e.attitude, fit.origin_m)),
            f"the origin of {topic} looks {np.hypot(np.hypot(x, y), z):.1f} cm from the IMU, at ({x:.1f} ± "
            f"{dx:.1f}, {y:.1f} ± {dy:.1f}, {z:.1f} ± {dz:.1f}) cm forward, right and down of it",
            "moving the rigid body's origin there",
        )


def _beyond(fit: MotionFit, axes: Array, least_m: float) -> bool:
    """Whether the origin is farther along axes (3,), 0 or 1, than a distance and its error allow."""
    place = axes * fit.origin_m
    away = float(np.linalg.norm(place))
    error = float(np.linalg.norm(place * fit.origin_error_m)) / max(away, 1e-9)
    return away >= max(least_m, SURE.value * error)


def motion_fit(sample: Excerpt, found: Innovation) -> MotionFit:
    """Regression of the acceleration that is needed and not felt; errors by leaving out each half window."""
    windows = len(sample.rates)
    to_body = np.swapaxes(rotation_matrix(found.attitude), 1, 2)
    turns = rotation_matrix(sample.attitude.reshape(-1, 4)).reshape(*sample.attitude.shape[:2], 3, 3)
    swing = second_difference(sample, turns).reshape(-1, 3, 3)
    force, needed = _in_body(found)
    step_s = max(1, round(TURN_S / sample.step_s) // 2) * sample.step_s
    rising = np.asarray(np.gradient(found.force.reshape(windows, -1, 3), step_s, axis=1)).reshape(-1, 3, 1)
    columns = np.zeros((len(force), 3, _COLUMNS))
    columns[:, :, _ORIGIN] = to_body @ swing
    columns[:, _BIAS[0] - 3, _BIAS[0]] = columns[:, _BIAS[1] - 3, _BIAS[1]] = 1.0
    columns[:, :, _LAG] = (to_body @ rising)[..., 0]
    columns[:, :, _SCALE] = force
    missing = needed - force
    inliers = np.ones(len(force), dtype=np.bool_)
    for _ in range(_ROUNDS):
        ((squares, right),) = _sums(columns, missing, inliers[:, np.newaxis])
        solution = np.linalg.lstsq(squares, right, rcond=None)[0]
        residual = np.linalg.norm(missing - columns @ solution, axis=1)
        inliers = residual <= np.quantile(residual, KEPT_SHARE)
    half_window = np.arange(len(force)) // max(1, len(force) // (2 * windows))
    members = inliers[:, np.newaxis] & (half_window[:, np.newaxis] == np.arange(half_window[-1] + 1))
    sums = _sums(columns, missing, members)
    whole, all_right = (np.sum(one, axis=0) for one in zip(*sums, strict=True))
    others = [np.linalg.lstsq(whole - own, all_right - right, rcond=None)[0] for own, right in sums]
    error = np.sqrt((len(others) - 1) * np.var(others, axis=0))
    scale = 1.0 / (1.0 + solution[_SCALE])
    return MotionFit(float(scale), float(error[_SCALE]), np.asarray(solution[_ORIGIN], float), error[_ORIGIN])


def _sums(columns: Array, missing: Array, members: npt.NDArray[np.bool_]) -> list[tuple[Array, Array]]:
    """Normal equations (C, C) and (C,) of each block of rows, by masks (N, B)."""
    weights = members.astype(np.float64)
    squares = np.einsum("nb,nic,nid->bcd", weights, columns, columns, optimize=True)
    return list(
        zip(squares, np.einsum("nb,nic,ni->bc", weights, columns, missing, optimize=True), strict=True)
    )


def better_axes(sample: Excerpt, found: Innovation) -> tuple[Array, float]:
    """Signed permutation (3, 3) of x and y of the force that follows what is needed best, and its gain.

    The thrust, along z, is taken off both: as it turns with the body, it hides what the others do.
    """
    along_z = innovation(replace(sample, force=sample.force * _UP)).force
    rest = replace(found, force=found.force - along_z, needed=found.needed - along_z)
    along, over = (values[:, :2] - values[:, :2].mean(axis=0) for values in _in_body(rest))
    power = np.sqrt(np.outer(np.sum(over**2, axis=0), np.sum(along**2, axis=0)))
    correlation = (over.T @ along) / np.maximum(power, 1e-30)
    squares = correlation * np.abs(correlation)
    best, gain = np.eye(3), 0.0
    for signs in product((1.0, -1.0), repeat=2):
        for order in ([0, 1], [1, 0]):
            turn = np.diag(signs)[:, order]
            more = float(np.sum(turn * squares) - np.trace(squares))
            if more > gain:
                best, gain = np.eye(3), more
                best[:2, :2] = turn
    return best, gain


def _in_body(found: Innovation) -> tuple[Array, Array]:
    force, needed = (rotate_world_to_body(found.attitude, values) for values in (found.force, found.needed))
    return force, needed
