# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.models.fitted_physical import FittedPhysical, PhysicalFit
from quadpi_core.models.physical_terms import TERMS, physical_vehicle
from test.core.models.physical_flights import (
    REFERENCE,
    VEHICLE,
    derivatives_of,
    fitted_physical,
    inputs_of,
    swept,
)


def test_the_prediction_is_that_of_the_terms() -> None:
    flight = swept(1.0, 0, delay_s=0.005, noise=0.0)
    fitted = fitted_physical(*AXES, delay_s=0.005, rotor_inertia_spin=1e-6)
    result = fitted.evaluate(inputs_of(flight), np.ones(6), derivatives_of(flight))
    scale = np.std(flight.wrench, axis=0)
    assert np.all(np.abs(result.predicted - flight.wrench).max(axis=0) < 0.1 * scale)
    assert np.all(result.leverage > 0.0)
    np.testing.assert_allclose(result.upper - result.predicted, result.predicted - result.lower, rtol=1e-9)


def test_a_sample_has_the_same_bits_alone_and_in_a_block() -> None:
    flight = swept(1.0, 0)
    fitted = fitted_physical(*AXES)
    inputs, derivatives = inputs_of(flight), derivatives_of(flight)
    block = fitted.evaluate(inputs, np.ones(6), derivatives)
    for k in (0, 17, 99):
        alone = fitted.evaluate(inputs[k : k + 1], np.ones(6), derivatives[k : k + 1])
        for whole, one in zip(block, alone, strict=True):
            np.testing.assert_array_equal(whole[k], one[0])


def test_an_accelerometer_off_the_centre_feels_the_angular_acceleration() -> None:
    flight = swept(1.0, 0)
    inputs, derivatives = inputs_of(flight), derivatives_of(flight)
    here, there = (fitted_physical("Fz", imu_x=x) for x in (0.0, 0.02))
    change = (
        there.evaluate(inputs, np.ones(6), derivatives).predicted
        - here.evaluate(inputs, np.ones(6), derivatives).predicted
    )[:, 2]
    p, _, r = flight.motion["rates"].T
    expected = 0.02 * VEHICLE.mass_kg * (p * r - flight.motion["angular_acceleration"][:, 1])
    np.testing.assert_allclose(change, expected, atol=1e-9)
    with pytest.raises(ModelError, match="derivatives"):
        here.evaluate(inputs, np.ones(6))


def test_what_was_stored_is_read() -> None:
    own = fitted_physical("Fz")
    read = FittedPhysical.read(own.store())
    fit = read.parameters
    np.testing.assert_array_equal(fit.values, own.parameters.values)
    assert read.axes["Fz"].to_json() == own.axes["Fz"].to_json()
    assert (fit.sensing, fit.notes, fit.log) == (
        own.parameters.sensing,
        own.parameters.notes,
        own.parameters.log,
    )


def _vehicle(**changed: Any) -> dict[str, Any]:
    record = physical_vehicle(VEHICLE, REFERENCE)
    for name, value in changed.items():
        record[name] = value
    names = ("mass", "reference_thrust", "disc", "positions", "spins")
    return {"vehicle": np.concatenate([record[name].ravel() for name in names])}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ({"vehicle": np.zeros(3)}, "vehicle of shape"),
        ({"values": np.zeros(3)}, "values of shape"),
        ({"covariance": -np.eye(len(TERMS))}, "covariance: a negative variance"),
        ({"inertia": -np.eye(3)}, "inertia: not that of a body"),
        ({"inertia": np.eye(3) + np.eye(3, k=1)}, "inertia: not that of a body"),
        (_vehicle(mass=0.0), "vehicle: mass must be positive, is 0"),
        (_vehicle(disc=-1.0), "vehicle: disc must be positive"),
        (_vehicle(reference_thrust=0.0), "vehicle: reference_thrust must be positive"),
        (_vehicle(spins=[2.0, -2.0, 2.0, -2.0]), "a rotor in each quadrant"),
        (_vehicle(positions=np.ones((4, 3))), "a rotor in each quadrant"),
    ],
)
def test_arrays_that_no_fit_gives_are_refused(damage: dict[str, Any], message: str) -> None:
    fit = fitted_physical("Fz").parameters
    with pytest.raises(ModelError, match=message):
        PhysicalFit.stored(fit.to_json(), {**fit.arrays(), **damage})


def test_an_axis_of_another_version_or_shape_is_refused() -> None:
    stored = fitted_physical("Fz").store()
    entries = {"Fz": {**stored.entries["Fz"], "acting": ["warp"]}}
    with pytest.raises(ModelError, match="Fz: parameter 'warp' is not known to this version"):
        FittedPhysical.read(replace(stored, entries=entries))
    with pytest.raises(ModelError, match="Fz: whitening of shape"):
        FittedPhysical.read(replace(stored, arrays={**stored.arrays, "Fz.whitening": np.zeros(3)}))
    assert stored.arrays["vehicle"].shape == (19,)
