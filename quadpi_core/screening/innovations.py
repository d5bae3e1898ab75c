# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Innovations of a recording: the disagreement of IMU and state about the motion, as in a filter but untuned.

There are two: the change of attitude minus the integral of the gyro, and the acceleration of the position
minus the specific force in the world.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.rotations import (
    from_rotation_vector,
    inverses,
    products,
    rotate_body_to_world,
    to_rotation_vector,
)
from quadpi_core.sample_limits import STANDARD_GRAVITY
from quadpi_core.screening.excerpt import Excerpt

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
    needed = second_difference(sample, sample.position) - STANDARD_GRAVITY * _UP
    return Innovation(
        turned.reshape(-1, 3),
        turned_attitude.reshape(-1, 3),
        (windows @ weights).reshape(-1, 3),
        needed.reshape(-1, 3),
        sample.attitude[:, at].reshape(-1, 4),
    )


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
