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

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.rotations import (
    best_rotation,
    from_rotation_vectors,
    inverses,
    products,
    quaternion_of,
    rotate_body_to_world,
    rotation_matrix,
)
from quadpi_core.sample_limits import STANDARD_GRAVITY
from quadpi_core.screening.excerpt import Excerpt
from quadpi_core.screening.innovations import FALL_M_S2, KEPT_SHARE, TURN_RAD_S, Innovation, cost

# Scale factors of units and clocks that are tried: from 1/1000 to 1000, then finely around the best.
_FACTORS = np.geomspace(1e-3, 1e3, 121)
_FINE_FACTORS = np.geomspace(0.93, 1.07, 29)
# A scale factor counts if its cost is below this share of the cost of a state that does not move. With the
# true factor the bundled flights have at most 0.1; positions with 0.3 m of noise have at least 0.68.
_WORTH_SHARE = 0.5
# With a larger factor, windows of this length hold no flight dynamics; such stamps are refused elsewhere.
_LARGEST_CLOCK_FACTOR = 3.0
_UP = np.array([0.0, 0.0, 1.0])
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
    yield Hypothesis(
        "ned frd",
        lambda e: _of_world(_of_body(e, _FLIP), _SWAP, _SWAP),
        f"{topic} looks written in NED and FRD where ENU and FLU are expected, or the other way round",
        "converting it",
    )
    yield Hypothesis(
        "attitude ned frd",
        lambda e: _of_world(_of_body(e, _FLIP), _SWAP, np.eye(3)),
        f"the attitude of {topic}, not its position, looks written in NED and FRD where ENU and FLU are "
        "expected, or the other way round",
        "converting it",
    )
    yield Hypothesis(
        "position ned",
        lambda e: _of_world(e, np.eye(3), _SWAP),
        f"the position of {topic}, not its attitude, looks written in NED where ENU is expected, or the "
        "other way round",
        "converting it",
    )
    yield Hypothesis(
        "position swapped",
        lambda e: _of_world(e, np.eye(3), np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])),
        f"x and y of the position of {topic} look swapped",
        "swapping them",
    )
    for shift in (1, 3):
        yield Hypothesis(
            "quaternion order",
            partial(_reordered, shift=shift),
            f"the numbers of the attitude of {topic} look ordered {'xyzw' if shift == 1 else 'wxyz'} where "
            "the other order is expected",
            "reordering them",
        )
    for axis in "zxy":
        for degrees in (90, 180, -90):
            turn = _about("xyz".index(axis), np.radians(degrees))
            yield Hypothesis(
                "imu turned",
                partial(_of_imu, gyro=turn, accelerometer=turn),
                f"the axes of the IMU and those of {topic} look turned against each other by {degrees}° "
                f"about {axis}",
                f"turning the IMU by {degrees}° about {axis} of the body, or {topic} by {-degrees}°,",
                gyro=turn,
            )
    for matrix in _signed_permutations():
        proper = np.linalg.det(matrix) > 0.0
        words = _axes(matrix)
        if not proper:
            yield Hypothesis(
                "imu mirrored",
                partial(_of_imu, gyro=matrix, accelerometer=matrix),
                f"the axes of the IMU look mirrored: its x, y, z seem to be {words}",
                "making them so",
                gyro=matrix,
            )
            yield Hypothesis(
                "imu mirrored",
                partial(_of_imu, gyro=-matrix, accelerometer=matrix),
                f"the axes of the IMU look mirrored: x, y, z of its accelerometer seem to be {words}",
                "making them so, and the gyro's the other way round,",
                gyro=-matrix,
            )
        yield Hypothesis(
            "gyro axes",
            partial(_of_imu, gyro=matrix, accelerometer=np.eye(3)),
            f"the axes of the gyro look wrong, those of the accelerometer not: x, y, z seem to be {words}",
            "making them so",
            gyro=matrix,
        )
        yield accelerometer_axes(matrix)
        yield Hypothesis(
            "position axes",
            partial(_of_world, attitude=np.eye(3), position=matrix),
            f"the axes of the position of {topic} look wrong, those of its attitude not: x, y, z seem to be "
            f"{words}",
            "making them so",
        )
    yield from _fitted(sample, found)


