# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What an effect adds to the residual, whatever part of vehicle, air or sensors it changes."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.effect_response import (
    Compared,
    body_tolerances,
    predicted_flight,
    quiet,
    residual,
    share_of_wrench,
    without_sensor_effect,
)
from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.discrepancy.simulations import Tolerances, VehicleSimulation
from quadpi_core.inputs import flight_derivatives, flight_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.signals.chain import zero_phase
from quadpi_core.signals.wrench import band_limited, measured_wrench
from quadpi_core.simulation.applied_effects import EFFECTS, effect_wrench


@pytest.fixture(scope="module")
def flight(flights):
    """Four seconds."""
    return flights[0].slice(slice(500, 1000))


@pytest.fixture(scope="module")
def compared(flight, simulation):
    return Compared(flight, simulation)


def values(name, **parameters):
    return np.array([parameters.get(p.name, 0.0) for p in EFFECTS[name].parameters])


def test_a_force_that_acted_is_what_the_residual_gained(compared, flight, simulation, pushed):
    drag = {"x_n_s2_m2": 0.006, "y_n_s2_m2": 0.009, "z_n_s2_m2": 0.006}
    # Columns are made of signals without the noise that the residual holds.
    acted = effect_wrench("body_drag", drag, simulation.states(compared.quiet), simulation.record())
    gained = residual(pushed(flight, simulation.vehicle, acted), simulation) - residual(flight, simulation)
    added = compared.added(EFFECTS["body_drag"], values("body_drag", **drag))
    np.testing.assert_allclose(added, gained, atol=1e-9)


def test_a_start_is_estimated_once_for_the_same_motion_of_the_load(compared):
    load, strong = EFFECTS["slung_load"], np.array([0.05, 0.5, 0.1, 0.01])
    start = compared.started(load, strong)
    assert compared.started(load, strong * [2.0, 1.0, 1.0, 1.0]) is start
    assert compared.started(load, strong * [1.0, 1.0, 1.0, 2.0]) is start
    assert compared.started(load, strong * [1.0, 1.1, 1.0, 1.0]) is not start


BANDWIDTH_HZ = 8.0


@pytest.fixture(scope="module")
def limited(physical_folder, tmp_path_factory):
    """A model of flights whose specific force ended at 8 Hz, and the simulation that its folder is."""
    model = AerodynamicModel.load(physical_folder)
    parameters = model.fitted.parameters
    ending = replace(parameters, sensing=replace(parameters.sensing, force_bandwidth_hz=BANDWIDTH_HZ))
    fitted = replace(model.fitted, parameters=ending)
    folder = tmp_path_factory.mktemp("limited") / "model"
    model = replace(model, fitted=fitted, name="", identity="").save(folder)
    return model, VehicleSimulation.load(folder)


def test_forces_are_compared_smoothed_as_evaluate_does(limited, flight):
    model, simulation = limited
    inputs, moving = flight_inputs(flight, simulation.vehicle), flight_derivatives(flight)
    simulated = measured_wrench(flight, simulation.vehicle) - residual(flight, simulation)
    said = model.evaluate(SimpleNamespace(time=flight.time, inputs=inputs, derivatives=moving)).predicted
    plain = model.evaluate(inputs, derivatives=moving).predicted
    # The simulation has the place of the accelerometer, which the model has in its forces, as an effect.
    taken_off = said - plain
    assert np.abs(taken_off[:, :3]).max() > 1e-3
    np.testing.assert_allclose(
        simulated - simulation.wrench(flight), taken_off, atol=0.02 * np.abs(taken_off).max()
    )
    np.testing.assert_allclose(simulated[:, 3:], simulation.wrench(flight)[:, 3:], atol=1e-12)


def test_what_effects_and_tolerances_add_to_a_force_is_smoothed_alike(limited, flight):
    _, simulation = limited
    own = Compared(flight, simulation)
    free = Compared(flight, replace(simulation, model=without_bandwidth(simulation.model)))
    drag = values("body_drag", x_n_s2_m2=0.006)
    for added, whole in (
        (own.added(EFFECTS["body_drag"], drag), free.added(EFFECTS["body_drag"], drag)),
        (own.uncertain()[0].wrench, free.uncertain()[0].wrench),
        (own.added(*WINDY), free.added(*WINDY)),
    ):
        forces = band_limited(flight.time, flight.rates, whole[:, :3, np.newaxis], BANDWIDTH_HZ)[:, :, 0]
        taken_off = np.abs(whole[:, :3] - forces).max()
        assert taken_off > 1e-6
        # The quiet flight, which columns are made of, turns a little less than the flight.
        np.testing.assert_allclose(added[:, :3], forces, atol=0.05 * taken_off)
        np.testing.assert_allclose(added[:, 3:], whole[:, 3:], atol=1e-9)


