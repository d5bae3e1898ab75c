# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.models.physical_rollout import ATTITUDE, RATES, STATES, VELOCITY, roll_out
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.models.tubes import Uncertainty, error_covariance
from test.core.models.flights_ahead import ahead, true_model
from test.core.models.physical_flights import STEP_S, VEHICLE, known_parameters

HORIZONS = np.array([1, 10, 30])
STARTS = np.array([50, 150, 250])
CERTAIN = Uncertainty(
    np.zeros(STATES), np.zeros(6), np.zeros(6), np.full(6, 0.9), np.zeros((len(TERMS), len(TERMS)))
)


@pytest.fixture(scope="module")
def case():
    track = true_model().track(ahead(5.0, 1))
    return track, roll_out(track, STARTS, HORIZONS, known_parameters(), derivatives=True)


def covariance(case, uncertainty):
    track, rolled = case
    return error_covariance(track, STARTS, HORIZONS, rolled.path, known_parameters(), uncertainty)


def test_the_parameters_spread_by_their_derivatives(case) -> None:
    own, k = np.zeros((len(TERMS), len(TERMS))), TERM_INDEX["torque"]
    own[k, k] = 1e-4
    found = covariance(case, CERTAIN._replace(parameters=own))
    slopes = case[1].derivatives[..., k]
    expected = 1e-4 * slopes[..., :, np.newaxis] * slopes[..., np.newaxis, :]
    last = found[:, -1, RATES, RATES]
    np.testing.assert_allclose(last, expected[:, -1, RATES, RATES], atol=0.05 * np.abs(last).max())


def test_a_start_spreads_as_a_start_that_is_moved_does(case) -> None:
    state = np.zeros(STATES)
    state[10] = 1e-6
    found = covariance(case, CERTAIN._replace(state=state))
    flight = ahead(5.0, 1)
    motion = flight.motion.copy()
    motion["rates"][STARTS, 1] += 1e-3
    moved = true_model().track(replace(flight, motion=motion))
    ways = [
        roll_out(track, STARTS, HORIZONS, known_parameters(), derivatives=False).path[:, -1]
        for track in (moved, case[0])
    ]
    for name, part in (("velocity", VELOCITY), ("rates", RATES)):
        change = ways[0][name] - ways[1][name]
        # That of the state at the end comes on top.
        variance = np.diagonal(found[:, -1, part, part], axis1=1, axis2=2) - state[part]
        np.testing.assert_allclose(np.sqrt(variance), np.abs(change), atol=0.06 * np.abs(change).max())


def test_a_disturbance_spreads_as_a_random_walk_of_its_own(case) -> None:
    # New at each step and gone with the next: rates walk at random.
    drive = np.zeros(6)
    drive[5] = 1e-6
    found = covariance(case, CERTAIN._replace(drive=drive, decay=np.full(6, 1e-9)))
    single = STEP_S * 1e-3 / VEHICLE.inertia[2, 2]
    # After ten steps nine have acted.
    np.testing.assert_allclose(np.sqrt(found[:, 1, 11, 11]), 3.0 * single, rtol=0.05)
    np.testing.assert_allclose(np.sqrt(found[:, 2, 11, 11]), np.sqrt(29.0) * single, rtol=0.1)


def test_an_attitude_that_is_lost_pushes_no_harder_than_the_thrust(case) -> None:
    state = np.zeros(STATES)
    state[6:9] = [25.0, 25.0, 0.0]
    found = covariance(case, CERTAIN._replace(state=state))[:, -1]
    # 0.3 s of a thrust of about the weight, by a direction at random.
    assert np.all(np.sqrt(np.diagonal(found[:, VELOCITY, VELOCITY], axis1=1, axis2=2)) < 0.3 * 12.0)


def test_each_horizon_has_a_covariance(case) -> None:
    state = np.full(STATES, 1e-6)
    found = covariance(case, CERTAIN._replace(state=state, wrench=np.full(6, 1e-4)))
    assert np.all(np.linalg.eigvalsh(found) > 0.0)
    sizes = np.sqrt(np.linalg.det(found[..., ATTITUDE, ATTITUDE]))
    assert np.all(np.diff(sizes, axis=1) > 0.0)
