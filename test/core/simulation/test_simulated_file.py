# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicle files and model folders that simulations are read from."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from quadpi_core.errors import ModelError, VehicleError
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_aerodynamics import SimulatedAerodynamics, airframe_area, vehicle_record
from quadpi_core.simulation.simulated_file import (
    MOTOR_TIME_CONSTANT,
    model_folder,
    read_simulation,
    vehicle_content,
    write_vehicle_file,
)
from quadpi_core.simulation.truth import STEP_HZ
from quadpi_core.vehicle import Vehicle

GOLDEN = Path(__file__).parents[2] / "golden" / "model"


def test_a_folder_holds_the_vehicle_its_law_and_the_ranges_of_its_flights(physical_folder):
    file = read_simulation(physical_folder)
    model = AerodynamicModel.load(physical_folder)
    assert file.vehicle.fingerprint == Vehicle.load("bebop2").fingerprint
    assert (file.vehicle.name, file.vehicle.noise) == ("bebop2", Vehicle.load("bebop2").noise)
    np.testing.assert_array_equal(file.section.identified_range.upper, model.envelope.upper)
    assert file.section.motor_time_constant_s == SimulatedVehicle.load("bebop2").motor_time_constant
    assert file.vehicle.rotor_speed_max_rad_s == 1200.0


def test_the_lever_arm_of_the_accelerometer_is_an_effect_on_sensors(physical_folder):
    values = AerodynamicModel.load(physical_folder).fitted.parameters.values
    vehicle = SimulatedVehicle.load(physical_folder)
    assert list(vehicle.effects) == ["imu_lever_arm"]
    np.testing.assert_array_equal(list(vehicle.effects["imu_lever_arm"].values()), values[-3:])


def test_motors_of_a_vehicle_whose_file_says_nothing_have_the_usual_lag(physical_folder, tmp_path):
    model = AerodynamicModel.load(physical_folder)
    own = replace(model.flown, name="nowhere")
    replace(model, vehicle="nowhere", flown=own).save(tmp_path / "model")
    vehicle = SimulatedVehicle.load(tmp_path / "model")
    assert vehicle.vehicle.name == "nowhere"
    assert vehicle.motor_time_constant == MOTOR_TIME_CONSTANT.value
    assert 0.025 <= MOTOR_TIME_CONSTANT.value <= 0.045


def test_a_model_of_an_earlier_version_goes_by_the_name_of_its_vehicle(physical_folder, tmp_path):
    model = AerodynamicModel.load(physical_folder)
    replace(model, flown=None).save(tmp_path / "model")
    assert AerodynamicModel.load(tmp_path / "model").flown is None
    assert read_simulation(tmp_path / "model").vehicle.name == "bebop2"


def test_another_kind_of_model_is_refused_saying_why():
    with pytest.raises(
        ModelError, match=r"model: .*method polynomial cannot be simulated: .*--method physical"
    ):
        read_simulation(GOLDEN)


def test_a_folder_beside_does_not_hide_a_vehicle_of_its_name(tmp_path, monkeypatch):
    (tmp_path / "bebop2").mkdir()
    monkeypatch.chdir(tmp_path)
    assert model_folder("bebop2") is None
    assert read_simulation("bebop2").vehicle.name == "bebop2"


def test_an_altered_vehicle_in_a_folder_is_refused(physical_folder, tmp_path):
    folder = tmp_path / "model"
    shutil.copytree(physical_folder, folder)
    text = (folder / "model.json").read_text()
    assert '"mass_kg": 0.374' in text
    (folder / "model.json").write_text(text.replace('"mass_kg": 0.374', '"mass_kg": 0.5'))
    with pytest.raises(ModelError, match="vehicle_file: is another vehicle than"):
        read_simulation(folder)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.pop("u"), "must have a range for each of u, "),
        (lambda r: r.update(u=[1.0, -1.0]), "must hold pairs of numbers, the smaller first"),
        (lambda r: r.update(u=[1.0]), "identified_range"),
    ],
)
def test_ranges_that_are_none(physical_folder, tmp_path, change, message):
    _, data = vehicle_content(physical_folder)
    assert list(data["simulation"]["identified_range"]) == list(INPUT_NAMES)
    change(data["simulation"]["identified_range"])
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(VehicleError, match=message):
        read_simulation(tmp_path / "own.yaml")


def test_the_file_flies_exactly_as_the_folder(physical_folder, tmp_path):
    file = tmp_path / "bebop2.yaml"
    write_vehicle_file(physical_folder, file)
    plan = load_scenario("bundled").flights[0]
    one, other = (
        simulate_flight("same", SimulatedVehicle.load(source), plan.reference(STEP_HZ), seed=1)
        for source in (physical_folder, file)
    )
    np.testing.assert_array_equal(one.wrench, other.wrench)
    np.testing.assert_array_equal(one.rotor_speeds, other.rotor_speeds)
    AerodynamicModel.load(physical_folder).require(Vehicle.load(file))


def test_what_cannot_fly_is_refused_and_nothing_written(tmp_path):
    with pytest.raises(ModelError, match="polynomial cannot be simulated"):
        write_vehicle_file(GOLDEN, tmp_path / "own.yaml")
    with pytest.raises(ModelError, match=r"model\.json"):
        write_vehicle_file(tmp_path, tmp_path / "own.yaml")
    assert not (tmp_path / "own.yaml").exists()


# What every law of the aerodynamics has in common.


@pytest.mark.parametrize("name", ["bebop2", "hdbeetle"])
def test_effectiveness_in_hover_agrees_with_differences_of_the_wrench(name):
    model = RotorLocalModel.load(name)
    by_differences = SimulatedAerodynamics.effectiveness.func(model)
    np.testing.assert_allclose(by_differences, model.effectiveness, rtol=1e-9, atol=1e-18)


def test_record_of_a_vehicle():
    model = RotorLocalModel.load("bebop2")
    record = vehicle_record(model.vehicle, 700.0, 0.03)
    assert (record["mass"], record["hover_rotor_speed"], record["motor_time_constant"]) == (
        0.374,
        700.0,
        0.03,
    )
    np.testing.assert_allclose(record["inertia"][0] @ record["inverse_inertia"][0], np.eye(3), atol=1e-12)
    assert airframe_area(model.vehicle) == pytest.approx(4.0 * 0.0875 * 0.115)
