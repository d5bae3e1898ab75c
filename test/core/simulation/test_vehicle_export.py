# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicle files that fly as identified models."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.truth import STEP_HZ
from quadpi_core.simulation.vehicle_export import write_vehicle_file
from quadpi_core.vehicle import Vehicle

GOLDEN = Path(__file__).parents[2] / "golden" / "model"


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
