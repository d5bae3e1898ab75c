# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations by a function and by an identified model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy import CallableSimulation, load_simulation
from quadpi_core.discrepancy.simulations import airspeed
from quadpi_core.errors import DiscrepancyError, QuadpiError
from quadpi_core.estimator.fusion import fuse_airborne
from quadpi_core.flight import AXES
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.models.candidate_pool import load_pools
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.parallel import Workers
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.vehicle import Vehicle


def thrust_only(flight):
    wrench = np.zeros((len(flight), 6))
    wrench[:, 2] = -1.9e-6 * np.square(flight.rotor_speeds).sum(axis=1)
    return wrench


def test_a_function_of_the_working_directory(tmp_path, monkeypatch, flight):
    (tmp_path / "my_simulation.py").write_text(
        "import numpy as np\n"
        "def wrench(flight):\n"
        "    found = np.zeros((len(flight), 6))\n"
        "    found[:, 2] = -1.9e-6 * np.square(flight.rotor_speeds).sum(axis=1)\n"
        "    return found\n"
    )
    monkeypatch.chdir(tmp_path)
    simulation = load_simulation("my_simulation:wrench", "bebop2")
    assert np.array_equal(simulation.wrench(flight), thrust_only(flight))
    weight = simulation.vehicle.mass_kg * simulation.vehicle.gravity_m_s2
    assert simulation.hover_rotor_speed == pytest.approx(np.sqrt(weight / (4 * 1.9e-6)))
    thrusts, torques = simulation.thrusts(flight)
    np.testing.assert_allclose(thrusts, 1.9e-6 * np.square(flight.rotor_speeds))
    assert np.all(torques == 0.0)


def raising(flight):
    raise ValueError(f"{len(flight)} samples are too many")


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (raising, r"raised ValueError for flight \w+: \d+ samples are too many"),
        (
            lambda flight: np.zeros((len(flight), 5)),
            r"expected a wrench of shape \(\d+, 6\), found \(\d+, 5\)",
        ),
        (lambda flight: np.full((len(flight), 6), np.nan), "sample 0: not finite"),
        (lambda _: "lift", "raised ValueError"),
    ],
)
def test_functions_that_give_no_wrench(function, message, flight):
    simulation = CallableSimulation("mine:f", Vehicle.load("bebop2"), function)
    with pytest.raises(DiscrepancyError, match=message) as caught:
        simulation.wrench(flight)
    assert "\n" not in str(caught.value)


# --- What may be wrong of a function


THRUST, TORQUE, DAMPING, DRAG, LIFT, AIRFRAME = 1.9e-6, 2e-8, 3e-3, 1e-4, 5e-2, 2e-2


def known_parts(flight):
    """Wrench (N, 6) of one law of each order and parity, by the name of the part that it is."""
    velocity, squares = airspeed(flight), np.square(flight.rotor_speeds)
    parts = {name: np.zeros((len(flight), 6)) for name in PARTS}
    parts["rotors"][:, 2] = -THRUST * squares.sum(axis=1)
    parts["rotors"][:, 5] = TORQUE * squares @ [1.0, -1.0, 1.0, -1.0]
    parts["rates"][:, 3:5] = -DAMPING * flight.rates[:, :2]
    parts["airspeed"][:, :2] = -DRAG * flight.rotor_speeds.mean(axis=1)[:, None] * velocity[:, :2]
    parts["airspeed, even"][:, 2] = -LIFT * np.square(velocity[:, :2]).sum(axis=1)
    parts["airspeed, even"][:, 5] = 1e-3 * flight.rates[:, 2] * velocity[:, 0]
    parts["airspeed, squared"][:, :3] = -AIRFRAME * np.linalg.norm(velocity, axis=1)[:, None] * velocity
    return parts


PARTS = ("rotors", "rates", "airspeed", "airspeed, even", "airspeed, squared")


def of_known_parts(flight):
    return np.sum(list(known_parts(flight).values()), axis=0)


@pytest.fixture
def known():
    return CallableSimulation("known", Vehicle.load("bebop2"), of_known_parts)


@pytest.fixture(params=[0.0, 3.0], ids=["calm", "windy"])
def blown(request, flight):
    return replace(flight, wind=flight.wind + request.param * np.array([1.0, -0.5, 0.0]))


