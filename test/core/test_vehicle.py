# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicle files: those of the project, and what is refused in others."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from quadpi_core.errors import VehicleError
from quadpi_core.paths import config_directory
from quadpi_core.vehicle import SensorNoise, Vehicle

VEHICLES = ("bebop2", "crazyflie_rpm", "hdbeetle", "indiflight", "nanodrone", "neurobem")


def valid() -> dict[str, Any]:
    return {
        "mass_kg": 0.5,
        "inertia_kg_m2": [1e-3, 1e-3, 2e-3],
        "rotor_radius_m": 0.06,
        "pole_pairs": 7,
        "rotors": [
            {"position_m": [0.1, 0.1, 0.0], "spin": "counterclockwise"},
            {"position_m": [-0.1, 0.1, 0.0], "spin": "clockwise"},
            {"position_m": [-0.1, -0.1, 0.0], "spin": "counterclockwise"},
            {"position_m": [0.1, -0.1, 0.0], "spin": "clockwise"},
        ],
    }


def load(folder: Path, data: Any) -> Vehicle:
    path = folder / "vehicle.yaml"
    path.write_text(yaml.safe_dump(data))
    return Vehicle.load(path)


def test_the_project_has_these_vehicles():
    assert sorted(p.stem for p in (config_directory() / "vehicles").glob("*.yaml")) == sorted(VEHICLES)


@pytest.mark.parametrize("name", VEHICLES)
def test_project_vehicles_are_balanced_quadrotors(name: str):
    vehicle = Vehicle.load(name)
    assert vehicle.name == name
    np.testing.assert_allclose(vehicle.rotor_positions.sum(axis=0), 0.0, atol=1e-12)
    assert vehicle.rotor_spins.sum() == 0.0
    assert len(np.unique(np.sign(vehicle.rotor_positions[:, :2]), axis=0)) == 4
    # Diagonal rotors turn the same way: the yaw torque must not be coupled to roll or pitch.
    np.testing.assert_allclose(vehicle.rotor_spins @ vehicle.rotor_positions, 0.0, atol=1e-12)
    spacing = 2.0 * np.abs(vehicle.rotor_positions[:, :2]).min()
    assert spacing > 2.0 * vehicle.rotor_radius_m, "propellers side by side would touch"


@pytest.mark.parametrize("name", VEHICLES)
def test_project_vehicles_say_where_their_numbers_come_from(name: str):
    text = (config_directory() / "vehicles" / f"{name}.yaml").read_text()
    assert len(yaml.safe_load(text)["source"]) > 50


@pytest.mark.parametrize("name", VEHICLES)
def test_hover_needs_less_than_the_largest_rotor_speed(name: str):
    vehicle = Vehicle.load(name)
    coefficient = 0.015  # of a poor rotor
    disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    hover = np.sqrt(vehicle.mass_kg * vehicle.gravity_m_s2 / (4.0 * coefficient * disc))
    assert hover < vehicle.rotor_speed_max_rad_s


def test_hover_induced_velocity_carries_the_weight():
    """Momentum theory: thrust = 2 ρ A v_h²."""
    vehicle = Vehicle.load("neurobem")
    area = 4.0 * np.pi * vehicle.rotor_radius_m**2
    thrust = 2.0 * vehicle.air_density_kg_m3 * area * vehicle.hover_induced_velocity**2
    assert thrust == pytest.approx(vehicle.mass_kg * vehicle.gravity_m_s2)


def test_electrical_speeds(tmp_path: Path):
    vehicle = load(tmp_path, valid())
    np.testing.assert_allclose(vehicle.rotor_speeds_from_erpm(np.full(4, 7 * 6000.0)), 200.0 * np.pi)
    with pytest.raises(VehicleError, match="vehicle vehicle: electrical rotor speeds need `pole_pairs`"):
        load(tmp_path, valid() | {"pole_pairs": None}).rotor_speeds_from_erpm(np.ones(4))


