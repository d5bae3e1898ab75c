# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.frames import inverses, products, to_rotation_vector
from quadpi_core.inputs import aerodynamic_inputs
from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.kinds.physical import PhysicalStudy
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.multi_step_fit import calibrated_rollouts, rollout_flights
from quadpi_core.models.physical_fit import PhysicalFlight, Problem, Sensing
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.models.rollout_model import RolloutFlight, RolloutModel, horizon_steps
from quadpi_core.models.tubes import HORIZONS_S, error_norms, tube_scores
from test.core.models.flights_ahead import with_attitude
from test.core.models.physical_flights import VEHICLE, flown, known_parameters, samples_of


@pytest.fixture(scope="module")
def flights() -> list[PhysicalFlight]:
    return [flown(15.0, seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def fits(flights: list[PhysicalFlight]) -> list[PhysicalFit]:
    """Of all flights, then without each of them."""
    study = PhysicalStudy.from_flights(flights, VEHICLE, sensing=Sensing())
    return [study.fit(choose=False, left_out=k) for k in (None, 0, 1, 2)]


@pytest.fixture(scope="module")
def model(flights: list[PhysicalFlight], fits: list[PhysicalFit]) -> RolloutModel:
    ahead = [with_attitude(flight) for flight in flights]
    made, log = calibrated_rollouts(ahead, VEHICLE, fits[0], fits[1:], multi_step=False)
    assert made is not None
    assert log == ()
    np.testing.assert_array_equal(made.parameters, fits[0].values)
    return made


def samples(flight: PhysicalFlight, own: RolloutFlight) -> TrainingSamples:
    columns = [np.ascontiguousarray(flight.motion[name]) for name in ("velocity", "rates", "rotor_speeds")]
    inputs = aerodynamic_inputs(columns[0], own.attitude, columns[1], columns[2], VEHICLE)
    return replace(samples_of([flight]), inputs=inputs)


def test_attitude_and_heading_come_back_from_the_input_vector(flights: list[PhysicalFlight]) -> None:
    truth = with_attitude(flights[0])
    (found,) = rollout_flights(samples(flights[0], truth))
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
    flights: list[PhysicalFlight], fits: list[PhysicalFit]
) -> None:
    ahead = [with_attitude(flight) for flight in flights]
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
