# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The small model nearest to an identified one: the truth of the simulated Bebop 2 within its intervals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.inputs import MEASURED
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.models.small_model import THRUST, SmallModel, errors_by_flight, headlines, small_model
from quadpi_core.paths import bags_directory
from quadpi_core.simulation.flying import load_aerodynamics
from quadpi_core.vehicle import Vehicle

GOLDEN = Path(__file__).parents[2] / "golden" / "model"


@pytest.fixture(scope="module")
def found(physical_folder: Path) -> SmallModel:
    model = AerodynamicModel.load(physical_folder)
    # In air that is known: else the interval of thrust is that of the air.
    model = replace(model, flights=tuple(replace(flight, air=MEASURED) for flight in model.flights))
    return small_model(model, model.load_vehicle())


def test_thrust_torque_and_inertia_hold_the_truth(found: SmallModel) -> None:
    truth = load_aerodynamics("bebop2")
    vehicle, hover = truth.vehicle, found.hover_speed.value
    # Of a vehicle that moves by 0.5 m/s any way: at rest the law of the simulation has a kink, 4 % high.
    velocity = np.vstack([0.5 * np.eye(3), -0.5 * np.eye(3)])
    force = truth.wrench(velocity, np.zeros((6, 3)), np.full((6, 4), hover))[:, 2].mean()
    assert found.thrust.low < -force / (4.0 * hover**2) < found.thrust.high
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    assert hover == pytest.approx(np.sqrt(weight / (4.0 * found.thrust.value)))
    assert found.thrust.half_width < 0.1 * found.thrust.value
    assert found.torque.value == pytest.approx(0.0113, rel=0.05)
    for axis in (0, 1):
        assert found.inertia[axis].low < vehicle.inertia[axis, axis] < found.inertia[axis].high
    assert found.inertia[2].low is None
    assert "vehicle file" in found.inertia[2].reason


def test_drag_is_that_of_steady_flight_over_the_speeds_flown(found: SmallModel) -> None:
    """The best momentum drag, and ballistic coefficients, of the simulation itself at these speeds."""
    truth = load_aerodynamics("bebop2")
    reached = [float(word) for word in found.momentum.reason.replace("m/s", " ").split() if word[0].isdigit()]
    weight, rows, drags = truth.vehicle.mass_kg * truth.vehicle.gravity_m_s2, [], []
    for axis, most in enumerate(reached):
        for speed in most * np.array([0.25, 0.5, 0.75, 1.0]):
            tilt, speeds = 0.0, np.full((2, 4), truth.hover_rotor_speed)
            for _ in range(5):
                velocity = np.zeros((2, 3))
                velocity[:, axis] = np.array([-speed, speed]) * np.cos(tilt)
                velocity[:, 2] = -speed * np.sin(tilt)
                force = truth.wrench(velocity, np.zeros((2, 3)), speeds)
                drag = 0.5 * (force[0, axis] - force[1, axis])
                tilt = np.arcsin(drag / weight)
                speeds *= np.sqrt(weight * np.cos(tilt) / -force[:, 2:3])
            along = velocity[1, axis]
            rows.append([along, *(0.5 * 1.225 * along**2 * (np.arange(2) == axis))])
            drags.append(drag / truth.vehicle.mass_kg)
    known = [axis for axis in (0, 1) if found.ballistic[axis].value is not None]
    best = np.linalg.lstsq(
        np.array(rows)[:, [0, *(1 + axis for axis in known)]], np.array(drags), rcond=None
    )[0]
    assert found.momentum.low < best[0] < found.momentum.high
    assert found.momentum.half_width < 0.3 * found.momentum.value
    for axis, square in zip(known, best[1:], strict=True):
        assert found.ballistic[axis].low < 1.0 / square < found.ballistic[axis].high


def test_flights_that_are_slow_tell_no_drag(physical_folder: Path) -> None:
    model = AerodynamicModel.load(physical_folder)
    slow = replace(model.envelope, lower=0.1 * model.envelope.lower, upper=0.1 * model.envelope.upper)
    found = small_model(replace(model, envelope=slow), model.load_vehicle())
    assert found.momentum.value is None
    assert "flights to and fro reach" in found.momentum.reason


def test_a_model_without_standard_errors_gives_no_numbers() -> None:
    model = AerodynamicModel.load(GOLDEN)
    found = small_model(model, model.load_vehicle())
    for one in (found.thrust, found.torque, found.hover_speed, found.momentum, *found.ballistic):
        assert one.value is None
        assert one.reason.startswith("not identified: ")


def test_what_flights_differ_by_widens_what_a_covariance_says(physical_folder: Path) -> None:
    model = AerodynamicModel.load(physical_folder)
    vehicle = model.load_vehicle()
    assert model.by_flight["momentum drag"] > 0.0
    assert set(model.by_flight) > {
        line.quantity for line in headlines(model, vehicle) if line.error is not None
    }
    alone, apart = (
        small_model(replace(model, by_flight=errors), vehicle)
        for errors in ({}, {THRUST: 1.0, "momentum drag": 0.04})
    )
    assert apart.thrust.half_width > alone.thrust.half_width
    assert apart.momentum.half_width == pytest.approx(1.96 * 0.04, rel=0.5)
    assert apart.torque == alone.torque
    for line in headlines(model, vehicle):
        assert line.error is None or line.error >= model.by_flight[line.quantity]


def test_leaving_out_flights_that_agree_adds_nothing(physical_folder: Path) -> None:
    model = AerodynamicModel.load(physical_folder)
    vehicle = model.load_vehicle()
    same = replace(model, left_out=(model.fitted,) * 4)
    assert max(errors_by_flight(same, vehicle).values()) < 1e-9
    assert errors_by_flight(replace(model, left_out=(model.fitted,) * 2), vehicle) == {}


# What matters first of a model: right for the simulated Bebop 2, whatever its vehicle file says of it.


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
