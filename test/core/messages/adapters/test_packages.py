# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of each package that is known, as streams."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError, SampleError
from quadpi_core.inputs import Air, density_of
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import CommandSettings
from quadpi_core.messages.payloads import Payloads
from quadpi_core.vehicle import Vehicle

from .test_adapter_registry import opened
from .vendor_messages import EXAMPLES, START_NS, motor_commands, of_the_air, px4_imu, px4_odometry, voltage


@pytest.mark.parametrize("pose_frame", [1, 2])
def test_px4_odometry_is_stamped_when_sampled_with_its_velocity_in_the_body(vendor, pose_frame):
    """Yawed by 90° to the right, north is on the left."""
    vendor = vendor.px4_1_14
    unpacker = opened(vendor, "px4_odometry")
    stream = unpacker.unpack(px4_odometry(vendor, pose_frame=pose_frame, velocity_frame=pose_frame))
    assert stream.time_ns.tolist() == [START_NS]
    np.testing.assert_allclose(stream.position, [[1, 2, -3]])
    np.testing.assert_allclose(stream.velocity, [[5, -4, 6]], rtol=1e-6)
    np.testing.assert_allclose(stream.rates, [[0.1, 0.2, 0.3]], rtol=1e-6)
    in_body = unpacker.unpack(px4_odometry(vendor, pose_frame=pose_frame, velocity_frame=3))
    np.testing.assert_allclose(in_body.velocity, [[4, 5, 6]])
    unsampled = unpacker.unpack(px4_odometry(vendor, timestamp_sample=0))
    assert unsampled.time_ns.tolist() == [START_NS + 500_000]


@pytest.mark.parametrize("field", ["position", "q", "velocity", "angular_velocity"])
def test_px4_odometry_without_a_quantity_is_no_sample(vendor, field):
    vendor = vendor.px4_1_14
    unpacker = opened(vendor, "px4_odometry")
    unknown = px4_odometry(vendor, **{field: [np.nan] * (4 if field == "q" else 3)})
    stream = unpacker.unpack(Payloads.join([unknown, px4_odometry(vendor)]))
    assert len(stream) == 1
    assert sum(unpacker.dropped.values()) == 1


@pytest.mark.parametrize("frames", [(0, 1), (1, 0), (1, 2), (2, 1), (3, 3)])
def test_px4_odometry_in_frames_that_do_not_fit_is_refused(vendor, frames):
    vendor = vendor.px4_1_14
    wrong = px4_odometry(vendor, pose_frame=frames[0], velocity_frame=frames[1])
    with pytest.raises(LogError, match=f"sample 1: pose_frame {frames[0]}, velocity_frame {frames[1]}"):
        opened(vendor, "px4_odometry").unpack(Payloads.join([px4_odometry(vendor), wrong]))


def test_stamps_that_no_message_can_hold_are_refused(vendor):
    vendor = vendor.px4_1_14
    beyond = px4_odometry(vendor, timestamp_sample=2**31 * 10**6)
    with pytest.raises(LogError, match="sample 0: the stamp has 2147483648000000 µs"):
        opened(vendor, "px4_odometry").unpack(beyond)


def test_px4_imu_needs_no_conversion(vendor):
    vendor = vendor.px4_1_14
    stream = opened(vendor, "px4_imu").unpack(px4_imu(vendor))
    assert stream.time_ns.tolist() == [START_NS]
    np.testing.assert_allclose(stream.angular_velocity, [[0.1, 0.2, 0.3]], rtol=1e-6)
    np.testing.assert_allclose(stream.specific_force, [[1, 2, -9.8]], rtol=1e-6)


# Pressure and temperature, each of which knows nothing of the other; PX4's message knows both.


def test_both_together_tell_the_density(vendor) -> None:
    pressure, temperature = (
        opened(vendor.px4_1_14, name).unpack(EXAMPLES[name](vendor.px4_1_14))
        for name in ("fluid_pressure", "temperature")
    )
    assert (pressure.pressure[0], temperature.celsius[0]) == (95000.0, 20.0)
    assert np.isnan((pressure.celsius[0], temperature.pressure[0])).all()
    air = Air()
    assert not air.hear(pressure.pressure[0], pressure.celsius[0])
    assert air.hear(temperature.pressure[0], temperature.celsius[0])
    assert air.density == pytest.approx(float(density_of(np.array(95000.0), np.array(20.0))))


def test_px4_tells_the_temperature_by_its_density(vendor) -> None:
    air = opened(vendor.px4_1_14, "px4_air").unpack(EXAMPLES["px4_air"](vendor.px4_1_14))
    assert density_of(air.pressure, air.celsius) == pytest.approx([1.129], rel=1e-6)


@pytest.mark.parametrize(
    ("name", "field", "wrong", "reason"),
    [
        ("fluid_pressure", "fluid_pressure", 950.0, "no pressure of air in Pa"),
        ("temperature", "temperature", 293.15, "no temperature of air in °C"),
    ],
)
def test_another_unit_is_dropped_and_said(vendor, name, field, wrong, reason) -> None:
    reading, type_name = opened(vendor.px4_1_14, name), known_adapters()[name].type_name
    message = of_the_air(vendor.px4_1_14, type_name, START_NS, **{field: wrong})
    assert len(reading.unpack(message)) == 0
    assert reading.dropped == {reason: 1}


