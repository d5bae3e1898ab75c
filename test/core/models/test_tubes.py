# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.physical_rollout import ATTITUDE, POSITION, RATES, STATES, VELOCITY, roll_out
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.models.tubes import (
    HORIZONS_S,
    QUANTITIES,
    USUAL,
    Following,
    TubeCalibration,
    TubeShape,
    Uncertainty,
    chosen_shape,
    error_covariance,
    error_norms,
    tracked_factors,
    tube_radii,
    tube_scores,
)
from test.core.models.flights_ahead import ahead, true_model
from test.core.models.physical_flights import STEP_S, VEHICLE, known_parameters

FOLLOWING = Following([1], 0.05, 0.4)


def everywhere(share: float, power: float) -> TubeShape:
    return TubeShape(np.full(4, share), np.full(4, power))


def covariances(seed: int, *, spread: float, flat: float) -> Array:
    """Covariances (400, 1, 12, 12) whose size varies from start to start, and whose axes are unlike."""
    rng = np.random.default_rng(seed)
    sizes = np.exp(spread * rng.normal(size=(400, 1, 1)))
    return np.square(sizes * np.tile([1.0, 1.0, flat], 4))[..., np.newaxis] * np.eye(12)


def errors_of(covariance: Array, seed: int) -> Array:
    normal = np.random.default_rng(seed).normal(size=covariance.shape[:-1])
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1)) * normal


def test_a_radius_is_that_of_the_ball_of_equal_volume() -> None:
    covariance = np.diag([1.0, 4.0, 16.0, *np.ones(9)])[np.newaxis, np.newaxis]
    np.testing.assert_allclose(tube_radii(covariance), [[[2.0, 1.0, 1.0, 1.0]]])


def test_no_share_and_full_power_is_the_covariance_itself() -> None:
    factor = np.random.default_rng(1).normal(size=(2, 1, 12, 12))
    full = factor @ factor.transpose(0, 1, 3, 2)
    shaped = everywhere(0.0, 1.0).shaped(full)
    for part in QUANTITIES.values():
        np.testing.assert_allclose(shaped[..., part, part], full[..., part, part])


def test_a_power_of_half_grows_with_the_root_of_the_size() -> None:
    covariance = covariances(1, spread=0.5, flat=0.1)
    for power in (1.0, 0.5):
        radii = tube_radii(everywhere(0.3, power).shaped(covariance))
        larger = tube_radii(everywhere(0.3, power).shaped(4.0 * covariance))
        np.testing.assert_allclose(larger / radii, 2.0**power)


def test_position_and_velocity_of_earlier_models_are_rounded() -> None:
    factor = np.random.default_rng(1).normal(size=(2, 12, 12))
    full = factor @ factor.transpose(0, 2, 1)
    found = USUAL.shaped(full)
    for part in (POSITION, VELOCITY):
        before, after = np.linalg.eigvalsh(full[..., part, part]), np.linalg.eigvalsh(found[..., part, part])
        np.testing.assert_allclose(after.sum(axis=-1), before.sum(axis=-1))
        apart = after - after.mean(axis=-1, keepdims=True)
        np.testing.assert_allclose(apart, 0.7 * (before - before.mean(axis=-1, keepdims=True)), atol=1e-9)
    for part in (ATTITUDE, RATES):
        np.testing.assert_allclose(found[..., part, part], full[..., part, part])


@pytest.mark.parametrize("known", [True, False])
def test_physics_are_followed_as_far_as_they_tell(known: bool) -> None:
    """Covariances of the errors themselves give an ellipsoid, ones that say nothing of them a ball."""
    told = [covariances(seed, spread=0.6, flat=0.2) for seed in (1, 2, 3)]
    flew = told if known else [np.broadcast_to(np.eye(12), own.shape) for own in told]
    errors = [errors_of(own, 10 + k) for k, own in enumerate(flew)]
    shape = chosen_shape(errors, told, FOLLOWING)
    if known:
        assert np.all(shape.round_share == 0.0)
        assert np.all(shape.size_power >= 0.75)
    else:
        assert np.all(shape.round_share == 1.0)
        assert np.all(shape.size_power == 0.0)