WINDY = EFFECTS["wind"], np.array([2.0, -1.0, 0.0])


def without_bandwidth(model):
    return replace(model, coefficients=replace(model.coefficients, force_bandwidth_hz=None))


def test_a_mass_that_the_file_lacks_pulls_against_the_acceleration(compared, simulation):
    """Measured with the file's mass, the force of a heavier vehicle is too small by the payload's share."""
    added = compared.added(EFFECTS["payload"], values("payload", mass_kg=0.05))
    np.testing.assert_allclose(added[:, :3], -0.05 * compared.expected.specific_force, rtol=1e-9)
    np.testing.assert_allclose(added[:, 3:], 0.0, atol=1e-12)
    # With accelerations that the simulation predicts, not with their measured noise.
    force = simulation.vehicle.mass_kg * compared.expected.specific_force
    np.testing.assert_allclose(force, compared.quiet_wrench[:, :3], rtol=1e-9)


def test_a_share_of_the_wrench_is_what_mass_and_inertia_add_without_rates(flight, simulation):
    still = Compared(replace(flight, rates=np.zeros_like(flight.rates)), simulation)
    for name, changed in (
        ("payload", {"mass_kg": 0.05}),
        ("inertia", {"x_change": 0.1, "y_change": -0.2, "z_change": 0.3}),
    ):
        parameters = values(name, **changed)
        share = share_of_wrench(EFFECTS[name], simulation.vehicle, parameters)
        added = still.added(EFFECTS[name], parameters)
        np.testing.assert_allclose(added, still.expected_measured @ share.T, atol=1e-9)


def test_rotor_speeds_that_come_late_are_moved_back_with_their_noise(flight, simulation):
    """What the simulation should have had 40 ms earlier; constant at the end."""
    compared = Compared(noisy(flight, 0), simulation)
    added = compared.added(EFFECTS["sensor_delay"], values("sensor_delay", rotor_speeds_s=0.04))
    recorded, time = compared.flight, compared.flight.time
    earlier = np.stack([np.interp(time + 0.04, time, own) for own in recorded.rotor_speeds.T], axis=1)
    moved = simulation.wrench(replace(recorded, rotor_speeds=earlier))
    np.testing.assert_allclose(added, moved - simulation.wrench(recorded), atol=1e-6)


def test_a_constant_bias_of_the_accelerometer_is_what_the_estimator_takes_away(compared):
    """It adds nearly nothing to the residual, once the estimate of the bias has settled."""
    added = compared.added(EFFECTS["accelerometer_bias"], values("accelerometer_bias", x_m_s2=0.2))
    at_once = 0.2 * compared.simulation.vehicle.mass_kg
    assert np.abs(added[250:, 0]).max() < 0.2 * at_once


def test_predicted_accelerations_are_those_of_the_simulation_but_slow_turns_as_measured(flight, simulation):
    vehicle, said = simulation.vehicle, simulation.wrench(flight)
    predicted = predicted_flight(flight, vehicle, said)
    np.testing.assert_allclose(measured_wrench(predicted, vehicle)[:, :3], said[:, :3], atol=1e-9)
    constant = np.array([5.0, 0.0, -2.0])
    shifted = replace(flight, angular_acceleration=flight.angular_acceleration + constant)
    moved = predicted_flight(shifted, vehicle, said).angular_acceleration - predicted.angular_acceleration
    np.testing.assert_allclose(moved, np.tile(constant, (len(flight), 1)), atol=1e-9)


def test_tolerances_of_the_body_are_effects_with_their_deviation(simulation):
    wide = replace(simulation, tolerances=Tolerances(cg_m=0.002))
    found = {effect.name: deviation for effect, deviation in body_tolerances(wide)}
    assert found == {"rotor_thrusts": 0.01, "inertia": 0.02, "cg_offset": 0.002, "imu_lever_arm": 0.002}


def test_every_tolerance_is_a_column(compared):
    columns = compared.uncertain()
    names = [column.name for column in columns]
    assert len(set(names)) == len(names)
    assert {"inertia.x_change", "cg_offset.z_m", "rotor_thrusts.first_change"} <= set(names)
    one = columns[names.index("cg_offset.x_m")].wrench
    np.testing.assert_array_equal(one, compared.added(EFFECTS["cg_offset"], values("cg_offset", x_m=3e-4)))


def test_a_simulation_with_memory_sees_twice_the_samples_that_are_compared(flights, simulation):
    """It takes derivatives."""

    class Remembering:
        memoryless = False
        vehicle = simulation.vehicle
        seen = 0

        def wrench(self, flight):
            self.seen = len(flight)
            return simulation.wrench(flight)

        def recorded(self, flight, wrench):
            return simulation.recorded(flight, wrench)

    fast = flights[0].slice(slice(0, 400))
    fast = replace(fast, time=fast.time[0] + (fast.time - fast.time[0]) / 4.0)
    remembering = Remembering()
    compared = Compared(fast, remembering)
    assert compared.thinned.rate_hz == pytest.approx(fast.rate_hz / 4.0)
    assert len(compared.residual) == 100
    assert remembering.seen == 200


