# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes on a sound flight, and the hypotheses that explain them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.errors import DiscrepancyError
from quadpi_core.records import STANDARD_GRAVITY
from quadpi_core.screening.excerpt import STEP_S, Excerpt, Innovation, cost, innovation
from quadpi_core.screening.motion_consistency import hypotheses, motion_fit, small_mistakes, without_repeats
from quadpi_core.screening.rotors_in_flight import require_changes, require_excitation
from test.core.mistakes import about, attitude, frozen

from .conftest import CELLS, excerpt_of

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


# Origin and scale are measured as they are, and calm flights do not tell them.


def moved(sample, place_m):
    """What motion capture of another origin sees."""
    turned = Rotation.from_quat(sample.attitude[0], scalar_first=True).apply(place_m)
    return replace(sample, position=sample.position + turned)


def named(sample, measured=True):
    return [one.name for one in small_mistakes(sample, innovation(sample), measured=measured)]


@pytest.mark.parametrize("place_m", [(0.0, 0.0, 0.0), (0.1, 0.0, -0.02), (0.0, -0.06, 0.08)])
def test_the_origin_is_measured_to_a_centimetre(sound, place_m):
    sample = moved(sound, place_m)
    fit = motion_fit(sample, innovation(sample))
    np.testing.assert_allclose(fit.origin_m, place_m, atol=0.01)
    assert fit.scale == pytest.approx(1.0, abs=0.005)


def test_the_scale_of_the_accelerometer_is_measured(sound):
    sample = replace(sound, force=1.05 * sound.force)
    assert motion_fit(sample, innovation(sample)).scale == pytest.approx(1.05, abs=0.005)
    assert named(sample) == ["accelerometer scale"]


def test_an_estimated_state_has_no_origin_of_its_own(sound):
    sample = moved(sound, (0.1, 0.0, 0.0))
    assert named(sample) == ["mocap origin"]
    assert named(sample, measured=False) == []
    assert named(sound) == []


# Motion capture that repeats its pose in flight is named, with the time; parked it is not.


def test_a_pose_that_repeats_in_flight_is_named_with_the_time_and_left_out(flown) -> None:
    recording, _ = frozen(1.5)(flown["train_2"], None)
    moving, finding = without_repeats(recording.pose, recording.imu)
    assert finding is not None
    assert finding.text.startswith("position and attitude repeat from 10.")
    assert "and so for 1.5 s in all" in finding.text
    steps = np.diff(moving.time_ns) * 1e-9
    assert 1.4 < steps.max() < 1.6
    assert np.sort(steps)[-2] < 0.25


def test_nothing_is_said_of_a_pose_that_repeats_while_parked(flown) -> None:
    recording, _ = frozen(1.5)(flown["train_2"], None)
    imu = replace(recording.imu, angular_velocity=np.full((len(recording.imu), 3), 0.02))
    assert without_repeats(recording.pose, imu) == (recording.pose, None)


# Innovations of motions known in closed form.


DOWN = np.array([0.0, 0.0, 1.0])
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


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


# What flights contain is told, and what they lack is asked for.


def test_hover_alone_names_what_is_missing(flights, simulation):
    """The first instant of a flight, held, with the flicker of rotors."""
    rng = np.random.default_rng(0)
    still = []
    for flight in flights[:2]:
        none = np.zeros_like(flight.velocity)
        level = np.tile([1.0, 0.0, 0.0, 0.0], (len(flight), 1))
        flicker = rng.standard_normal(flight.rotor_speeds.shape)
        still.append(replace(flight, velocity=none, rates=none, attitude=level, rotor_speeds=600.0 + flicker))
    with pytest.raises(
        DiscrepancyError, match=r"nothing but hover, .*; fly forward and backward flight, sid"
    ):
        require_excitation(still, simulation.vehicle)


def test_what_was_flown_is_not_asked_for(flights, simulation):
    missing = require_excitation(flights, simulation.vehicle)
    assert not {"forward and backward flight", "sideways flight", "yaw doublets"} & set(missing)
    slow = [replace(flight, velocity=0.01 * flight.velocity) for flight in flights]
    assert {"forward and backward flight", "sideways flight", "climb and descent"} <= set(
        require_excitation(slow, simulation.vehicle)
    )


def test_rotor_speeds_that_do_not_change_are_refused_with_the_rotor(flights):
    speeds = flights[0].rotor_speeds.copy()
    speeds[:, 2] = 612.0
    require_changes(flights[0])
    with pytest.raises(
        DiscrepancyError, match=r": topic rotor_speeds: rotor 3 has the same speed .*, 612 rad"
    ):
        require_changes(replace(flights[0], rotor_speeds=speeds))
