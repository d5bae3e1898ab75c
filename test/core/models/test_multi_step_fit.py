# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.frames import Array, inverses, products, to_rotation_vector
from quadpi_core.inputs import aerodynamic_inputs
from quadpi_core.models import multi_step_fit
from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.kinds.physical import PhysicalStudy
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.multi_step_fit import (
    EVERY_S,
    FITTED_HORIZONS_S,
    WEIGHTS_TRIED,
    MultiStepFit,
    Windows,
    calibrated_rollouts,
    fit_multi_step,
    log_ratio,
    mean_norms,
    median_norms,
    part_of,
    rollout_flights,
)
from quadpi_core.models.physical_fit import PhysicalFlight, Problem, Sensing
from quadpi_core.models.physical_rollout import ATTITUDE, AxisDisturbance, Disturbance
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.models.rollout_model import MOVES, RolloutFlight, RolloutModel, horizon_steps
from quadpi_core.models.tubes import HORIZONS_S, error_norms, tube_scores
from test.core.models.flights_ahead import ahead, true_model, with_attitude
from test.core.models.physical_flights import REFERENCE, STEP_S, VEHICLE, flown, known_parameters, samples_of

PROCESS = Disturbance(STEP_S, (AxisDisturbance(0.01, 0.3, 0.1),) * 6)
MODEL = true_model(PROCESS)


@pytest.fixture(scope="module")
def one_flight() -> RolloutFlight:
    return ahead(6.0, 1, noise=1.0)


@pytest.fixture(scope="module")
def windows(one_flight: RolloutFlight) -> Windows:
    return Windows.from_flight(one_flight, MODEL)


def test_roll_outs_start_every_half_second_with_the_disturbance_of_predictions(
    one_flight: RolloutFlight, windows: Windows
) -> None:
    assert np.diff(windows.starts).tolist() == [round(EVERY_S / STEP_S)] * (len(windows.starts) - 1)
    assert windows.horizons.tolist() == [round(horizon / STEP_S) for horizon in FITTED_HORIZONS_S]
    predicted = MODEL.predicted(one_flight, windows.starts, windows.horizons)
    rolled = windows.rolled(MODEL.parameters, derivatives=False)
    np.testing.assert_allclose(rolled.errors, predicted.errors, rtol=1e-9, atol=1e-12)


