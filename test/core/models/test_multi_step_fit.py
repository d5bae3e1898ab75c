# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.frames import Array
from quadpi_core.models.multi_step_fit import MultiStepFit, fit_multi_step
from quadpi_core.models.physical_fit import Problem
from quadpi_core.models.physical_rollout import ATTITUDE
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.models.rollout_flight import RolloutFlight
from quadpi_core.models.rollout_model import RolloutModel
from test.core.models.flights_ahead import ahead, true_model
from test.core.models.physical_flights import REFERENCE, VEHICLE, known_parameters

PROBLEM = Problem.of(VEHICLE, REFERENCE)
HUB = TERM_INDEX["hub_height"]


def wrong_model() -> RolloutModel:
    """The model that flew, but for a moment of the hub that equation errors did not tell."""
    values = known_parameters()
    values[HUB] += PROBLEM.spread[HUB]
    covariance = np.diag(np.square(PROBLEM.spread))
    return replace(true_model(), parameters=values, covariance=covariance)


def attitude_error(model: RolloutModel, flight: RolloutFlight) -> float:
    errors = model.predicted(flight, flight.starts(50, 10), np.array([50])).errors[:, 0, ATTITUDE]
    return float(np.median(np.linalg.norm(errors, axis=1)))


@pytest.fixture(scope="module")
def flights() -> list[RolloutFlight]:
    return [ahead(10.0, seed, noise=1.0) for seed in (1, 2)]


@pytest.fixture(scope="module")
def fit(flights: list[RolloutFlight]) -> MultiStepFit:
    return fit_multi_step(flights, wrong_model(), PROBLEM)


def test_predictions_of_a_flight_that_was_not_seen_improve(fit: MultiStepFit) -> None:
    flight = ahead(10.0, 9, noise=1.0)
    assert attitude_error(fit.model, flight) < 0.3 * attitude_error(wrong_model(), flight)
    assert abs(fit.model.parameters[HUB] - known_parameters()[HUB]) < 0.2 * PROBLEM.spread[HUB]


def test_the_cost_falls_with_each_iteration(fit: MultiStepFit) -> None:
    costs = [step.error for step in fit.log if "iteration" in step.of]
    assert costs
    assert max(costs) < 1.0


def test_standard_errors_shrink_where_predictions_tell_a_parameter(fit: MultiStepFit) -> None:
    errors: Array = np.sqrt(np.diag(fit.model.covariance)) / PROBLEM.spread
    assert errors[HUB] < 0.4
    # The position of the accelerometer moves no body.
    assert errors[TERM_INDEX["imu_x"]] == pytest.approx(1.0)


def test_a_wild_sample_changes_little(flights: list[RolloutFlight], fit: MultiStepFit) -> None:
    motion = flights[0].motion.copy()
    motion["rates"][305] += 50.0
    wild = fit_multi_step([replace(flights[0], motion=motion), flights[1]], wrong_model(), PROBLEM)
    moved = (wild.model.parameters - fit.model.parameters) / PROBLEM.spread
    assert abs(moved[HUB]) < 0.2
    assert len(wild.model.parameters) == len(TERMS)
