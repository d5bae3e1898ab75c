# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""States less sure than in a model's flights: what counts, and since when; blocks and single ones alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.estimator.filter_run import FUSED, FusedSamples
from quadpi_core.flight import NOT_MEASURED, OdometryStream
from quadpi_core.models.interval_rules import StateDeviation
from quadpi_core.monitor.unsure_states import UNSURE_S, StateDeviations, UnsureStates, deviation_of_one

STEP_NS = 10_000_000
KNOWN = StateDeviation(velocity_m_s=0.05, attitude_rad=0.02)


def states(velocity: object, count: int = 500, attitude: float = 0.01) -> StateDeviations:
    time_ns = STEP_NS * np.arange(count)
    return StateDeviations(time_ns, np.broadcast_to(velocity, count).astype(float), np.full(count, attitude))


def beyond(unsure: UnsureStates, time_ns: np.ndarray) -> np.ndarray:
    found = unsure.conditions(time_ns)
    return np.zeros(len(time_ns)) if found is None else found["covariance"][:, 0, 0]


def test_only_what_goes_beyond_the_models_flights_counts_and_only_once_it_lasts():
    unsure = UnsureStates(KNOWN)
    unsure.take(states(0.13))
    added = beyond(unsure, STEP_NS * np.arange(500))
    since = round(1e9 * UNSURE_S.value) // STEP_NS
    assert not added[:since].any()
    assert added[since:] == pytest.approx(0.12**2)


@pytest.mark.parametrize("velocity", [0.05, np.r_[np.full(150, 1.0), np.full(350, 0.03)]])
def test_a_state_that_settles_changes_nothing(velocity):
    unsure = UnsureStates(KNOWN)
    unsure.take(states(velocity))
    assert unsure.conditions(STEP_NS * np.arange(500)) is None
    assert not unsure.is_beyond


@pytest.mark.parametrize("at_once", [True, False])
def test_a_pause_is_no_time_in_which_a_state_was_unsure(at_once):
    """A filter that starts again after motion capture was gone settles as at its first start."""
    velocity = np.r_[np.full(200, 0.03), np.full(100, 1.0), np.full(200, 0.03)]
    whole = states(velocity)
    whole.time_ns[200:] += 10 * round(1e9)
    unsure = UnsureStates(KNOWN)
    if at_once:
        unsure.take(whole)
    else:
        for one in zip(*whole, strict=True):
            unsure.take_one(*one)
    assert not unsure.is_beyond


def test_states_that_no_sample_asks_for_do_not_pile_up():
    unsure = UnsureStates(KNOWN)
    for one in zip(*states(0.2, 2000), strict=True):
        unsure.take_one(*one)
    assert len(unsure._beyond) <= 202
    assert beyond(unsure, STEP_NS * np.arange(1900, 2000)) == pytest.approx(0.2**2 - 0.05**2)


def test_attitudes_count_by_themselves():
    unsure = UnsureStates(KNOWN)
    unsure.take(states(0.01, attitude=0.04))
    found = unsure.conditions(STEP_NS * np.arange(490, 500))
    covariance = found["covariance"][-1]
    assert np.diag(covariance)[3:6] == pytest.approx(0.04**2 - 0.02**2)
    assert np.count_nonzero(covariance) == 3


def test_blocks_and_single_states_have_the_same_effect():
    rng = np.random.default_rng(0)
    whole = states(np.where(np.arange(900) // 300 % 2, 0.2, 0.04) + rng.uniform(0.0, 0.01, 900), 900)
    expected = []
    at_once, one_by_one = UnsureStates(KNOWN), UnsureStates(KNOWN)
    for start in range(0, 900, 128):
        part = StateDeviations(*(own[start : start + 128] for own in whole))
        at_once.take(part)
        expected.append(beyond(at_once, part.time_ns))
    found = []
    for time_ns, velocity, attitude in zip(*whole, strict=True):
        one_by_one.take_one(int(time_ns), velocity, attitude)
        found.append(beyond(one_by_one, np.array([time_ns])))
    assert np.array_equal(np.concatenate(expected), np.concatenate(found))
    assert np.any(np.concatenate(found))
    assert not one_by_one.is_beyond


def test_deviations_are_the_numbers_of_messages():
    fused = FusedSamples.from_rows(np.zeros(2, FUSED))
    fused.rows["time_ns"] = [1, 2]
    fused.twist_covariance[:, range(3), range(3)] = [[0.01, 0.02, 0.03], [0.0, 0.0, 0.3]]
    fused.pose_covariance[:, range(3, 6), range(3, 6)] = 4e-4
    found = StateDeviations.of_fused(fused)
    assert found.velocity == pytest.approx(np.sqrt([0.02, 0.1]))
    assert found.attitude == pytest.approx([0.02, 0.02])
    assert deviation_of_one(fused.part(slice(0, 1))) == (found.velocity[0], found.attitude[0])
    zero = np.zeros((1, 3))
    told = OdometryStream(
        np.array([1]), zero, np.eye(4)[:1], zero, zero, np.array([[1.0, 0.1, NOT_MEASURED]])
    )
    assert StateDeviations.of_odometry(told)[1:] == (0.0, 0.1)


def test_ones_that_fill_a_covariance_say_nothing():
    many = 500
    zeros = np.zeros((many, 3))
    states = OdometryStream(
        np.arange(many) * 10_000_000,
        zeros,
        np.tile([1.0, 0.0, 0.0, 0.0], (many, 1)),
        zeros,
        zeros,
        np.ones((many, 3)),
    )
    unsure = UnsureStates(KNOWN)
    unsure.take(StateDeviations.of_odometry(states))
    assert not unsure.is_beyond
    told = replace(states, deviation=np.tile([1.0, 0.03, 1.0], (many, 1)))
    unsure.take(StateDeviations.of_odometry(told))
    assert unsure.is_beyond
