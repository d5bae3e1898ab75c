# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which speed controller is which rotor of the vehicle file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.flight import BatteryStream, ImuStream, MotorCommandStream, Recording
from quadpi_core.rotor_order import LAYOUTS, CommandedSpeeds, Motor, RotorOrder, with_commanded_speeds
from quadpi_core.vehicle import Motors, Vehicle


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


# Motors in a vehicle file: kept, and refused where they are none.


LAG_S = 0.05
MOTORS = Motors(source="test", coefficients=((100.0, 1000.0, 200.0, 10.0, 20.0),) * 4, lag_s=LAG_S, volts=4.0)


def test_a_vehicle_file_keeps_them():
    vehicle = Vehicle.from_content(
        {**Vehicle.load("neurobem").to_file(), "motors": MOTORS.to_file()}, "mine", "a file"
    )
    assert vehicle.motors == MOTORS
    assert vehicle.fingerprint == Vehicle.load("neurobem").fingerprint
    assert "motors" not in Vehicle.load("neurobem").to_file()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"coefficients": [[1.0] * 5] * 3}, "each of the 4 rotors"),
        ({"coefficients": [[1.0] * 4] * 4}, "5 numbers for each rotor"),
        ({"coefficients": [[float("inf")] * 5] * 4}, "must be a number"),
        ({"lag_s": 3.0}, "`lag_s`"),
    ],
)
def test_what_is_no_motor_is_refused(change, said):
    content = {**Vehicle.load("neurobem").to_file(), "motors": {**MOTORS.to_file(), **change}}
    with pytest.raises(VehicleError, match=said):
        Vehicle.from_content(content, "mine", "a file")


# Rotor speeds from commands: the lag, pauses, the battery, and the same bits however the commands come.


def commands(u, step_s=0.01, start_ns=10**9):
    time_ns = start_ns + np.rint(1e9 * step_s * np.arange(len(u))).astype(np.int64)
    return MotorCommandStream(time_ns, np.tile(np.asarray(u, dtype=float)[:, np.newaxis], 4))


def settled(u, volts):
    return 100.0 + 1000.0 * u + 200.0 * u * u + 10.0 * volts + 20.0 * u * volts


def test_a_step_is_followed_with_the_lag():
    u = np.where(np.arange(200) < 100, 0.4, 0.6)
    speeds = CommandedSpeeds(MOTORS).take(commands(u)).speeds[:, 0]
    np.testing.assert_allclose(speeds[:100], settled(0.4, 4.0))
    # A straight line of 10 ms instead of the step: half of that later.
    after = 0.01 * np.arange(1, 101) - 0.005
    begin, end = settled(0.4, 4.0), settled(0.6, 4.0)
    np.testing.assert_allclose(speeds[100:], end + (begin - end) * np.exp(-after / LAG_S), rtol=2e-3)


def test_the_same_bits_one_by_one_and_at_once():
    rng = np.random.default_rng(3)
    stream = commands(rng.uniform(0.2, 0.8, 300))
    stream.time_ns[:] += rng.integers(0, 4_000_000, 300)
    battery = BatteryStream(stream.time_ns[::7] + 5, rng.uniform(3.4, 4.2, len(stream.time_ns[::7])))
    whole = CommandedSpeeds(MOTORS).take(stream, battery)
    single, place = CommandedSpeeds(MOTORS), 0
    for row in range(300):
        while place < len(battery) and battery.time_ns[place] < stream.time_ns[row]:
            single.take(stream.take(slice(0, 0)), battery.take(slice(place, place + 1)))
            place += 1
        one = single.take(stream.take(slice(row, row + 1)))
        assert one.speeds.tobytes() == whole.speeds[row].tobytes()


def test_a_motor_that_is_commanded_0_stands_and_a_pause_begins_anew():
    stream = commands([0.5, 0.5, 0.0])
    stream.time_ns[2] += 5 * 10**9
    speeds = CommandedSpeeds(MOTORS).take(stream).speeds[:, 0]
    np.testing.assert_allclose(speeds, [settled(0.5, 4.0), settled(0.5, 4.0), 0.0])


def test_a_stamp_that_does_not_rise_changes_nothing_until_the_clock_fell():
    stream = commands([0.5, 0.9, 0.5, 0.7])
    stream.time_ns[:] = [90 * 10**9, 90 * 10**9 - 1, 90 * 10**9 + 10**7, 10**9]
    speeds = CommandedSpeeds(MOTORS).take(stream).speeds[:, 0]
    np.testing.assert_allclose(speeds, [settled(u, 4.0) for u in (0.5, 0.5, 0.5, 0.7)])


def test_the_battery_counts_from_the_command_after_it():
    stream = commands([0.5] * 3, step_s=2.0)
    battery = BatteryStream(stream.time_ns[1:2] + 1, np.array([3.0]))
    speeds = CommandedSpeeds(MOTORS).take(stream, battery).speeds[:, 0]
    np.testing.assert_allclose(speeds, [settled(0.5, volts) for volts in (4.0, 4.0, 3.0)])


def test_speeds_are_stamped_later_by_the_dead_time():
    late = Motors(source="test", coefficients=MOTORS.coefficients, lag_s=0.0, dead_s=0.008)
    stream = commands([0.4, 0.6])
    told = CommandedSpeeds(late).take(stream)
    assert (told.time_ns - stream.time_ns).tolist() == [8_000_000] * 2
    np.testing.assert_allclose(told.speeds[:, 0], [settled(u, 1.0) for u in (0.4, 0.6)])


def test_commands_of_another_number_of_motors_are_refused():
    six = MotorCommandStream(np.array([10**9]), np.full((1, 6), 0.5))
    imu = ImuStream(np.array([10**9]), np.zeros((1, 3)), np.zeros((1, 3)))
    recording = Recording("log", "", "log.bin", imu, commands=six, command_source="test")
    with pytest.raises(LogError, match=r"log\.bin: topic motor_commands: 6 motors, .* knows 4"):
        with_commanded_speeds(recording, MOTORS)