@pytest.mark.parametrize("key", sorted(valid()))
def test_every_key_is_required(tmp_path: Path, key: str):
    data = valid()
    del data[key]
    with pytest.raises(VehicleError, match=rf"vehicle\.yaml: missing key `{key}`"):
        load(tmp_path, data)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 1.0}, "unknown key `mass`"),
        ({"mass_kg": -1.0}, "`mass_kg` must be a positive number, found -1.0"),
        ({"mass_kg": "heavy"}, "`mass_kg` must be a positive number"),
        ({"mass_kg": float("nan")}, "`mass_kg` must be a positive number"),
        ({"inertia_kg_m2": [1e-3, 1e-3]}, "`inertia_kg_m2` must be 3 numbers or a 3x3 matrix"),
        ({"inertia_kg_m2": [1e-3, 1e-3, 3e-3]}, "not the inertia of a rigid body"),
        ({"inertia_kg_m2": [[1, 1, 0], [0, 1, 0], [0, 0, 1]]}, "not the inertia of a rigid body"),
        ({"pole_pairs": 3.5}, "`pole_pairs` must be a positive whole number or null, found 3.5"),
        ({"rotors": []}, "`rotors` must list 1 to 12 rotors"),
        ({"noise": {"gyro": 1.0}}, "noise: unknown key `gyro`; known: accelerometer_noise_m_s2, "),
        ({"noise": {"gyro_noise": 1.0}}, "did you mean `gyro_noise_rad_s`?"),
        (
            {"noise": {"mocap_delay_s": 1.0}},
            "noise: `mocap_delay_s` must be a number from -0.3 to 0.3",
        ),
    ],
)
def test_impossible_values_are_named(tmp_path: Path, change: dict[str, Any], message: str):
    with pytest.raises(VehicleError) as caught:
        load(tmp_path, valid() | change)
    assert "vehicle.yaml" in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position_m": [0.1, 0.1]}, "rotors, entry 2: `position_m` must be three numbers, found"),
        ({"position_m": [0.1, 0.0, 0.0]}, "one in each quadrant .*, or one on each half of the body axes"),
        (
            {"spin": "left"},
            "rotors, entry 2: `spin` must be one of clockwise, counterclockwise, f",
        ),
        ({"spin": ["left"]}, "rotors, entry 2: `spin` must be one of clockwise, counterclockwise"),
    ],
)
def test_impossible_rotors_are_named(tmp_path: Path, change: dict[str, Any], message: str):
    data = valid()
    data["rotors"][1] |= change
    with pytest.raises(VehicleError, match=message):
        load(tmp_path, data)


@pytest.mark.parametrize("text", ["[1, 2]", "", "a: [", "\x00"])
def test_other_files_are_refused(tmp_path: Path, text: str):
    path = tmp_path / "vehicle.yaml"
    path.write_text(text)
    with pytest.raises(VehicleError, match=r"vehicle\.yaml"):
        Vehicle.load(path)


def test_unknown_vehicle_lists_the_known():
    with pytest.raises(VehicleError, match=r"no such vehicle file; known vehicles: bebop2, .*neurobem"):
        Vehicle.load("nonesuch")


def test_fingerprint_changes_with_what_a_model_depends_on_only():
    vehicle = Vehicle.load("neurobem")
    assert replace(vehicle, name="copy", noise=SensorNoise()).fingerprint == vehicle.fingerprint
    assert replace(vehicle, mass_kg=vehicle.mass_kg + 0.05).fingerprint != vehicle.fingerprint
    assert replace(vehicle, rotor_spins=-vehicle.rotor_spins).fingerprint != vehicle.fingerprint


@pytest.mark.parametrize(("ratio", "accepted"), [(0.021, True), (0.019, False), (9.9, True), (10.1, False)])
def test_inertia_about_z_is_that_of_mass_at_the_rotors_within_a_factor(
    tmp_path: Path, ratio: float, accepted: bool
):
    """Here 0.5 kg at 0.14 m: g m² for kg m² would be a thousand times as much."""
    data = valid() | {"inertia_kg_m2": [ratio * 0.5 * 0.02] * 3}
    if accepted:
        assert load(tmp_path, data).inertia[2, 2] == pytest.approx(0.01 * ratio)
        return
    with pytest.raises(
        VehicleError, match=r"`inertia_kg_m2`: about z it is .* expected 0.2 to 1: wrong unit"
    ):
        load(tmp_path, data)


def test_a_measured_speed_a_tenth_above_the_largest_is_a_spike():
    vehicle = Vehicle.load("bebop2")
    assert vehicle.rotor_speed_spike_rad_s == pytest.approx(1.1 * vehicle.rotor_speed_max_rad_s)


def test_records_with_arrays_can_be_looked_for_in_a_list():
    one, other = Vehicle.load("bebop2"), Vehicle.load("bebop2")
    assert one in [other, one]
    assert [other, one].index(one) == 1
    assert len({one, other}) == 2
