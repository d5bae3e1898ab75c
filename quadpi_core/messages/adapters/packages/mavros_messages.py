# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""ESC reports of mavros, in the order of the ESCs, and the pulses of its outputs."""

from __future__ import annotations

import numpy as np

from quadpi_core.messages.adapters.adapter_definition import STAMP, Adapter, of_items
from quadpi_core.messages.adapters.rotor_messages import (
    EscReports,
    reports_in_esc_order,
    start_of_commands,
    start_of_rotors,
)
from quadpi_core.messages.cdr import ANY, Columns, header_stamps
from quadpi_core.messages.definitions import Items
from quadpi_core.messages.payloads import Indices


def _status(columns: Columns, items: dict[str, Items], order: Indices) -> EscReports:
    """Reports of mavros_msgs/ESCStatus: in ESC order; each item has the stamp of its own ESC_STATUS."""
    array = items["esc_status"]
    marks = array.columns["header.stamp.sec"].astype(np.int64) << 32 | array.columns["header.stamp.nanosec"]
    return reports_in_esc_order(columns, array, marks, order)


def _telemetry(columns: Columns, items: dict[str, Items], order: Indices) -> EscReports:
    """Reports of mavros_msgs/ESCTelemetry: in ESC order, stamped on arrival; packets are counted."""
    array = items["esc_telemetry"]
    return reports_in_esc_order(columns, array, array.columns["count"].astype(np.int64), order)


STATUS = Adapter(
    name="mavros_status",
    type_name="mavros_msgs/msg/ESCStatus",
    topic="mavros/esc_status/status",
    kind="rotor_speeds",
    columns=STAMP | of_items("esc_status", **STAMP, rpm=1),
    start=start_of_rotors(_status),
)
TELEMETRY = Adapter(
    name="mavros_telemetry",
    type_name="mavros_msgs/msg/ESCTelemetry",
    topic="mavros/esc_telemetry/telemetry",
    kind="rotor_speeds",
    columns=STAMP | of_items("esc_telemetry", rpm=1, count=1),
    start=start_of_rotors(_telemetry),
)
OUTPUTS = Adapter(
    name="mavros_rc_out",
    type_name="mavros_msgs/msg/RCOut",
    topic="mavros/rc/out",
    kind="motor_commands",
    columns=STAMP | {"channels": ANY},
    # Pulses of 1000 to 2000 µs.
    start=start_of_commands("channels", header_stamps, lambda pulses: 1e-3 * (pulses - 1000.0)),
    battery=("battery_state", "mavros/battery"),
)