def test_laws_of_each_order_and_parity_are_parts_by_themselves(known, blown):
    tolerances, parts = known.tolerances, known_parts(blown)
    columns = {column.name: column.wrench for column in known.uncertain(blown)}
    for name, wrench in parts.items():
        for axis, values in enumerate(wrench.T):
            share = tolerances.coefficient * (1.0 if name == "rotors" else np.sqrt(0.5))
            if (name, AXES[axis]) in {("rotors", own) for own in ("Fz", "Mx", "My")}:
                share = tolerances.thrust
            expected = np.zeros_like(wrench)
            expected[:, axis] = share * values
            found = columns.pop(f"{AXES[axis]} of {name}")
            np.testing.assert_allclose(found, expected, atol=1e-12, err_msg=f"{AXES[axis]} of {name}")
    shared = tolerances.coefficient * np.sqrt(0.5)
    for axes, kept in (("Fz, Mx and My", [2, 3, 4]), ("Fx, Fy and Mz", [0, 1, 5])):
        for law, whole in {
            "the motion": parts["rates"] + parts["airspeed"],
            "airspeed, even": parts["airspeed, even"],
            "airspeed, squared": parts["airspeed, squared"],
        }.items():
            found = columns.pop(f"{axes} of {law}")
            np.testing.assert_allclose(found[:, kept], shared * whole[:, kept], atol=1e-12)
            assert not np.delete(found, kept, axis=1).any()
    assert not columns


def test_parts_add_up_to_the_wrench_whatever_its_order(blown):
    """A cubic law is shared between the orders that are told apart."""

    def cubic(flight):
        return np.hstack((airspeed(flight) ** 3, flight.rates**3 * airspeed(flight)))

    simulation = CallableSimulation("cubic", Vehicle.load("bebop2"), cubic)
    columns = {column.name: column.wrench for column in simulation.uncertain(blown)}
    share = simulation.tolerances.coefficient * np.sqrt(0.5)
    whole = sum(columns[f"{axis} of {part}"] for axis in AXES for part in PARTS[1:])
    np.testing.assert_allclose(whole / share, cubic(blown), atol=1e-9)


def test_a_flight_that_stands_still_in_the_air_has_the_same_columns(known, flight):
    none = np.zeros_like(flight.velocity)
    hover = replace(flight, velocity=none, wind=none, rates=none)
    names = [[(column.name, column.law) for column in known.uncertain(own)] for own in (flight, hover)]
    assert names[0] == names[1]
    assert len(set(names[0])) == 36


# --- An identified model


@pytest.fixture(scope="module")
def model(bags, tmp_path_factory):
    vehicle = Vehicle.load("neurobem")
    pools = load_pools("quadrotor")
    flights = prepare_flights(bags, vehicle, 30.0, workers=Workers(1))
    folder = tmp_path_factory.mktemp("models") / "model"
    identify(flights, vehicle, pools, IdentifyOptions(method="polynomial", cutoff_hz=30.0)).save(folder)
    return folder


def test_a_model_predicts_and_keeps_its_intervals(model, bags):
    simulation = load_simulation(str(model))
    vehicle = Vehicle.load("neurobem")
    flight = fuse_airborne(read_recording(bags[0], vehicle), vehicle, 30.0)
    wrench, (lower, upper) = simulation.wrench(flight), simulation.intervals(flight)
    assert np.all((lower < wrench) & (wrench < upper))
    # Of a flight that it was identified on, it explains most.
    measured = measured_wrench(flight, vehicle)
    assert np.std(measured - wrench, axis=0)[2] < 0.3 * np.std(measured, axis=0)[2]
    assert 500.0 < simulation.hover_rotor_speed < 2000.0


def test_what_the_airspeed_adds_to_a_model_is_one_part(model, bags):
    """A model that was fitted to flights says nothing of their motion reversed."""
    simulation, vehicle = load_simulation(str(model)), Vehicle.load("neurobem")
    flight = fuse_airborne(read_recording(bags[0], vehicle), vehicle, 30.0)
    columns = {column.name: column.wrench for column in simulation.uncertain(flight)}
    assert {name.partition(" of ")[2] for name in columns} == {"rotors", "rates", "airspeed", "the motion"}
    share = simulation.tolerances.coefficient * np.sqrt(0.5)
    calm = replace(flight, velocity=0.0 * flight.velocity, wind=0.0 * flight.wind)
    added = sum(columns[f"{axis} of airspeed"] for axis in AXES) / share
    np.testing.assert_allclose(added, simulation.wrench(flight) - simulation.wrench(calm), atol=1e-9)


def test_a_model_of_another_vehicle(model):
    with pytest.raises(QuadpiError, match="is of vehicle neurobem, not bebop2"):
        load_simulation(str(model), "bebop2")


def test_samples_that_a_model_cannot_judge_are_left_out_and_counted(model, bags):
    simulation, vehicle = load_simulation(str(model)), Vehicle.load("neurobem")
    flight = fuse_airborne(read_recording(bags[0], vehicle), vehicle, 30.0)
    whole = simulation.wrench(flight)

    def gappy(share):
        def predict(asked):
            wrench = whole.copy()
            wrench[: int(share * len(asked))] = np.nan
            return wrench

        return replace(simulation, function=predict)

    few = gappy(0.01)
    assert few.unjudged(flight) == int(0.01 * len(flight))
    left = few.wrench(flight)
    assert np.all(np.isfinite(left))
    np.testing.assert_array_equal(left[few.unjudged(flight) :], whole[few.unjudged(flight) :])
    with pytest.raises(DiscrepancyError, match=r"no finite wrench for 6% of it, first for sample 0"):
        gappy(0.06).wrench(flight)
