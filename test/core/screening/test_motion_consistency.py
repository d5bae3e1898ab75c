# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Innovations of motions known in closed form, and the mistakes that explain them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.sample_limits import STANDARD_GRAVITY
from quadpi_core.screening.excerpt import STEP_S, Excerpt
from quadpi_core.screening.motion_consistency import Innovation, cost, hypotheses, innovation

CELLS = 250
DOWN = np.array([0.0, 0.0, 1.0])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLIP = np.diag([1.0, -1.0, -1.0])


def excerpt_of(attitude: np.ndarray, position: np.ndarray, rates: np.ndarray, force: np.ndarray) -> Excerpt:
    """One window."""
    return Excerpt("mocap/pose", STEP_S, attitude[None], position[None], rates[None], force[None])


@pytest.fixture(scope="module")
def sound(true_flight) -> Excerpt:
    """What sensors without a fault see of a flight in all axes."""
    borders = STEP_S * np.arange(CELLS + 1)
    inside = STEP_S * (np.arange(CELLS)[:, None] + (np.arange(8) + 0.5) / 8.0)
    at, within = true_flight(borders), true_flight(inside.ravel())
    rates, force = (
        values.reshape(CELLS, 8, 3).mean(axis=1) for values in (within.rates, within.specific_force)
    )
    return excerpt_of(at.attitude, at.position, rates, force)


def at_rest(rates: object = 0.0, force: object = 0.0) -> Excerpt:
    """A level vehicle at rest, with errors of gyro and accelerometer."""
    still = np.zeros((CELLS, 3))
    attitude, position = np.tile(LEVEL, (CELLS + 1, 1)), np.zeros((CELLS + 1, 3))
    return excerpt_of(attitude, position, still + rates, still - STANDARD_GRAVITY * DOWN + force)


def test_a_steady_turn_and_fall_are_measured_as_they_are():
    time = STEP_S * np.arange(CELLS + 1)
    rates, acceleration = np.array([0.5, -1.0, 2.0]), np.array([1.0, 2.0, -3.0])
    turned = Rotation.from_rotvec(time[:, None] * rates)
    position = 0.5 * np.outer(time**2, acceleration) + np.outer(time, [3.0, -1.0, 2.0])
    middle = Rotation.from_rotvec((time[:-1, None] + 0.5 * STEP_S) * rates)
    force = middle.apply(acceleration - STANDARD_GRAVITY * DOWN, inverse=True)
    found = innovation(
        excerpt_of(turned.as_quat(scalar_first=True), position, np.tile(rates, (CELLS, 1)), force)
    )
    for values, expected in (
        (found.turned, rates),
        (found.turned_attitude, rates),
        (found.needed, acceleration - STANDARD_GRAVITY * DOWN),
        (found.force, acceleration - STANDARD_GRAVITY * DOWN),
    ):
        assert values.shape[0] > 40
        np.testing.assert_allclose(values, np.tile(expected, (len(values), 1)), atol=1e-4)


def test_sound_sensors_cost_next_to_nothing(sound):
    found = innovation(sound)
    assert cost(found, found.motion) < 0.01
    assert found.motion[0] > 0.5
    assert found.motion[1] > 1.0


@pytest.mark.parametrize("wrong", [{"rates": [0.0, 0.1, 0.0]}, {"force": [0.0, 0.3, 0.0]}])
def test_a_cost_of_one_is_what_sensors_of_sound_flights_differ_by(wrong):
    """At rest 0.1 rad/s or 0.3 m/s²; in motion a tenth of it more."""
    found = innovation(at_rest(**wrong))
    assert cost(found, (0.0, 0.0)) == pytest.approx(1.0, rel=1e-6)
    assert cost(found, (1.0, 3.0)) == pytest.approx(0.25, rel=1e-6)


