# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest
import yaml

from quadpi_core.errors import SimulationError, VehicleError
from quadpi_core.paths import config_directory
from quadpi_core.rotations import rotate_body_to_world, rotate_world_to_body, rotation_matrix
from quadpi_core.signals.wrench import newton_euler
from quadpi_core.simulation.applied_effects import effect_wrench
from quadpi_core.simulation.effect_registry import EFFECTS, read_effects
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight, trim
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.truth import LOG_HZ, STEP_HZ, Reference

STATION = np.array([0.0, 0.0, -3.0])
VEHICLES = ("bebop2", "hdbeetle")
POSITION_GAIN = 5.0


def swing(amplitude, frequency, seconds=12.0, turns=0.4):
    """Sines along three axes (m, Hz) that grow for 4 s, with slow turns of the nose."""
    time = np.arange(int(seconds * STEP_HZ) + 1) / STEP_HZ
    growth = np.clip(time / 4.0, 0.0, 1.0)
    growth = growth**3 * (10.0 - 15.0 * growth + 6.0 * growth**2)
    position = growth[:, None] * amplitude * np.sin(2.0 * np.pi * np.multiply.outer(time, frequency))
    velocity = np.gradient(position, 1.0 / STEP_HZ, axis=0)
    yaw = turns * growth * np.sin(2.0 * np.pi * 0.2 * time)
    return Reference(
        position=STATION + position,
        velocity=velocity,
        acceleration=np.gradient(velocity, 1.0 / STEP_HZ, axis=0),
        yaw=yaw,
        yaw_rate=np.gradient(yaw, 1.0 / STEP_HZ),
        tilt=np.zeros((len(time), 2)),
        thrust=np.zeros(len(time)),
    )


COUPLED = swing([2.0, 1.5, 0.6], [0.3, 0.23, 0.35])


@pytest.mark.parametrize("name", ["none", *EFFECTS])
def test_logged_instants_obey_newton_and_euler(name):
    effects = {} if name == "none" else read_effects({name: None}, "test")
    vehicle = SimulatedVehicle.load("bebop2")
    truth = simulate_flight("swing", vehicle, COUPLED, effects=effects, seed=3)
    weight = truth.vehicle.mass_kg * truth.vehicle.gravity_m_s2 * np.array([0.0, 0.0, 1.0])
    force = rotate_body_to_world(truth.attitude, truth.wrench[:, :3]) + weight
    assert np.abs(truth.vehicle.mass_kg * truth.acceleration - force).max() < 1e-12
    inertia = truth.vehicle.inertia
    moment = newton_euler(
        truth.specific_force, truth.rates, truth.angular_acceleration, truth.vehicle.mass_kg, inertia
    )[:, 3:]
    assert np.abs(moment - truth.wrench[:, 3:]).max() < 1e-12
    assert np.abs(np.linalg.norm(truth.attitude, axis=1) - 1.0).max() < 1e-12


def test_wrench_without_effects_is_that_of_the_model():
    vehicle = SimulatedVehicle.load("bebop2")
    truth = simulate_flight("swing", vehicle, COUPLED)
    wrench = vehicle.aerodynamics.wrench(truth.velocity, truth.rates, truth.rotor_speeds)
    np.testing.assert_allclose(truth.wrench, wrench, rtol=1e-11, atol=1e-13)


def derivative(values):
    """Central differences of eighth order over the log, without four samples at either end."""
    weights = np.array([1 / 280, -4 / 105, 1 / 5, -4 / 5, 0.0, 4 / 5, -1 / 5, 4 / 105, -1 / 280])
    count = len(values) - 8
    return LOG_HZ * sum(w * values[i : i + count] for i, w in enumerate(weights))


def test_logged_derivatives_are_those_of_the_logged_states():
    """Commands change every step, so that accelerations have corners: bounds, not machine precision."""
    truth = simulate_flight("swing", SimulatedVehicle.load("bebop2"), COUPLED)
    world = rotate_body_to_world(truth.attitude, truth.velocity)
    rotation = rotation_matrix(truth.attitude)
    turning = np.einsum("nji,njk->nik", rotation[4:-4], derivative(rotation))
    for differences, logged, bound in (
        (derivative(truth.position), world, 1e-8),
        (derivative(world), truth.acceleration, 1e-4),
        (np.stack((turning[:, 2, 1], turning[:, 0, 2], turning[:, 1, 0]), axis=1), truth.rates, 1e-4),
        (derivative(truth.rates), truth.angular_acceleration, 0.1),
    ):
        # The reference ends in a corner.
        assert np.abs(differences - logged[4:-4])[:-20].max() < bound