def test_the_regressors_of_a_long_flight_are_filtered_in_parts(
    one_flight: RolloutFlight, windows: Windows, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(multi_step_fit, "_SAMPLES", 130)
    np.testing.assert_allclose(
        Windows.from_flight(one_flight, MODEL).predicted, windows.predicted, rtol=1e-9, atol=1e-15
    )


def test_the_gradient_is_that_of_the_cost(windows: Windows) -> None:
    free = MOVES & np.isin(np.arange(len(TERMS)), [TERM_INDEX[n] for n in ("thrust", "hub_height", "drag_x")])
    unit = 0.1 * np.abs(known_parameters()[free])
    scale = median_norms(windows.rolled(MODEL.parameters, derivatives=False))

    def cost(moved: Array) -> float:
        values = MODEL.parameters.copy()
        values[free] += moved * unit
        return part_of(windows.rolled(values, derivatives=False), scale, free, unit).value

    part = part_of(windows.rolled(MODEL.parameters, derivatives=True), scale, free, unit)
    for k in range(3):
        step = 1e-4 * np.eye(3)[k]
        slope = (cost(step) - cost(-step)) / 2e-4
        assert part.gradient[k] == pytest.approx(slope, rel=1e-3, abs=1e-3 * np.abs(part.gradient).max())
    np.testing.assert_allclose(part.blocks.sum(axis=0), part.gradient)
    assert np.all(np.linalg.eigvalsh(part.matrix) > 0.0)


def test_starts_whose_roll_out_is_not_finite_are_left_out(
    one_flight: RolloutFlight, windows: Windows
) -> None:
    motion = one_flight.motion.copy()
    motion["rates"][300] = np.nan
    found = Windows.from_flight(replace(one_flight, motion=motion), MODEL)
    # The disturbance after that sample is not known either.
    assert found.starts.tolist() == [start for start in windows.starts if start + 50 < 300]
    assert np.all(np.isfinite(found.rolled(MODEL.parameters, derivatives=False).errors))


def test_errors_of_flights_are_compared_by_their_ratio(windows: Windows) -> None:
    wrong = MODEL.parameters.copy()
    wrong[TERM_INDEX["hub_height"]] *= 3.0
    right, worse = mean_norms([windows, windows], [MODEL.parameters, wrong])
    assert log_ratio(np.array([right]), np.array([right])) == 0.0
    assert log_ratio(2.0 * np.array([right]), np.array([right])) == pytest.approx(np.log(2.0))
    assert log_ratio(np.array([worse]), np.array([right])) > 0.0
    diverged = right.copy()
    diverged[-1, 2] = np.inf
    assert log_ratio(np.array([diverged]), np.array([right])) > 1e300


PROBLEM = Problem.from_vehicle(VEHICLE, REFERENCE)
HUB, TORQUE = TERM_INDEX["hub_height"], TERM_INDEX["torque"]


def wrong_model() -> RolloutModel:
    """The model that flew, but for a moment of the hub that equation errors did not tell."""
    values = known_parameters()
    values[HUB] += PROBLEM.spread[HUB]
    covariance = np.diag(np.square(PROBLEM.spread))
    return replace(true_model(), parameters=values, covariance=covariance)


def fitted(flights: list[RolloutFlight], first: RolloutModel) -> MultiStepFit:
    return fit_multi_step(flights, first, [first] * len(flights), PROBLEM)


def attitude_error(model: RolloutModel, flight: RolloutFlight) -> float:
    errors = model.predicted(flight, flight.starts(50, 10), np.array([50])).errors[:, 0, ATTITUDE]
    return float(np.median(np.linalg.norm(errors, axis=1)))


@pytest.fixture(scope="module")
def flights() -> list[RolloutFlight]:
    return [ahead(10.0, seed, noise=1.0) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def fit(flights: list[RolloutFlight]) -> MultiStepFit:
    return fitted(flights, wrong_model())


def test_predictions_of_a_flight_that_was_not_seen_improve(fit: MultiStepFit) -> None:
    flight = ahead(10.0, 9, noise=1.0)
    assert attitude_error(fit.model, flight) < 0.3 * attitude_error(wrong_model(), flight)
    assert abs(fit.model.parameters[HUB] - known_parameters()[HUB]) < 0.2 * PROBLEM.spread[HUB]
    assert fit.weight in WEIGHTS_TRIED
    assert "times those by the parameters of the wrench" in fit.model.remark


def test_by_the_prior_of_the_terms_a_first_step_that_is_too_sure_is_left(
    flights: list[RolloutFlight],
) -> None:
    sure = replace(wrong_model(), covariance=1e-8 * wrong_model().covariance)
    kept = fitted(flights, sure).model.parameters[HUB]
    left = fit_multi_step(flights, sure, [sure] * len(flights), PROBLEM, by_terms=True).model.parameters[HUB]
    true = known_parameters()[HUB]
    assert abs(kept - true) > 0.9 * PROBLEM.spread[HUB]
    assert abs(left - true) < 0.2 * PROBLEM.spread[HUB]


def test_a_fit_without_a_flight_is_that_of_the_others(
    flights: list[RolloutFlight], fit: MultiStepFit
) -> None:
    others = fitted(flights[:2], wrong_model())
    apart = (fit.left_out[2].parameters - others.model.parameters) / PROBLEM.spread
    assert abs(apart[HUB]) < 0.1
    assert attitude_error(fit.left_out[2], flights[2]) < 0.3 * attitude_error(wrong_model(), flights[2])


def test_standard_errors_shrink_where_predictions_tell_a_parameter(fit: MultiStepFit) -> None:
    errors: Array = np.sqrt(np.diag(fit.model.covariance)) / PROBLEM.spread
    assert errors[HUB] < 0.4
    # Place, bias and inclination of the accelerometer move no body.
    for name in ("imu_x", "bias_x", "incline_y"):
        assert errors[TERM_INDEX[name]] == pytest.approx(1.0)
    away = (fit.model.parameters - known_parameters()) / np.sqrt(np.diag(fit.model.covariance))
    assert np.mean(np.abs(away) < 2.0) > 0.9
    correlation = fit.model.covariance / np.outer(PROBLEM.spread, PROBLEM.spread)
    assert np.linalg.eigvalsh(correlation).min() > 0.0


def test_parameters_of_sensors_stay(flights: list[RolloutFlight]) -> None:
    """Roll-outs do not tell them, and begin with the disturbance that they leave."""
    first, bias = wrong_model(), TERM_INDEX["bias_x"]
    first.parameters[bias] = 0.5 * PROBLEM.spread[bias]
    first.covariance[bias, HUB] = first.covariance[HUB, bias] = (
        0.9 * PROBLEM.spread[bias] * PROBLEM.spread[HUB]
    )
    found = fitted(flights[:2], first).model
    assert found.parameters[HUB] != first.parameters[HUB]
    assert found.parameters[bias] == first.parameters[bias]
    assert found.covariance[bias, HUB] == 0.0
    assert found.covariance[bias, bias] == first.covariance[bias, bias]


def test_a_wild_sample_changes_little(flights: list[RolloutFlight], fit: MultiStepFit) -> None:
    motion = flights[0].motion.copy()
    motion["rates"][305] += 50.0
    wild = fitted([replace(flights[0], motion=motion), *flights[1:]], wrong_model())
    moved = (wild.model.parameters - fit.model.parameters) / PROBLEM.spread
    assert abs(moved[HUB]) < 0.2


def test_a_bound_holds() -> None:
    """Torque that turns the wrong way is not found, but none at all."""
    values = known_parameters()
    values[TORQUE] *= -0.5
    flights = [with_attitude(flown(6.0, seed, noise=0.1, values=values)) for seed in (1, 2)]
    first = wrong_model()
    first.parameters[TORQUE] = 0.02 * PROBLEM.spread[TORQUE]
    found = fitted(flights, first).model.parameters[TORQUE]
    assert 0.0 <= found < 1e-9 * PROBLEM.spread[TORQUE]


def test_the_first_step_is_kept_where_it_cannot_be_improved(flights: list[RolloutFlight]) -> None:
    sure = replace(true_model(), covariance=1e-10 * wrong_model().covariance)
    kept = fitted(flights[:2], sure)
    assert kept.weight == 0.0
    np.testing.assert_array_equal(kept.model.parameters, sure.parameters)
    np.testing.assert_array_equal(kept.left_out[1].covariance, sure.covariance)
    assert "was not used: flights left out are predicted with" in kept.model.remark
    assert kept.log[-1].of.startswith("not used")


def test_a_fit_that_diverges_on_flights_left_out_is_not_used(
    flights: list[RolloutFlight], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def diverging(*given: object) -> Array:
        calls.append(given)
        return np.full((2, 4, 4), np.inf if len(calls) > 1 else 1.0)

    monkeypatch.setattr(multi_step_fit, "mean_norms", diverging)
    kept = fitted(flights[:2], wrong_model())
    assert len(calls) == 1 + len(WEIGHTS_TRIED)
    assert kept.weight == 0.0
    np.testing.assert_array_equal(kept.model.parameters, wrong_model().parameters)


def test_one_flight_cannot_tell(flights: list[RolloutFlight]) -> None:
    kept = fitted(flights[:1], wrong_model())
    assert "one flight cannot tell" in kept.model.remark
    np.testing.assert_array_equal(kept.model.parameters, wrong_model().parameters)


@pytest.fixture(scope="module")
def short_flights() -> list[PhysicalFlight]:
    return [flown(15.0, seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def fits(short_flights: list[PhysicalFlight]) -> list[PhysicalFit]:
    """Of all short_flights, then without each of them."""
    study = PhysicalStudy.from_flights(short_flights, VEHICLE, sensing=Sensing())
    return [study.fit(choose=False, left_out=k) for k in (None, 0, 1, 2)]


@pytest.fixture(scope="module")
def model(short_flights: list[PhysicalFlight], fits: list[PhysicalFit]) -> RolloutModel:
    ahead = [with_attitude(flight) for flight in short_flights]
    made, log = calibrated_rollouts(ahead, VEHICLE, fits[0], fits[1:], multi_step=False)
    assert made is not None
    assert log == ()
    np.testing.assert_array_equal(made.parameters, fits[0].values)
    return made


def samples(flight: PhysicalFlight, own: RolloutFlight) -> TrainingSamples:
    columns = [np.ascontiguousarray(flight.motion[name]) for name in ("velocity", "rates", "rotor_speeds")]
    inputs = aerodynamic_inputs(columns[0], own.attitude, columns[1], columns[2], VEHICLE)
    return replace(samples_of([flight]), inputs=inputs)


def test_attitude_and_heading_come_back_from_the_input_vector(short_flights: list[PhysicalFlight]) -> None:
    truth = with_attitude(short_flights[0])
    (found,) = rollout_flights(samples(short_flights[0], truth))
    # Both from the same start: what is left is the drift of integrated rates.
    turned = products(products(truth.attitude[0:1], inverses(found.attitude[0:1])), found.attitude)
    error = to_rotation_vector(products(inverses(truth.attitude), turned))
    assert np.abs(error).max() < 0.02
    np.testing.assert_array_equal(found.motion["rates"], truth.motion["rates"])


def test_tubes_hold_a_flight_that_was_not_seen(model: RolloutModel) -> None:
    flight = with_attitude(flown(20.0, 9))
    horizons = horizon_steps(HORIZONS_S, flight.step)
    rolled = model.roll(flight, flight.starts(int(horizons[-1]), 10), horizons)
    assert model.calibration is not None
    shaped = model.calibration.shape.shaped(rolled.covariance)
    inside = tube_scores(rolled.errors, shaped) <= model.calibration.factors(HORIZONS_S, 0.95)
    assert 0.8 < np.mean(inside) <= 1.0
    assert np.median(error_norms(rolled.errors)[:, -2, 2]) < 0.1


def test_the_second_step_is_fitted_and_calibrated(
    short_flights: list[PhysicalFlight], fits: list[PhysicalFit]
) -> None:
    ahead = [with_attitude(flight) for flight in short_flights]
    # A moment of the hub that single samples did not tell, known as badly as the prior.
    hub = TERM_INDEX["hub_height"]
    spread = Problem.from_vehicle(VEHICLE, float(fits[0].vehicle["reference_thrust"][0])).spread[hub]
    for_hub = np.diag(np.where(np.arange(len(TERMS)) == hub, spread**2, 0.0))
    wrong = [
        replace(
            fit,
            values=fit.values + spread * (np.arange(len(TERMS)) == hub),
            covariance=fit.covariance + for_hub,
        )
        for fit in fits
    ]
    first, _ = calibrated_rollouts(ahead, VEHICLE, wrong[0], wrong[1:], multi_step=False)
    second, log = calibrated_rollouts(ahead, VEHICLE, wrong[0], wrong[1:], multi_step=True)
    assert first is not None
    assert second is not None
    assert log
    assert abs(second.parameters[hub] - known_parameters()[hub]) < 0.3 * spread
    assert second.calibration is not None
    assert first.calibration is not None
    radii = [own.radii([0.5], 0.95)[0, 2] for own in (second.calibration, first.calibration)]
    assert radii[0] < 0.6 * radii[1]


def test_flights_shorter_than_the_longest_horizon_calibrate_nothing(fits: list[PhysicalFit]) -> None:
    short = with_attitude(flown(1.05, 4))
    assert calibrated_rollouts([short], VEHICLE, fits[0], fits[:1], multi_step=True) == (None, ())
