# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import ModelError, QuadpiError
from quadpi_core.evaluation.evaluate import JUDGED_S, evaluate_rollouts, judge_flight
from quadpi_core.identification.prepared_flights import read_flight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.vehicle import Vehicle

QUANTITIES = ["position_m", "velocity_m_s", "attitude_deg", "rates_rad_s"]


@pytest.fixture(scope="module")
def model(predicting: Path) -> AerodynamicModel:
    return AerodynamicModel.load(predicting)


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("neurobem")


def test_errors_and_tubes_of_each_horizon(model, vehicle, bags) -> None:
    flights, evaluation = evaluate_rollouts(model, [bags[2]], vehicle)
    assert list(evaluation.flights) == ["flight2"]
    judged = evaluation.flights["flight2"]
    assert list(judged.horizons) == [f"{horizon:g}" for horizon in JUDGED_S]
    assert judged.starts == len(flights[0].rolled.starts)
    for horizon in judged.horizons.values():
        assert list(horizon) == QUANTITIES
        assert all(0.0 < own.rms < 100.0 and own.width > 0.0 for own in horizon.values())
    # Ten starts a second, and a tube at each of them.
    times = flights[0].flight.time[flights[0].rolled.starts]
    assert np.median(np.diff(times)) == pytest.approx(0.1, rel=0.05)
    # Errors grow with the horizon.
    assert judged.horizons["0.01"]["velocity_m_s"].rms < judged.horizons["0.5"]["velocity_m_s"].rms


def test_another_horizon_is_judged_too(model, vehicle, bags) -> None:
    _, evaluation = evaluate_rollouts(model, [bags[2]], vehicle, horizon_s=0.25, confidence=0.8)
    assert list(evaluation.flights["flight2"].horizons) == ["0.01", "0.1", "0.25"]
    assert evaluation.confidence == 0.8
    assert evaluation.to_json()["horizon_s"] == 0.25


def test_a_horizon_longer_than_the_flight_is_refused(model, vehicle, bags) -> None:
    flight = read_flight(bags[2], vehicle, model.cutoff_hz)
    short = flight.slice(slice(0, 170))
    with pytest.raises(ModelError, match=r"0\.4\d s in the air, shorter than the horizon of 0\.5 s"):
        judge_flight(model.require_rollouts(), short, vehicle, horizon_s=0.5, confidence=0.95)


def test_windows_without_a_rotor_are_left_out_and_counted(model, vehicle, bags) -> None:
    flight = read_flight(bags[2], vehicle, model.cutoff_hz)
    speeds = flight.rotor_speeds.copy()
    speeds[1000:1100, 1] = 0.0
    _, judged = judge_flight(
        model.require_rollouts(),
        replace(flight, rotor_speeds=speeds),
        vehicle,
        horizon_s=0.5,
        confidence=0.95,
    )
    assert judged.left_out >= 5
    speeds[:, 1] = np.where(np.arange(len(speeds)) % 150 < 10, 0.0, speeds[:, 1])
    with pytest.raises(ModelError, match="rotor_speeds: a rotor was not measured"):
        judge_flight(
            model.require_rollouts(),
            replace(flight, rotor_speeds=speeds),
            vehicle,
            horizon_s=0.5,
            confidence=0.95,
        )


def test_models_that_cannot_predict_are_refused(model, vehicle, bags) -> None:
    with pytest.raises(ModelError, match="identify it again"):
        evaluate_rollouts(replace(model, rollouts=None), [bags[2]], vehicle)
    heavier = replace(vehicle, mass_kg=2.0 * vehicle.mass_kg)
    with pytest.raises(ModelError, match="another mass, inertia or rotor geometry"):
        evaluate_rollouts(model, [bags[2]], heavier)
    longer = replace(vehicle, rotor_positions=1.2 * vehicle.rotor_positions)
    with pytest.raises(ModelError, match=r"rotor 1 .* mm from where vehicle file"):
        evaluate_rollouts(model, [bags[2]], longer)
    with pytest.raises(ModelError, match=r"calibrated from 0\.01 to 1 s"):
        evaluate_rollouts(model, [bags[2]], vehicle, horizon_s=2.0)
    with pytest.raises(QuadpiError, match="the same flight as"):
        evaluate_rollouts(model, [bags[2], bags[2]], vehicle)
