# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What sound flights leave, as a model keeps it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.sound_flights import SoundFlights

COVARIANCE = np.array([[4e-10, 1e-3], [1e-3, 1e4]])


@pytest.fixture
def sound() -> SoundFlights:
    """Of two bands and two known errors, whose units differ by much."""
    return SoundFlights(
        flights=8,
        edges_hz=(0.0, 1.0, 20.0),
        noise=np.full((6, 2), 0.5),
        left=np.full((6, 2), 0.7),
        differ=np.full(6, 0.1),
        names=(("inertia", "x"), ("rotor_tilt (rotor 2)", "x_deg")),
        mean=np.array([1e-5, 50.0]),
        covariance=COVARIANCE,
        of_flight=np.array([2e-5, 0.0]),
    )


def test_it_reads_what_it_stored(sound: SoundFlights) -> None:
    read = SoundFlights.stored(sound.to_json(), sound.arrays())
    assert (read.flights, read.edges_hz, read.names) == (sound.flights, sound.edges_hz, sound.names)
    for name, values in sound.arrays().items():
        np.testing.assert_array_equal(getattr(read, name), values)


def test_deviations_are_those_of_the_mean_of_flights_and_of_each(sound: SoundFlights) -> None:
    """The mean of four flights that deviate for themselves has the covariance of what they share."""
    deviations = sound.deviations(4)
    np.testing.assert_allclose(
        deviations @ deviations.T, 4.0 * COVARIANCE + np.diag([4e-10, 0.0]), rtol=1e-9, atol=1e-18
    )


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"noise": np.ones((6, 3))}, r"noise: expected shape \(6, 2\)"),
        ({"of_flight": np.ones(1)}, r"of_flight: expected shape \(2,\)"),
        ({"left": np.zeros((6, 2))}, "noise without a variance"),
        ({"differ": -np.ones(6)}, "a negative standard deviation"),
        ({"covariance": np.triu(COVARIANCE)}, "covariance: not one of any numbers"),
        ({"covariance": COVARIANCE * [[1.0, 9.0], [9.0, 1.0]]}, "covariance: not one of any numbers"),
    ],
)
def test_arrays_that_no_flights_leave_are_refused(
    sound: SoundFlights, damage: dict[str, Any], message: str
) -> None:
    with pytest.raises(ModelError, match=f"^sound flights: {message}$"):
        SoundFlights.stored(sound.to_json(), {**sound.arrays(), **damage})
