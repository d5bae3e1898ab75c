# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes of the accelerometer and of the origin of motion capture that hardly show in the innovations.

In the body, the acceleration that a state needs is compared with the specific force: by correlation along
x and y, and by a regression of their difference on what an origin r beside the IMU (the second derivative of
R r, with the attitude R), a scale, a bias and a lag would add.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.rotations import rotate_body_to_world, rotate_world_to_body, rotation_matrix
from quadpi_core.screening.excerpt import (
    KEPT_SHARE,
    TURN_S,
    Excerpt,
    Innovation,
    innovation,
    second_difference,
)
from quadpi_core.screening.motion_consistency import Hypothesis, accelerometer_axes
from quadpi_core.thresholds import Threshold

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
        solution = _solved(squares, right)
        residual = np.linalg.norm(missing - columns @ solution, axis=1)
        inliers = residual <= np.quantile(residual, KEPT_SHARE)
    half_window = np.arange(len(force)) // max(1, len(force) // (2 * windows))
    members = inliers[:, np.newaxis] & (half_window[:, np.newaxis] == np.arange(half_window[-1] + 1))
    sums = _sums(columns, missing, members)
    whole, all_right = (np.sum(one, axis=0) for one in zip(*sums, strict=True))
    others = [_solved(whole - squares, all_right - right) for squares, right in sums]
    error = np.sqrt((len(others) - 1) * np.var(others, axis=0))
    scale = 1.0 / (1.0 + solution[_SCALE])
    return MotionFit(float(scale), float(error[_SCALE]), solution[_ORIGIN], error[_ORIGIN])


def _sums(columns: Array, missing: Array, members: npt.NDArray[np.bool_]) -> list[tuple[Array, Array]]:
    """Normal equations (C, C) and (C,) of each block of rows, by masks (N, B)."""
    weights = members.astype(np.float64)
    squares = np.einsum("nb,nic,nid->bcd", weights, columns, columns, optimize=True)
    return list(
        zip(squares, np.einsum("nb,nic,ni->bc", weights, columns, missing, optimize=True), strict=True)
    )


def _solved(squares: Array, right: Array) -> Array:
    return np.asarray(np.linalg.lstsq(squares, right, rcond=None)[0])


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
