# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.physical_fit import Sensing, flights_of, reference_thrust
from quadpi_core.models.physical_terms import physical_vehicle
from test.core.models.physical_flights import (
    REFERENCE,
    VEHICLE,
    flown,
    known_parameters,
    samples_of,
    swept,
)

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
