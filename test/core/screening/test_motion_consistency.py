# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes on a sound flight, and the hypotheses that explain them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.screening.excerpt import Excerpt, cost, innovation
from quadpi_core.screening.motion_consistency import hypotheses
from test.core.mistakes import about, attitude

# What is done to the sensors, the mistake that says so, and its size; others are in test.core.mistakes.
DONE = {
    "wxyz for xyzw": (lambda e: attitude_of(e, np.roll(e.attitude, 1, axis=2)), "quaternion order", None),
    "xyzw for wxyz": (lambda e: attitude_of(e, np.roll(e.attitude, -1, axis=2)), "quaternion order", None),
    "imu by 90° about x": (lambda e: of_imu(e, about("x", 90)), "imu turned", None),
    "imu by -90° about y": (lambda e: of_imu(e, about("y", -90)), "imu turned", None),
    "imu by 180° about z": (lambda e: of_imu(e, about("z", 180)), "imu turned", None),
    "body yawed": (lambda e: turned(e, _EYE, about("z", 25)), "body yawed", 25.0),
    "body tilted": (lambda e: turned(e, _EYE, about("x", 12)), "body tilted", 12.0),
    "world tilted": (
        lambda e: replace(turned(e, about("y", 9), _EYE), position=e.position @ about("y", 9).T),
        "world tilted",
        9.0,
    ),
    "worlds apart": (lambda e: turned(e, about("z", 40), _EYE), "world turned", 40.0),
    "clock": (lambda e: replace(e, step_s=1.3 * e.step_s), "clock", 1.3),
    "gyro too fast": (lambda e: replace(e, rates=1.4 * e.rates), "gyro scale", 1.0 / 1.4),
    "millimetres": (lambda e: replace(e, position=1e3 * e.position), "position scale", 1e3),
}
_EYE = np.eye(3)


def attitude_of(sample: Excerpt, quaternions: np.ndarray) -> Excerpt:
    return replace(sample, attitude=quaternions)


def turned(sample: Excerpt, world: np.ndarray, body: np.ndarray) -> Excerpt:
    """In another world, of another body, by matrices."""
    return attitude_of(sample, attitude(world, body)(sample.attitude[0])[None])


def of_imu(sample: Excerpt, turn: np.ndarray) -> Excerpt:
    return replace(sample, rates=sample.rates @ turn.T, force=sample.force @ turn.T)


@pytest.mark.parametrize("name", DONE)
def test_each_mistake_is_explained_best_by_its_own_hypothesis_and_undone(sound, name):
    do, expected, size = DONE[name]
    wrong = do(sound)
    before = innovation(wrong)
    tried = list(hypotheses(wrong, before))
    costs = [cost(innovation(one.undo(wrong)), before.motion) for one in tried]
    # Of equals the first, as the check takes it.
    best = tried[int(np.argmax(np.array(costs) <= 1.1 * min(costs)))]
    assert best.name == expected
    assert min(costs) < 0.02 * cost(before, before.motion)
    found = best.angle_deg if best.angle_deg is not None else best.scale
    assert found == (size if size is None else pytest.approx(size, rel=0.05))
    if best.gyro is not None:
        np.testing.assert_allclose(wrong.rates @ best.gyro.T, best.undo(wrong).rates, atol=1e-12)


@pytest.mark.parametrize(("factor", "explains"), [(2.7, True), (3.4, False)])
def test_a_clock_three_times_too_fast_or_more_is_not_tried(sound, factor, explains):
    """Its windows hold no flight dynamics."""
    wrong = replace(sound, step_s=factor * sound.step_s)
    clocks = [one.scale for one in hypotheses(wrong, innovation(wrong)) if one.name == "clock"]
    assert clocks == ([pytest.approx(factor, rel=0.05)] if explains else [])


@pytest.mark.parametrize(("noise_m", "explains"), [(0.0, True), (0.05, True), (0.1, False), (3.0, False)])
def test_noise_is_no_other_unit(sound, noise_m, explains):
    """A factor near 0 suppresses any noise: it must halve the cost of a state that does not move."""
    noise = noise_m * np.random.default_rng(2).standard_normal(sound.position.shape)
    noisy = replace(sound, position=3.0 * sound.position + noise)
    (found,) = [one for one in hypotheses(noisy, innovation(noisy)) if one.name == "position scale"]
    assert (found.scale > 2.8) if explains else (found.scale == 1.0)
