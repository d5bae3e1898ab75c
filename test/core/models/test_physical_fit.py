# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.kinds.physical import PhysicalStudy, delays_not_ruled_out
from quadpi_core.models.physical_fit import (
    Information,
    PhysicalFlight,
    Problem,
    Sensing,
    flights_of,
    reference_thrust,
    thrust_variance,
    worst_pairs,
)
from quadpi_core.models.physical_terms import TERM_INDEX, TERM_NAMES, physical_vehicle
from test.core.models.physical_flights import (
    NOISE,
    REFERENCE,
    VEHICLE,
    flown,
    known_parameters,
    samples_of,
    swept,
)


def studied(flights: list[PhysicalFlight]) -> PhysicalStudy:
    return PhysicalStudy.from_flights(flights, VEHICLE, sensing=Sensing())


def fitted(flights: list[PhysicalFlight]) -> PhysicalFit:
    return studied(flights).fit(choose=False)


def independent_hz(study: PhysicalStudy) -> Array:
    return study.weighing.independent * study.rate_hz


@pytest.fixture(scope="module")
def flights() -> list[PhysicalFlight]:
    return [flown(20.0, seed) for seed in (1, 2, 3)]


@pytest.mark.parametrize("bandwidth_hz", [None, 8.0])
def test_sums_hold_all_that_the_regressors_do(
    flights: list[PhysicalFlight], bandwidth_hz: float | None
) -> None:
    """Smoothing in the world mixes the axes of forces."""
    flight, values = flights[0], known_parameters()
    fit = fitted(flights[:1])
    sensing = Sensing(0.0, bandwidth_hz)
    summed = Information.from_samples(flight.regressors(fit.vehicle, sensing), flight.wrench)
    errors = flight.errors(values, fit.vehicle, sensing)
    np.testing.assert_allclose(summed.rmse(values), np.sqrt(np.mean(np.square(errors), axis=0)), rtol=1e-6)


def test_the_parameters_that_flew_lie_in_their_intervals(flights: list[PhysicalFlight]) -> None:
    study = studied(flights)
    fit = study.fit(choose=False)
    score = np.abs(fit.values - known_parameters()) / fit.standard_errors
    assert np.mean(score < 1.96) >= 0.9
    thrust = TERM_INDEX["torque"]
    assert fit.values[thrust] == pytest.approx(known_parameters()[thrust], rel=0.1)
    np.testing.assert_allclose(study.weighing.deviation, NOISE, rtol=0.1)
    # Errors of white noise are all independent.
    assert np.all(independent_hz(study) > 50.0)