def corrected(flight, simulation, name, **parameters):
    """The flight without an effect on its sensors, of an estimator that knows all biases."""
    none = np.zeros((len(flight), 3))
    effect, changed = EFFECTS[name], values(name, **parameters)
    return without_sensor_effect(flight, effect, simulation.vehicle, changed, lambda *_: (none, none))


def test_axes_of_the_imu_are_turned_for_rates_and_their_derivative_alike(flight, simulation):
    turned = corrected(flight, simulation, "imu_misalignment", x_deg=2.0, y_deg=-1.5, z_deg=1.0)
    matrix, *_ = np.linalg.lstsq(flight.rates, turned.rates, rcond=None)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-6)
    assert np.degrees(np.arccos(0.5 * (np.trace(matrix) - 1.0))) == pytest.approx(7.25**0.5, rel=0.01)
    for name in ("angular_acceleration", "specific_force"):
        np.testing.assert_allclose(getattr(turned, name), getattr(flight, name) @ matrix, atol=1e-6)


def test_a_pose_that_comes_late_is_moved_back_with_all_that_follows_from_it(flight, simulation):
    moved = corrected(flight, simulation, "sensor_delay", mocap_s=0.08)
    time = flight.time
    for name in ("position", "velocity", "attitude"):
        own = getattr(flight, name)
        earlier = np.stack([np.interp(time + 0.08, time, column) for column in own.T], axis=1)
        assert np.abs(earlier - own).max() > 1e-3
        np.testing.assert_allclose(getattr(moved, name)[:-20], earlier[:-20], atol=1e-3)
    np.testing.assert_array_equal(moved.rates, flight.rates)


def test_a_displaced_centre_feels_the_force_that_was_measured(compared):
    """Even where the simulation lacks it."""
    offset = {"x_m": 0.003, "y_m": -0.004, "z_m": 0.01}
    added = compared.added(EFFECTS["cg_offset"], values("cg_offset", **offset))
    moment = -np.cross(list(offset.values()), compared.measured[:, :3])
    np.testing.assert_allclose(added[:, 3:], moment, atol=1e-12)


NOISE_RAD_S = 8.0


def noisy(flight, seed):
    """Rotor speeds with white noise, which the low-pass of flights has passed."""
    white = NOISE_RAD_S * np.random.default_rng(seed).standard_normal(flight.rotor_speeds.shape)
    return replace(
        flight, rotor_speeds=flight.rotor_speeds + zero_phase(white, 30.0, flight.rate_hz, slice(0)).value
    )


def test_a_delay_of_half_a_sample_leaves_as_much_noise(flight, simulation):
    """Else the half would be preferred, as flights then seem to be explained better."""
    loud = noisy(flight, 0)
    moved = corrected(loud, simulation, "sensor_delay", rotor_speeds_s=0.5 / loud.rate_hz)
    rough, was = (np.std(np.diff(own.rotor_speeds, axis=0)) for own in (moved, loud))
    assert rough == pytest.approx(was, rel=0.02)


def test_motion_stays_and_noise_goes(flown):
    flight = flown()[0]
    loud = noisy(flight, 1)
    error = {
        name: np.sqrt(np.mean(np.square(one.rotor_speeds - flight.rotor_speeds)))
        for name, one in {"loud": loud, "quiet": quiet(loud), "untouched": quiet(flight)}.items()
    }
    assert error["quiet"] < 0.7 * error["loud"]
    assert error["untouched"] < 0.3
    for name in ("velocity", "rates"):
        moved = getattr(quiet(flight), name) - getattr(flight, name)
        assert np.sqrt(np.mean(np.square(moved))) < 0.02


def test_a_slow_log_stays_as_it_is(flown):
    flight = flown()[0].slice(slice(None, None, 20))
    assert quiet(flight) is flight


def test_noise_of_the_inputs_does_not_shrink_the_simulation(flown, moved_tolerances):
    """Rotor speeds so noisy that they make most of the noise of a moment move no tolerance by two.

    Of the moments of the rotors that they make, which are known to a fiftieth, they move a twentieth at most.
    """
    base = VehicleSimulation.load("bebop2")
    flights = [noisy(flight, seed) for seed, flight in enumerate(flown())]
    function = CallableSimulation("function", base.vehicle, base.wrench, base.tolerances)
    moved = moved_tolerances(flights, function)
    share = base.tolerances.inertia
    moments = [share * abs(moved.pop(f"{axis} of rotors")) for axis in ("Mx", "My")]
    assert max(moments) < 0.05, moments
    assert max(map(abs, moved.values())) < 2.0, moved
