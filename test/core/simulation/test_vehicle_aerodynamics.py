# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which law of the aerodynamics a vehicle file holds."""

from __future__ import annotations

import pytest
import yaml

from quadpi_core.errors import VehicleError
from quadpi_core.simulation.physical_aerodynamics import PhysicalAerodynamics
from quadpi_core.simulation.rotor_local import RotorLocalModel
from quadpi_core.simulation.simulated_file import vehicle_content
from quadpi_core.simulation.vehicle_aerodynamics import LAWS, load_aerodynamics


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
