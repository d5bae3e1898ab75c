# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/BatteryState."""

from __future__ import annotations

from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter
from quadpi_core.messages.adapters.motor_messages import start_of_battery
from quadpi_core.messages.cdr import header_stamps

BATTERY = Adapter(
    name="battery_state",
    type_name="sensor_msgs/msg/BatteryState",
    topic="battery",
    kind="battery",
    columns=STAMP | {"voltage": 1},
    start=start_of_battery("voltage", header_stamps),
)
