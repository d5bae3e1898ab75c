# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of a simulated vehicle: trim, start, repeatability, and how they fail."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
import yaml

from quadpi_core.errors import OutputError, SimulationError, VehicleError
from quadpi_core.frames import rotate_body_to_world, rotate_world_to_body
from quadpi_core.parallel import Progress, Workers
from quadpi_core.paths import config_directory
from quadpi_core.simulation.applied_effects import EFFECTS, read_effects
from quadpi_core.simulation.flying import LAWS, SimulatedVehicle, load_aerodynamics, simulate_flight, trim
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.simulated_aerodynamics import PhysicalAerodynamics
from quadpi_core.simulation.simulated_bags import simulate
from quadpi_core.simulation.simulated_file import vehicle_content
from quadpi_core.simulation.truth import STEP_HZ, Reference

from .references import COUPLED, STATION

VEHICLES = ("bebop2", "hdbeetle")


@pytest.mark.parametrize("name", VEHICLES)
@pytest.mark.parametrize("speed", [0.0, 5.0, 8.0, 10.0, 14.0])
def test_holds_station_in_the_wind_tunnel(name, speed):
    wind = np.array([-speed, 0.0, 0.0])
    vehicle = SimulatedVehicle.load(name)
    truth = simulate_flight("tunnel", vehicle, Reference.hover(STATION, 5001), known_wind=wind)
    assert truth.position_error.max() < 1e-3
    assert truth.speed == pytest.approx(np.full(len(truth), speed), abs=1e-2)
    np.testing.assert_array_equal(truth.known_wind, np.tile(wind, (len(truth), 1)))


@pytest.mark.parametrize("name", VEHICLES)
def test_trim_balances_the_weight(name):
    model = SimulatedVehicle.load(name).aerodynamics
    wind = np.array([-7.0, 3.0, 1.0])
    for yaw in (0.0, 2.0):
        state = trim(model, wind, yaw)
        velocity = rotate_world_to_body(state.attitude, -wind)[None]
        wrench = model.wrench(velocity, np.zeros((1, 3)), state.rotor_speeds[None])
        weight = model.vehicle.mass_kg * model.vehicle.gravity_m_s2
        force = rotate_body_to_world(state.attitude, wrench[0, :3]) + np.array([0.0, 0.0, weight])
        np.testing.assert_allclose(force, 0.0, atol=1e-8)
        np.testing.assert_allclose(wrench[0, 3:], 0.0, atol=1e-8)


def test_trim_leans_into_the_wind_and_further_the_stronger_it_blows():
    model = SimulatedVehicle.load("bebop2").aerodynamics
    pitches = []
    for speed in (0.0, 5.0, 10.0, 14.0):
        w, x, y, z = trim(model, np.array([-speed, 0.0, 0.0])).attitude
        pitches.append(np.degrees(np.arcsin(2.0 * (w * y - z * x))))
    assert pitches[0] == pytest.approx(0.0, abs=1e-9)
    assert np.all(np.diff(pitches) < -3.0)


def test_no_trim_in_a_storm():
    model = SimulatedVehicle.load("bebop2").aerodynamics
    with pytest.raises(SimulationError, match=r"vehicle bebop2: .*stand still in a wind of 25\.0 m/s"):
        trim(model, np.array([-25.0, 0.0, 0.0]))


def test_starts_where_and_as_the_reference_says():
    reference = replace(Reference.hover(np.array([1.0, 2.0, -4.0]), 101), yaw=np.full(101, 1.2))
    truth = simulate_flight("start", SimulatedVehicle.load("bebop2"), reference)
    np.testing.assert_array_equal(truth.position[0], [1.0, 2.0, -4.0])
    nose = rotate_body_to_world(truth.attitude[0], np.array([1.0, 0.0, 0.0]))
    assert np.arctan2(nose[1], nose[0]) == pytest.approx(1.2)
    assert len(truth) == 51
    assert np.all(np.diff(truth.time_ns) == 2_000_000)


def test_hitting_the_ground_is_reported():
    low = Reference.hover(np.array([0.0, 0.0, -0.1]), 5001)
    heavy = read_effects({"payload": {"mass_kg": 0.1}}, "test")
    with pytest.raises(SimulationError, match=r"flight low: the vehicle hits the ground after \d\.\d+ s"):
        simulate_flight("low", SimulatedVehicle.load("bebop2"), low, effects=heavy)


