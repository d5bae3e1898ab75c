# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""crazyflie_interfaces of Crazyswarm2: blocks of logged variables, and the battery.

A block does not name its variables: they are those of `custom_topics` in its configuration, in that order. So
its topic must be named, and `rotors` are the places of the motors' variables among its values, m1 to m4 first
unless given.
"""

from __future__ import annotations

from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter
from quadpi_core.messages.adapters.rotor_messages import start_of_battery, start_of_commands
from quadpi_core.messages.cdr import ANY, header_stamps

_FULL = 65535.0
LOG = Adapter(
    name="crazyflie_log",
    type_name="crazyflie_interfaces/msg/LogDataGeneric",
    topic="motors",
    kind="motor_commands",
    columns=STAMP | {"values": ANY},
    start=start_of_commands("values", header_stamps, lambda values: values / _FULL, "crazyflie"),
    common=True,
    battery=("crazyflie_status", "status"),
)
STATUS = Adapter(
    name="crazyflie_status",
    type_name="crazyflie_interfaces/msg/Status",
    topic="status",
    kind="battery",
    columns=STAMP | {"battery_voltage": 1},
    start=start_of_battery("battery_voltage", header_stamps),
)
