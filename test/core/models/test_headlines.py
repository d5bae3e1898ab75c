# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What matters first of a model: right for the simulated Bebop 2, whatever its vehicle file says of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.models.small_model import headlines
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

TRUE_INERTIA = (0.00144760672, 0.00125537459)


def test_a_physical_model_tells_them_with_standard_errors(physical_folder: Path) -> None:
    model = AerodynamicModel.load(physical_folder)
    found = {one.quantity: one for one in headlines(model, model.load_vehicle())}
    assert len(found) <= 10
    for axis, inertia in zip("xy", TRUE_INERTIA, strict=True):
        own = found[f"inertia {axis}, by arms and thrust"]
        assert own.known == pytest.approx(inertia)
        # By leaving out each of four flights, which are few: 55 % of the value.
        assert abs(own.value - inertia) < 3.0 * own.error < 0.8 * inertia
        place = found[f"middle of thrust from CG, {axis}"]
        assert place.known == pytest.approx(0.0)
        assert abs(place.value) < 3.0 * place.error < 1.0
        # Rotor-plane force and drag of the simulation, N s/m, for all four rotors in hover.
        assert found[f"drag near hover, {axis}"].value == pytest.approx(0.118, rel=0.05)
    thrust = found["thrust coefficient C_T, hover"]
    assert thrust.known == 0.0156
    assert thrust.value == pytest.approx(0.0156, rel=0.05)
    assert found["torque over thrust of a rotor"].value == pytest.approx(11.3, rel=0.05)
    assert found["delay of the rotor speeds"].value == 0.0


@pytest.mark.slow
def test_any_kind_tells_the_inertia_that_a_vehicle_file_has_wrong() -> None:
    """And gives no number for what it was not flown near, or does not hold."""
    vehicle = Vehicle.load("bebop2")
    wrong = replace(vehicle, inertia=1.3 * vehicle.inertia)
    flights = prepare_flights([bags_directory() / f"train_{k}.mcap" for k in (1, 2, 3, 4)], wrong)
    options = IdentifyOptions(method="polynomial")
    model = identify(flights, wrong, load_pools("quadrotor"), options)
    found = {one.quantity: one for one in headlines(model, wrong)}
    for axis, inertia in zip("xy", TRUE_INERTIA, strict=True):
        own = found[f"inertia {axis}, by arms and thrust"]
        assert (own.known, own.error) == (pytest.approx(1.3 * inertia), None)
        assert own.value == pytest.approx(inertia, rel=0.05)
    forces = replace(model, fitted=replace(model.fitted, axes={"Fx": model.fitted.axes["Fx"]}))
    assert [one.quantity for one in headlines(forces, wrong)] == ["drag near hover, x"]
    elsewhere = replace(
        model.envelope, lower=model.envelope.lower + 100.0, upper=model.envelope.upper + 100.0
    )
    assert headlines(replace(model, envelope=elsewhere), wrong) == []
