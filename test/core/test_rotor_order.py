# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which speed controller is which rotor of the vehicle file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.rotor_order import LAYOUTS, Motor, RotorOrder
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("neurobem")


@pytest.mark.parametrize("layout", ["quad-x", "betaflight"])
@pytest.mark.parametrize("name", ["neurobem", "bebop2", "crazyflie_rpm"])
def test_every_rotor_gets_the_motor_of_its_corner(layout: str, name: str) -> None:
    vehicle = Vehicle.load(name)
    order = RotorOrder.by_layout(vehicle, layout)
    for rotor, motor in enumerate(order.controllers):
        corner = np.sign(LAYOUTS[layout][motor][:2])
        assert np.array_equal(np.sign(vehicle.rotor_positions[rotor, :2]), corner)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_rotors_of_every_layout_are_found_in_any_order(layout: str) -> None:
    """Also where they are off their bearings by a few degrees."""
    motors = LAYOUTS[layout]
    order = np.random.default_rng(1).permutation(len(motors))
    turn = np.radians(4.0)
    places = np.array([[m.x, m.y, 0.0] for m in motors])[order] * 0.2
    x, y = places[:, 0].copy(), places[:, 1].copy()
    places[:, 0], places[:, 1] = np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y
    spins = np.array([motors[k].spin or 1.0 for k in order])
    vehicle = replace(Vehicle.load("neurobem"), rotor_positions=places, rotor_spins=spins)
    assert RotorOrder.by_layout(vehicle, layout).controllers == tuple(order)


def test_coaxial_rotors_that_all_turn_the_other_way_keep_their_levels(vehicle: Vehicle) -> None:
    """By the heights that the vehicle file gives; where it gives none, by their spins."""
    motors = LAYOUTS["octo-coaxial-x"]
    places = np.array([[one.x, one.y, 0.05 * bool(one.below)] for one in motors])
    reversed_spins = -np.array([one.spin for one in motors])
    tall = replace(vehicle, rotor_positions=places, rotor_spins=reversed_spins)
    assert RotorOrder.by_layout(tall, "octo-coaxial-x").controllers == tuple(range(8))
    flat = replace(tall, rotor_positions=places * [1.0, 1.0, 0.0], rotor_spins=-reversed_spins)
    assert RotorOrder.by_layout(flat, "octo-coaxial-x").controllers == tuple(range(8))


def test_a_frame_of_another_kind_has_no_order(vehicle: Vehicle) -> None:
    for layout in ("quad-plus", "hexa-x"):
        with pytest.raises(LogError, match=f"the vehicle's rotors are not those of a frame {layout}"):
            RotorOrder.by_layout(vehicle, layout)


def test_neurobem_under_px4(vehicle: Vehicle) -> None:
    """Its rotors are rear right, front right, rear left, front left; PX4's FR, RL, FL, RR."""
    assert RotorOrder.by_layout(vehicle, "quad-x").controllers == (3, 0, 1, 2)


def test_motors_that_share_a_corner_have_no_order(vehicle: Vehicle) -> None:
    assert RotorOrder.by_place(vehicle, [Motor(1, 1), Motor(1, 1), Motor(-1, 1), Motor(-1, -1)]) is None
    assert RotorOrder.by_place(vehicle, [Motor(0, 0)] * 4) is None


def test_units(vehicle: Vehicle) -> None:
    rpm = np.array([[60.0, -120.0, 0.0, 600.0]])
    mechanical = RotorOrder((0, 1, 2, 3), "rpm").speeds(rpm, vehicle)
    assert mechanical == pytest.approx(np.array([[2, 4, 0, 20]]) * np.pi)
    six = replace(vehicle, pole_pairs=6)
    assert RotorOrder((0, 1, 2, 3), "erpm").speeds(rpm, six) == pytest.approx(mechanical / 6)
    with pytest.raises(VehicleError, match="pole_pairs"):
        RotorOrder((0, 1, 2, 3), "erpm").speeds(rpm, replace(vehicle, pole_pairs=None))


def test_a_mapping_file(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("rotors: [4, 1, 2, 3]\nunit: erpm\n")
    assert RotorOrder.load(path) == RotorOrder((3, 0, 1, 2), "erpm")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rotors: [1, 2, 3, 3]", "`rotors` must be different numbers"),
        ("rotors: []", "must be different numbers"),
        ("rotors: [0, 1, 2, 3]", "counted from 1"),
        ("rotors: [1, 2, 3, true]", "counted from 1"),
        ("rotors: [1, 2, 3, 4]\nunit: rad/s", "`unit` must be one of rpm, erpm, found 'rad/s'"),
        ("time: {columns: [t]}", "unknown key `time`; known: rotors, unit"),
        ("[1, 2, 3, 4]", r"expected keys and values, found \[1, 2, 3, 4\]"),
    ],
)
def test_a_wrong_mapping_file_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(text)
    with pytest.raises(LogError, match=message):
        RotorOrder.load(tmp_path / "mine.yaml")


def test_an_order_in_a_string() -> None:
    assert RotorOrder.parse("4, 1 2 3").controllers == (3, 0, 1, 2)
    with pytest.raises(LogError, match="found \\[4, 1, 'x', 3\\]"):
        RotorOrder.parse("4 1 x 3")