def test_a_vehicle_that_cannot_turn_is_refused():
    vehicle = SimulatedVehicle.load("bebop2")
    straight = replace(vehicle.aerodynamics.coefficients, torque=np.zeros(16))
    no_yaw = replace(vehicle, aerodynamics=replace(vehicle.aerodynamics, coefficients=straight))
    with pytest.raises(SimulationError, match="vehicle bebop2: its rotors cannot turn it about every axis"):
        simulate_flight("hover", no_yaw, Reference.hover(STATION, 101))


def test_out_of_control_is_reported_with_time_and_state():
    vehicle = SimulatedVehicle.load("bebop2")
    broken = read_effects({"weak_rotor": {"loss": 0.9}}, "test")
    high = replace(COUPLED, position=COUPLED.position - [0.0, 0.0, 50.0])
    with pytest.raises(SimulationError) as error:
        simulate_flight("broken", vehicle, high, effects=broken)
    message = str(error.value)
    assert message.startswith("flight broken: the vehicle is out of control after ")
    assert "\n" not in message
    for word in ("tilt", "rates", "off its reference", "rotors"):
        assert word in message


def test_too_short_a_flight():
    with pytest.raises(SimulationError, match="flight short: lasts no longer than one sample"):
        simulate_flight("short", SimulatedVehicle.load("bebop2"), Reference.hover(STATION, 2))


@pytest.mark.parametrize("value", [0.0, -0.03, 2.0, "fast", True])
def test_impossible_motors(tmp_path, value):
    with pytest.raises(
        VehicleError,
        match=r"own\.yaml: simulation: `motor_time_constant_s` must be a number from 0.001 to 1, found",
    ):
        SimulatedVehicle.load(vehicle_file(tmp_path, motor_time_constant_s=value))


def test_unknown_key(tmp_path):
    message = r"own\.yaml: simulation: unknown key `motor_time_s`; .*did you mean `motor_time_constant_s`\?"
    with pytest.raises(VehicleError, match=message):
        SimulatedVehicle.load(vehicle_file(tmp_path, motor_time_s=0.03))


def test_missing_motors(tmp_path):
    with pytest.raises(VehicleError, match=r"own\.yaml: simulation: missing key `motor_time_constant_s`"):
        SimulatedVehicle.load(vehicle_file(tmp_path, motor_time_constant_s=None))


def vehicle_file(folder, **changes):
    data = yaml.safe_load((config_directory() / "vehicles" / "bebop2.yaml").read_text())
    data["simulation"] |= changes
    (folder / "own.yaml").write_text(yaml.safe_dump(data))
    return folder / "own.yaml"


def test_effects_of_the_vehicle_are_in_every_flight(tmp_path):
    """The same as switching them on for the flight; those of the flight count instead."""
    own = SimulatedVehicle.load(vehicle_file(tmp_path, effects={"payload": None, "gyro_bias": None}))
    plain = SimulatedVehicle.load("bebop2")
    plan = load_scenario("training").flights[0]
    reference = plan.reference(STEP_HZ)

    def fly(vehicle, **effects):
        return simulate_flight("test", vehicle, reference, effects=read_effects(effects, "test"), seed=1)

    assert np.array_equal(fly(own).position, fly(plain, payload=None).position)
    assert fly(own, payload={"mass_kg": 0.01}).vehicle.mass_kg == pytest.approx(plain.vehicle.mass_kg + 0.01)
    assert list(own.with_own({})) == ["payload", "gyro_bias"]


def test_an_effect_that_is_none(tmp_path):
    file = vehicle_file(tmp_path, effects={"rotor_darg": None})
    with pytest.raises(
        SimulationError, match=r"own\.yaml: simulation\.effects: unknown effect `rotor_darg`; did you mean"
    ):
        SimulatedVehicle.load(file)


