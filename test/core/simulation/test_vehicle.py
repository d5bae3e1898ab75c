# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import pytest
import yaml

from quadpi_core.errors import VehicleError
from quadpi_core.paths import config_directory
from quadpi_core.simulation.vehicle import SimulatedVehicle


@pytest.mark.parametrize("value", [None, 0.0, -0.03, 2.0, "fast", True])
def test_impossible_motors(tmp_path, value):
    with pytest.raises(VehicleError, match=r"own\.yaml: `simulation\.motor_time_constant_s` must be a time"):
        SimulatedVehicle.load(vehicle_file(tmp_path, motor_time_constant_s=value))


def test_unknown_key(tmp_path):
    with pytest.raises(
        VehicleError, match=r"unknown key `simulation\.motor_time_s`; did you mean `motor_time_constant_s`\?"
    ):
        SimulatedVehicle.load(vehicle_file(tmp_path, motor_time_s=0.03))


def vehicle_file(folder, **changes):
    data = yaml.safe_load((config_directory() / "vehicles" / "bebop2.yaml").read_text())
    data["simulation"] |= changes
    (folder / "own.yaml").write_text(yaml.safe_dump(data))
    return folder / "own.yaml"
