# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Logged variables of Crazyswarm2, which do not say what they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import CommandSettings
from quadpi_core.vehicle import Vehicle

from .vendor_messages import START_NS, motor_commands


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