def test_same_seed_same_flight_other_seed_other_gusts():
    vehicle = SimulatedVehicle.load("bebop2")
    gust = read_effects({"gust": None}, "test")
    flights = [simulate_flight("gust", vehicle, COUPLED, effects=gust, seed=seed) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(flights[0].wrench, flights[1].wrench)
    assert np.abs(flights[0].wrench - flights[2].wrench).max() > 0.01
    np.testing.assert_array_equal(flights[0].wind, flights[1].wind)


def test_the_law_is_the_one_that_the_file_holds(physical_folder):
    assert isinstance(load_aerodynamics("bebop2"), RotorLocalModel)
    assert isinstance(load_aerodynamics(physical_folder), PhysicalAerodynamics)


def test_two_laws_exclude_each_other(physical_folder, tmp_path):
    _, data = vehicle_content(physical_folder)
    data["simulation"]["rotor_local"] = {"scaled_from": "bebop2"}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(VehicleError, match=r"`simulation.rotor_local` and `simulation.physical` exclude"):
        load_aerodynamics(tmp_path / "own.yaml")


def test_every_law_reads_what_it_writes(physical_folder, tmp_path):
    for source, law in (("bebop2", LAWS[0]), (physical_folder, LAWS[1])):
        _, data = vehicle_content(source)
        data["simulation"][law.key] = law.load(source).to_section()
        file = tmp_path / f"{law.key}.yaml"
        file.write_text(yaml.safe_dump(data))
        assert law.load(file).to_section() == law.load(source).to_section()


# Simulated flights beyond those that a vehicle was identified on.


def fly(source, scenario, name, seconds=60.0):
    (plan,) = (plan for plan in load_scenario(scenario).flights if plan.name == name)
    whole = plan.reference(STEP_HZ)
    part = {column.name: getattr(whole, column.name)[: int(seconds * STEP_HZ)] for column in fields(whole)}
    return simulate_flight(name, SimulatedVehicle.load(source), replace(whole, **part), seed=1)


def test_a_flight_like_those_of_the_identification_is_inside(physical_folder):
    assert fly(physical_folder, "bundled", "train_2").excursion is None


def test_a_faster_one_says_where_it_went(physical_folder):
    found = fly(physical_folder, "dash", "dash", seconds=13.0).excursion
    assert 0.05 < found.share < 1.0
    assert not found.lower <= found.reached <= found.upper
    assert found.input in found.sentence()
    assert f"{found.share:.1%} of its time" in found.sentence()


def test_one_that_is_lost_says_that_it_was_outside(physical_folder):
    with pytest.raises(
        SimulationError, match=r"out of control .*; it was beyond the flights .*identified on"
    ):
        fly(physical_folder, "dash", "dash")


def test_a_vehicle_that_was_not_identified_has_no_range():
    assert fly("bebop2", "dash", "dash", seconds=13.0).excursion is None


HOVER = FlightPlan(name="hover", scenario="test", vehicle="bebop2", seed=1, duration_s=0.5)


def test_several_flights_at_a_time_with_effects_of_the_core_and_of_python(tmp_path, monkeypatch):
    monkeypatch.setitem(EFFECTS, "own", replace(EFFECTS["gyroscopic"], name="own"))
    hover = FlightPlan(name="one", scenario="test", vehicle="bebop2", seed=1, duration_s=0.5)
    effects = ({"gyroscopic": None}, {"own": None}) * 2
    plans = [hover.overridden(name=f"hover_{k}", effects=own) for k, own in enumerate(effects)]
    flights = simulate(plans, tmp_path / "bags", workers=Workers(4))
    for flight in flights:
        np.testing.assert_allclose(flight.truth.wrench, flights[0].truth.wrench, rtol=1e-12, atol=1e-15)
    assert len(list((tmp_path / "bags").iterdir())) == 4


def test_progress_is_reported_until_the_end(tmp_path):
    seen = []
    simulate([HOVER], tmp_path, workers=Workers(progress=seen.append))
    assert seen[-1] == Progress("Flying", 0.5, 0.5, "s", "1 of 1 flights")
    assert [progress.done for progress in seen] == sorted(progress.done for progress in seen)


def test_a_file_in_the_place_of_the_folder(tmp_path):
    (tmp_path / "bags").write_text("mine")
    with pytest.raises(OutputError, match=r"bags.* cannot be written: Not a directory"):
        simulate([HOVER], tmp_path / "bags")
    assert [path.name for path in tmp_path.iterdir()] == ["bags"]
    assert (tmp_path / "bags").read_text() == "mine"