def accelerometer_axes(matrix: Array) -> Hypothesis:
    """An accelerometer, not the gyro, whose axes a signed permutation (3, 3) puts right."""
    return Hypothesis(
        "accelerometer axes",
        partial(_of_imu, gyro=np.eye(3), accelerometer=matrix),
        "the axes of the accelerometer look wrong, those of the gyro not: x, y, z seem to be "
        f"{_axes(matrix)}",
        "making them so",
    )


def _fitted(sample: Excerpt, found: Innovation) -> Iterator[Hypothesis]:
    """Mistakes whose size is estimated from the data."""
    topic = sample.topic
    body = _body_rotation(found)
    angle = np.degrees(_logarithm_of(body))
    size = float(np.linalg.norm(angle))
    tilted = bool(np.hypot(angle[0], angle[1]) > abs(angle[2]))
    yield Hypothesis(
        "body tilted" if tilted else "body yawed",
        lambda e: _of_imu(e, body.T, body.T),
        f"the axes of the IMU and those of {topic} look turned against each other by {size:.0f}° about "
        f"({angle[0]:.0f}, {angle[1]:.0f}, {angle[2]:.0f})°",
        f"turning the rigid body of {topic}, or the IMU, so that both agree,",
        gyro=body.T,
        angle_deg=size,
    )
    world = best_rotation(found.needed, found.force)[0]
    angle = np.degrees(_logarithm_of(world))
    size = float(np.linalg.norm(angle))
    yield Hypothesis(
        "world tilted",
        lambda e: _of_world(e, world.T, world.T),
        f"the world of {topic} looks tilted by {size:.0f}°: its z axis is not vertical",
        "levelling it",
        angle_deg=size,
    )
    yield Hypothesis(
        "world turned",
        lambda e: _of_world(e, world.T, np.eye(3)),
        f"the worlds of attitude and position of {topic} look turned against each other by {size:.0f}° about "
        f"({angle[0]:.0f}, {angle[1]:.0f}, {angle[2]:.0f})°",
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
        lambda e: replace(e, position=e.position / larger),
        f"the position of {topic} looks {larger:.3g} times too large: another unit?",
        f"dividing it by {larger:.3g}",
        scale=larger,
    )


def _best_scale(found: Innovation, scales: Callable[[float], tuple[float, float]]) -> float:
    """The factor s of the smallest cost when `scales(s)` multiply turn rates and accelerations of the state.

    1 if a state that does not move at all would fit nearly as well.
    """
    motion, gravity = found.motion, STANDARD_GRAVITY * _UP
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


def _logarithm_of(rotation: Array) -> Array:
    cosine = float(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0))
    skew = rotation - rotation.T
    axis = np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    return np.asarray(np.arccos(cosine) * axis / max(float(np.linalg.norm(axis)), 1e-12))


def _about(axis: int, angle: float) -> Array:
    turn = np.zeros(3)
    turn[axis] = angle
    rotation: Array = rotation_matrix(from_rotation_vectors(turn[np.newaxis]))[0]
    return rotation


def _of_imu(sample: Excerpt, gyro: Array, accelerometer: Array) -> Excerpt:
    return replace(sample, rates=sample.rates @ gyro.T, force=sample.force @ accelerometer.T)


def _reordered(sample: Excerpt, shift: int) -> Excerpt:
    return replace(sample, attitude=_continuous_rows(np.roll(sample.attitude, shift, axis=2)))


def _of_body(sample: Excerpt, turn: Array) -> Excerpt:
    return replace(sample, attitude=products(sample.attitude, quaternion_of(turn)))


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
    rows = []
    for row in matrix:
        column = int(np.argmax(np.abs(row)))
        rows.append(("-" if row[column] < 0.0 else "") + "xyz"[column])
    return ", ".join(rows)


def _continuous_rows(attitude: Array) -> Array:
    """Quaternions (W, K + 1, 4) with signs that make each window continuous."""
    opposite = np.sum(attitude[:, 1:] * attitude[:, :-1], axis=2) < 0.0
    signs = np.cumprod(np.where(opposite, -1.0, 1.0), axis=1)
    return np.concatenate((attitude[:, :1], attitude[:, 1:] * signs[..., np.newaxis]), axis=1)