# sensor_msgs/BatteryState, whose voltage may not be known.


def test_a_voltage_that_was_not_measured_is_dropped(vendor):
    unpacker = opened(vendor.px4_1_14, "battery_state")
    messages = [voltage(vendor.px4_1_14, "battery_state", START_NS, volts) for volts in (np.nan, 0.0, 15.5)]
    assert unpacker.unpack(Payloads.join(messages)).voltage.tolist() == [15.5]
    assert dict(unpacker.dropped) == {"the voltage is not known": 2}


# Logged variables of Crazyswarm2, which do not say what they are.


def test_the_places_of_the_motors_are_said(vendor):
    adapter = known_adapters()["crazyflie_log"]
    settings = AdapterSettings(motor_commands=CommandSettings((2, 3, 4, 5), topic="/cf1/motors"))
    unpacker = adapter.open(vendor.px4_1_14.definition(adapter.type_name), settings, None)
    values = [3700.0, *(65535.0 * share for share in (0.1, 0.2, 0.3, 0.4))]
    stream = unpacker.unpack(motor_commands(vendor.px4_1_14, "crazyflie_log", START_NS, values))
    np.testing.assert_allclose(stream.commands, [[0.1, 0.2, 0.3, 0.4]], atol=1e-6)
    # A log holds anything: its topic must be named.
    assert adapter.common


def test_unless_said_the_first_four_are_m1_to_m4(vendor):
    """Which a Crazyflie numbers clockwise from the right front, and the vehicle from the right rear."""
    adapter = known_adapters()["crazyflie_log"]
    settings = AdapterSettings(motor_commands=CommandSettings(topic="/cf1/motors"))
    definition = vendor.px4_1_14.definition(adapter.type_name)
    vehicle = Vehicle.load("crazyflie_rpm")
    turned = replace(vehicle, rotor_positions=np.roll(vehicle.rotor_positions, -1, axis=0))
    values = [65535.0 * share for share in (0.1, 0.2, 0.3, 0.4)]
    message = motor_commands(vendor.px4_1_14, "crazyflie_log", START_NS, values)
    for flown, shares in ((vehicle, [0.1, 0.2, 0.3, 0.4]), (turned, [0.2, 0.3, 0.4, 0.1])):
        stream = adapter.open(definition, settings, flown).unpack(message)
        np.testing.assert_allclose(stream.commands, [shares], atol=1e-6)


def test_as_many_motors_as_the_vehicle_has(vendor):
    adapter = known_adapters()["crazyflie_log"]
    settings = AdapterSettings(motor_commands=CommandSettings((2, 3, 4), topic="/cf1/motors"))
    definition = vendor.px4_1_14.definition(adapter.type_name)
    with pytest.raises(LogError, match="rotor order of 3 numbers; vehicle crazyflie_rpm has 4 rotors"):
        adapter.open(definition, settings, Vehicle.load("crazyflie_rpm"))


# Motor commands and battery voltages of any package.


@pytest.mark.parametrize(
    ("name", "values", "commands"),
    [
        ("px4_motors", [0.1, 0.2, 0.3, np.nan], [0.3, 0.1, 0.0, 0.2]),
        ("px4_outputs", [200, 400, 600, 800], [0.3, 0.1, 0.4, 0.2]),
        ("mavros_rc_out", [1100, 1200, 1300, 1400], [0.3, 0.1, 0.4, 0.2]),
        # Disarmed, at the pulses of rest; a single motor there turns by its step of DShot.
        ("px4_outputs", [900, 900, 900, 900], [0.0] * 4),
        ("px4_outputs", [900, 400, 600, 800], [0.3, 0.45, 0.4, 0.2]),
        ("motor_commands", [0.1, 0.2, 0.3, np.nan], [0.3, 0.1, 0.0, 0.2]),
        ("crazyflie_log", [6553.5, 13107, 19660.5, 26214], [0.3, 0.1, 0.4, 0.2]),
    ],
)
def test_commands_come_in_the_order_of_the_rotors(vendor, name, values, commands):
    message = motor_commands(vendor.px4_1_14, name, START_NS, values)
    stream = opened(vendor.px4_1_14, name).unpack(message)
    np.testing.assert_allclose(stream.commands, [commands], atol=1e-6)


def test_outputs_that_are_not_announced_yet_are_dropped_and_too_few_refused(vendor):
    def message(values):
        return motor_commands(vendor.px4_1_14, "mavros_rc_out", START_NS, values)

    unpacker = opened(vendor.px4_1_14, "mavros_rc_out")
    assert len(unpacker.unpack(message([]))) == 0
    assert dict(unpacker.dropped) == {"no output is announced yet": 1}
    # Of messages that are read together the rest of short ones is 0: no pulse.
    both = unpacker.unpack(Payloads.join([message([]), message([1100] * 8)]))
    np.testing.assert_allclose(both.commands, [[-1.0] * 4, [0.1] * 4])
    with pytest.raises(SampleError, match="channels has 2 outputs, and `rotors` names output 4"):
        unpacker.unpack(message([1100, 1100]))
