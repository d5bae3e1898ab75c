# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
import yaml

from quadpi_core.errors import SimulationError, VehicleError
from quadpi_core.paths import config_directory
from quadpi_core.simulation.effect_registry import read_effects
from quadpi_core.simulation.flying import simulate_flight
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_vehicle import SimulatedVehicle
from quadpi_core.simulation.truth import STEP_HZ


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