def test_motors_are_first_order_within_their_limits():
    vehicle = SimulatedVehicle.load("bebop2")
    truth = simulate_flight("swing", vehicle, COUPLED)
    command = truth.rotor_speeds + vehicle.motor_time_constant * truth.rotor_accelerations
    assert command.min() > -1e-9
    assert command.max() < vehicle.vehicle.rotor_speed_max_rad_s + 1e-9


@pytest.mark.parametrize("name", VEHICLES)
def test_tracks_sines_up_to_fourteen_metres_per_second(name):
    truth = simulate_flight(
        "dash", SimulatedVehicle.load(name), swing([20.0, 0.0, 0.0], [0.11, 0.1, 0.1], 20.0, 0.0)
    )
    assert np.linalg.norm(truth.velocity, axis=1).max() > 13.5
    assert np.sqrt(np.mean(truth.position_error**2)) < 0.5
    coupled = simulate_flight("coupled", SimulatedVehicle.load(name), COUPLED)
    assert np.sqrt(np.mean(coupled.position_error**2)) < 0.1


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


def test_excitation_on_top_of_the_controller_shows_in_pitch_and_thrust():
    vehicle = SimulatedVehicle.load("hdbeetle")
    calm = Reference.hover(STATION, 2001)
    pulse = np.zeros(2001)
    pulse[500:650] = 1.0
    pitched = simulate_flight("pitch", vehicle, replace(calm, tilt=np.outer(pulse, [0.0, 0.3])))
    assert pitched.rates[:, 1].max() > 1.0
    assert np.abs(pitched.rates[:, 0]).max() < 0.2
    pushed = simulate_flight("thrust", vehicle, replace(calm, thrust=0.3 * pulse))
    weight = vehicle.vehicle.mass_kg * vehicle.vehicle.gravity_m_s2
    assert pushed.wrench[:, 2].min() < -1.2 * weight


def test_same_seed_same_flight_other_seed_other_gusts():
    vehicle = SimulatedVehicle.load("bebop2")
    gust = read_effects({"gust": None}, "test")
    flights = [simulate_flight("gust", vehicle, COUPLED, effects=gust, seed=seed) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(flights[0].wrench, flights[1].wrench)
    assert np.abs(flights[0].wrench - flights[2].wrench).max() > 0.01
    np.testing.assert_array_equal(flights[0].wind, flights[1].wind)


def test_effects_come_as_a_surprise_to_the_controller():
    """It knows the nominal mass: with a payload the vehicle sags until the position gain compensates."""
    vehicle = SimulatedVehicle.load("bebop2")
    loaded = simulate_flight(
        "loaded", vehicle, COUPLED, effects=read_effects({"payload": {"mass_kg": 0.05}}, "test")
    )
    assert loaded.vehicle.mass_kg == pytest.approx(vehicle.vehicle.mass_kg + 0.05)
    bare = simulate_flight("bare", vehicle, COUPLED)
    assert loaded.rotor_speeds.mean() > bare.rotor_speeds.mean() + 20.0
    sag = (loaded.position - loaded.reference.position)[len(loaded) // 4 :, 2].mean()
    missing = vehicle.vehicle.gravity_m_s2 * 0.05 / vehicle.vehicle.mass_kg
    assert sag == pytest.approx(missing / POSITION_GAIN, rel=0.15)
    assert bare.position_error.max() < 0.3 * sag


@pytest.mark.parametrize("name", [effect.name for effect in EFFECTS.values() if effect.kind == "wrench"])
def test_an_effect_adds_in_flight_what_it_adds_on_the_recorded_states(name):
    """Whatever else is switched on: its parameters mean the same under a payload."""
    vehicle = SimulatedVehicle.load("bebop2")
    effects = read_effects({name: None, "payload": None}, "test")
    truth = simulate_flight("swing", vehicle, COUPLED, effects=effects)
    states = vehicle.aerodynamics.states(
        truth.velocity,
        truth.rates,
        truth.rotor_speeds,
        rotor_accelerations=truth.rotor_accelerations,
        position=truth.position,
        attitude=truth.attitude,
    )
    added = effect_wrench(name, effects[name], states, vehicle.record())
    np.testing.assert_allclose(truth.wrench, states["wrench"] + added, rtol=1e-10, atol=1e-12)


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


def test_truth_as_a_flight_measures_its_own_wrench():
    truth = simulate_flight("swing", SimulatedVehicle.load("bebop2"), COUPLED)
    flight = truth.flight()
    vehicle = truth.vehicle
    measured = newton_euler(
        flight.specific_force, flight.rates, flight.angular_acceleration, vehicle.mass_kg, vehicle.inertia
    )
    np.testing.assert_allclose(measured, truth.wrench, atol=1e-12)


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