def test_standard_errors_hold_where_errors_change_slowly() -> None:
    """Errors that stay for two seconds are fewer than an axis weighs by at least."""
    rng, truth = np.random.default_rng(5), known_parameters()
    scores = []
    for seed in (11, 12):
        slow = []
        for flight in (flown(30.0, seed, noise=0.0), flown(30.0, seed + 20, noise=0.0)):
            held = rng.normal(size=(len(flight.time) // 200 + 1, 6)).repeat(200, axis=0)[: len(flight.time)]
            slow.append(replace(flight, wrench=flight.wrench + NOISE * held))
        study = studied(slow)
        fit = study.fit(choose=False)
        assert np.median(independent_hz(study)) < 1.0
        told = fit.standard_errors < 0.5 * Problem.from_vehicle(VEHICLE, study.reference).spread
        scores.append((np.abs(fit.values - truth) / fit.standard_errors)[told])
    assert np.mean(np.concatenate(scores) < 1.96) > 0.9


def test_errors_that_hang_together_widen_standard_errors(flights: list[PhysicalFlight]) -> None:
    white = studied(flights)
    rng = np.random.default_rng(0)
    slow = []
    for flight in flights:
        steps = NOISE * rng.normal(size=(len(flight.time) // 50 + 2, 6))
        slow.append(
            replace(
                flight,
                wrench=flight.wrench
                + np.stack(
                    [np.interp(flight.time / 0.5, range(len(steps)), column) for column in steps.T], 1
                ),
            )
        )
    coloured = studied(slow)
    assert np.all(independent_hz(coloured) < 0.2 * independent_hz(white))
    wide, narrow = (own.fit(choose=False).standard_errors for own in (coloured, white))
    told = narrow < 0.1 * Problem.from_vehicle(VEHICLE, white.reference).spread
    assert np.median(wide[told] / narrow[told]) > 2.0


def test_the_change_of_thrust_of_a_flight_is_found(flights: list[PhysicalFlight]) -> None:
    fit = fitted(flights[:2])
    wrench = flights[2].wrench.copy()
    assert fit.thrust_change(flights[2]) == pytest.approx(0.0, abs=0.003)
    wrench[:, 2] *= 0.97
    assert fit.thrust_change(replace(flights[2], wrench=wrench)) == pytest.approx(-0.03, abs=0.003)


def test_thrust_differs_by_three_percent_until_flights_say_otherwise() -> None:
    assert np.sqrt(thrust_variance([])) == pytest.approx(0.03)
    # Two flights count as much as what is known before.
    assert thrust_variance([0.0, 0.0]) == pytest.approx(0.5 * 0.03**2)
    assert np.sqrt(thrust_variance([0.01] * 100)) == pytest.approx(0.01, rel=0.1)


def test_a_negative_torque_is_held_at_its_bound() -> None:
    flight = flown(10.0, 1)
    wrench = flight.wrench.copy()
    turning = np.square(flight.motion["rotor_speeds"]) @ VEHICLE.rotor_spins
    wrench[:, 5] += 5.0 * known_parameters()[TERM_INDEX["torque"]] * turning
    fit = fitted([replace(flight, wrench=wrench)])
    assert [name for name, note in fit.notes.items() if note == "at its lower bound, 0"] == ["torque"]


def test_pairs_that_are_told_apart_worst_come_first(flights: list[PhysicalFlight]) -> None:
    pairs = worst_pairs(fitted(flights).covariance)
    sizes = [abs(correlation) for _, _, correlation in pairs]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > 0.9
    assert {name for first, second, _ in pairs for name in (first, second)} <= set(TERM_NAMES)


@pytest.mark.parametrize("delay_s", [0.0, 0.0075])
@pytest.mark.parametrize("noise", [0.1, 2.0])
def test_the_delay_of_rotor_speeds_is_found(delay_s: float, noise: float) -> None:
    flights = [swept(10.0, seed, delay_s=delay_s, noise=noise) for seed in (1, 2)]
    study = PhysicalStudy.from_flights(flights, VEHICLE)
    assert study.sensing == Sensing(delay_s, None)
    assert [step.of for step in study.log[:2]] == ["0 ms", "2.5 ms"]


def test_the_bandwidth_of_a_smoothed_force_is_found() -> None:
    smooth = []
    for flight in (swept(20.0, seed, noise=0.1, fastest_hz=20.0) for seed in (1, 2)):
        wrench = flight.wrench.copy()
        wrench[:, :3] = flight.recorded(wrench[:, :3, np.newaxis], Sensing(0.0, 7.0))[:, :, 0]
        smooth.append(replace(flight, wrench=wrench))
    found = PhysicalStudy.from_flights(smooth, VEHICLE).sensing.force_bandwidth_hz
    assert found is not None
    assert 6.0 <= found <= 8.0


def test_flights_left_out_are_predicted_as_well_as_noise_allows() -> None:
    flights = [flown(20.0, seed) for seed in (1, 2, 3)]
    study = PhysicalStudy.from_flights(flights, VEHICLE, sensing=Sensing())
    fit = study.fit(choose=True, left_out=0)
    faster = flown(20.0, 9, speed=6.0)
    for flight in (flights[0], faster):
        squares = np.square(flight.errors(fit.values, fit.vehicle, fit.sensing))
        assert np.all(np.sqrt(np.mean(squares, axis=0)) < 1.5 * NOISE)
    gains = {step.of: step.error for step in fit.log if step.step == "gain of a group kept"}
    assert gains["rotor drag"] > -0.05


def test_a_group_that_harms_flights_left_out_leaves() -> None:
    """Products of rates that act one way on one flight and the other way on the next."""

    def with_products(flight: PhysicalFlight, sign: float) -> PhysicalFlight:
        wrench, rates = flight.wrench.copy(), flight.motion["rates"]
        wrench[:, 5] += sign * 2e-3 * rates[:, 0] * rates[:, 1]
        return replace(flight, wrench=wrench)

    flights = [with_products(swept(20.0, seed, noise=0.1), sign) for seed, sign in ((1, 1.0), (2, -1.0))]
    fit = PhysicalStudy.from_flights(flights, VEHICLE, sensing=Sensing()).fit(choose=True)
    assert "without inertia" in {step.of for step in fit.log}
    assert TERM_INDEX["inertia_z"] not in fit.kept
    assert TERM_INDEX["thrust"] in fit.kept


def test_no_flights_are_refused() -> None:
    with pytest.raises(ModelError, match="no flights"):
        PhysicalStudy.from_flights([], VEHICLE)


def test_delays_of_nearly_the_greatest_likelihood_are_not_ruled_out() -> None:
    """Twice the logarithm of the likelihood falls by 3 at a neighbour, and by 5 at the next."""
    count = np.array([100.0, 1.0, 1.0])
    fall = np.array([900.0, 400.0, 5.0, 0.0, 3.0, 5.0, 900.0])
    squares = np.exp(np.column_stack((fall / 100.0, np.zeros(7), np.zeros(7))))
    assert delays_not_ruled_out(squares, count, 3) == (0.0075, 0.01)


def test_a_delay_that_is_used_against_the_likelihood_widens_the_range_up_to_itself() -> None:
    """Two axes with few errors of their own prefer 2.5 ms, one with many 7.5 ms: 12.5 ms is ruled out."""
    places = np.arange(7.0)
    squares = 1.0 + 0.1 * np.abs(places[:, np.newaxis] - np.array([1.0, 1.0, 3.0]))
    assert delays_not_ruled_out(squares, np.array([10.0, 10.0, 500.0]), 1) == (0.0025, 0.0075)


RECORD = physical_vehicle(VEHICLE, REFERENCE)


@pytest.mark.parametrize(
    ("rate_hz", "left_hz"), [(100.0, 100.0), (149.0, 149.0), (200.0, 100.0), (500.0, 100.0)]
)
def test_samples_are_thinned_to_about_100_hz(rate_hz: float, left_hz: float) -> None:
    samples = samples_of([swept(10.0, 0)])
    (flight,) = flights_of(replace(samples, time=samples.time * 100.0 / rate_hz))
    assert flight.rate_hz == pytest.approx(left_hz, rel=0.01)


def test_a_flight_of_less_than_a_second_is_refused_by_name() -> None:
    flights = [swept(2.0, 0), replace(swept(0.5, 1), name="hop")]
    with pytest.raises(ModelError, match="hop: the physical model needs 1 s or more in the air"):
        flights_of(samples_of(flights))


def test_errors_are_what_the_regressors_leave() -> None:
    flight, values = swept(2.0, 0, noise=0.0), known_parameters()
    for sensing in (Sensing(), Sensing(0.005, 8.0)):
        z = flight.regressors(RECORD, sensing)
        expected = flight.wrench - np.einsum("npa,p->na", z, values)
        np.testing.assert_allclose(flight.errors(values, RECORD, sensing), expected, atol=1e-9)


def test_rotor_speeds_that_act_late_are_taken_as_they_were() -> None:
    flight, values = swept(5.0, 0, delay_s=0.005, noise=0.0), known_parameters()
    at_once, late = (
        np.sqrt(np.mean(np.square(flight.errors(values, RECORD, Sensing(delay_s))), axis=0))
        for delay_s in (0.0, 0.005)
    )
    assert np.all(late[2:5] < 0.05 * at_once[2:5])


def test_parts_hold_all_samples_in_order() -> None:
    flight = swept(130.0, 0)
    parts = list(flight.parts())
    assert len(parts) == 3
    np.testing.assert_array_equal(np.concatenate([part.time for part in parts]), flight.time)


def test_thrust_per_square_of_the_rotor_speed() -> None:
    flight = flown(5.0, 1, speed=0.0)
    squares = np.sum(np.square(flight.motion["rotor_speeds"]), axis=1)
    expected = -np.mean(flight.wrench[:, 2]) / np.mean(squares)
    assert reference_thrust([flight]) == pytest.approx(expected, rel=0.01)
    with pytest.raises(ModelError, match="flight_1: the measured force does not point up"):
        reference_thrust([replace(flight, wrench=-flight.wrench)])