@pytest.mark.parametrize(("wild", "counts"), [(10, False), (11, True)])
def test_the_largest_tenth_of_the_innovations_does_not_count(wild, counts):
    off = np.zeros((100, 3))
    off[:wild] = 50.0
    zero = np.zeros((100, 3))
    found = Innovation(off, zero, off, zero, np.tile(LEVEL, (100, 1)))
    assert (found.turn_rad_s > 1.0) == (found.fall_m_s2 > 1.0) == counts


def turned(sample: Excerpt, world: np.ndarray | None = None, body: np.ndarray | None = None) -> np.ndarray:
    """Attitudes (1, K, 4) in another world, of another body, by matrices."""
    matrices = Rotation.from_quat(sample.attitude[0], scalar_first=True).as_matrix()
    matrices = (np.eye(3) if world is None else world) @ matrices @ (np.eye(3) if body is None else body)
    return Rotation.from_matrix(matrices).as_quat(scalar_first=True)[None]


def about(axis: str, degrees: float) -> np.ndarray:
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def of_imu(gyro: np.ndarray, accelerometer: np.ndarray | None = None):
    force = gyro if accelerometer is None else accelerometer
    return lambda e: replace(e, rates=e.rates @ gyro.T, force=e.force @ force.T)


# What is done to the sensors, the mistake that says so, and its size.
DONE = {
    "conjugate": (lambda e: replace(e, attitude=e.attitude * [1, -1, -1, -1]), "attitude conjugated", None),
    "NED and FRD": (
        lambda e: replace(e, attitude=turned(e, NED, FLIP), position=e.position @ NED.T),
        "ned frd",
        None,
    ),
    "attitude of NED and FRD": (
        lambda e: replace(e, attitude=turned(e, NED, FLIP)),
        "attitude ned frd",
        None,
    ),
    "position in NED": (lambda e: replace(e, position=e.position @ NED.T), "position ned", None),
    "position swapped": (lambda e: replace(e, position=e.position[..., [1, 0, 2]]), "position swapped", None),
    "height down": (lambda e: replace(e, position=e.position * [1, 1, -1]), "position axes", None),
    "wxyz for xyzw": (
        lambda e: replace(e, attitude=np.roll(e.attitude, 1, axis=2)),
        "quaternion order",
        None,
    ),
    "xyzw for wxyz": (
        lambda e: replace(e, attitude=np.roll(e.attitude, -1, axis=2)),
        "quaternion order",
        None,
    ),
    "imu by 90° about x": (of_imu(about("x", 90)), "imu turned", None),
    "imu by -90° about y": (of_imu(about("y", -90)), "imu turned", None),
    "imu by 180° about z": (of_imu(about("z", 180)), "imu turned", None),
    "imu mirrored": (of_imu(np.diag([1.0, -1.0, 1.0])), "imu mirrored", None),
    "imu mirrored as vectors are": (
        of_imu(np.diag([-1.0, 1.0, -1.0]), np.diag([1.0, -1.0, 1.0])),
        "imu mirrored",
        None,
    ),
    "gyro inverted": (of_imu(-np.eye(3), np.eye(3)), "gyro axes", None),
    "body yawed": (lambda e: replace(e, attitude=turned(e, body=about("z", 25))), "body yawed", 25.0),
    "body tilted": (lambda e: replace(e, attitude=turned(e, body=about("x", 12))), "body tilted", 12.0),
    "world tilted": (
        lambda e: replace(e, attitude=turned(e, about("y", 9)), position=e.position @ about("y", 9).T),
        "world tilted",
        9.0,
    ),
    "worlds apart": (lambda e: replace(e, attitude=turned(e, about("z", 40))), "world turned", 40.0),
    "clock": (lambda e: replace(e, step_s=1.3 * e.step_s), "clock", 1.3),
    "gyro too fast": (lambda e: replace(e, rates=1.4 * e.rates), "gyro scale", 1.0 / 1.4),
    "millimetres": (lambda e: replace(e, position=1e3 * e.position), "position scale", 1e3),
}


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