def test_one_flight_chooses_no_shape() -> None:
    told = covariances(1, spread=0.6, flat=0.2)
    assert chosen_shape([errors_of(told, 1)], [told], FOLLOWING) is USUAL


@pytest.mark.parametrize("size", [0.5, 1.0, 2.5])
def test_tubes_that_follow_a_flight_cover_it_whatever_its_errors(size: float) -> None:
    rng = np.random.default_rng(1)
    scores = size * np.linalg.norm(rng.normal(size=(400, 2, 4, 3)), axis=-1)
    factors = tracked_factors(scores, np.full((2, 4), 2.7955), Following([1, 5], 0.05, 0.4))
    coverage = np.mean(scores <= factors, axis=0)
    assert np.all(np.abs(coverage - 0.95) < 0.03)


def test_a_tube_knows_no_error_before_its_roll_out_has_ended() -> None:
    scores = np.ones((20, 1, 4))
    changed = scores.copy()
    changed[10:] = 1e6
    first, second = (
        tracked_factors(own, np.full((1, 4), 2.0), Following([5], 0.05, 0.4)) for own in (scores, changed)
    )
    np.testing.assert_array_equal(first[:15], second[:15])
    assert np.all(second[15:] > first[15:])


@pytest.fixture(scope="module")
def errors():
    """Errors of three flights whose covariance is known, the last flight's twice as large."""
    rng = np.random.default_rng(1)
    axes = rng.uniform(0.1, 3.0, 12)
    covariance = np.tile(np.diag(axes**2), (400, len(HORIZONS_S), 1, 1))
    return covariance, [size * axes * rng.normal(size=(400, len(HORIZONS_S), 12)) for size in (1, 1, 2)]


@pytest.fixture(scope="module")
def calibration(errors):
    covariance, flights = errors
    return TubeCalibration.of_flights(
        [tube_scores(own, covariance) for own in flights], [error_norms(own) for own in flights]
    )


def test_scores_of_normal_errors_are_those_of_a_chi_distribution(errors) -> None:
    covariance, flights = errors
    # 95 % of three normal numbers lie within 2.7955 of their deviations.
    inside = tube_scores(flights[0], covariance) < 2.7955
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)
    assert tube_scores(flights[0], covariance).shape == (400, len(HORIZONS_S), len(QUANTITIES))


def test_the_factor_lies_in_the_middle_of_the_flights(calibration) -> None:
    factors = calibration.factors(HORIZONS_S, 0.95)
    # Geometric mean of 1, 1 and 2.
    np.testing.assert_allclose(factors, 2.7955 * 2.0 ** (1.0 / 3.0), rtol=0.1)
    assert np.all(calibration.factors(HORIZONS_S, 0.9) < factors)
    between = calibration.factors([0.07], 0.95)
    assert np.all((between >= factors.min() - 1e-9) & (between <= factors.max() + 1e-9))


@pytest.mark.parametrize("horizon", [0.001, 1.5])
def test_a_horizon_that_was_not_calibrated_is_refused(calibration, horizon) -> None:
    with pytest.raises(ModelError, match=r"calibrated from 0\.01 to 1 s"):
        calibration.radii([horizon], 0.95)


def test_a_stored_calibration_is_the_same_and_damage_is_refused(calibration) -> None:
    arrays = calibration.arrays()
    assert all(own.flags.c_contiguous for own in arrays.values())
    read = TubeCalibration.stored(arrays)
    np.testing.assert_array_equal(read.factors([0.1], 0.95), calibration.factors([0.1], 0.95))
    with pytest.raises(ModelError, match="scores"):
        TubeCalibration.stored({**arrays, "calibration_scores": -arrays["calibration_scores"]})
    with pytest.raises(ModelError, match="norms"):
        TubeCalibration.stored({**arrays, "calibration_norms": arrays["calibration_norms"][:, :2]})
    shape = {"calibration_shape": np.array([[0.0, 0.3, 0.6, 1.0], [1.0, 0.5, 0.0, 0.25]])}
    np.testing.assert_array_equal(
        TubeCalibration.stored({**arrays, **shape}).shape.size_power, [1, 0.5, 0, 0.25]
    )
    with pytest.raises(ModelError, match="shape of tubes"):
        TubeCalibration.stored({**arrays, "calibration_shape": 2.0 * shape["calibration_shape"]})


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
