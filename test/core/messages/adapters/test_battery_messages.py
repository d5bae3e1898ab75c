# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""sensor_msgs/BatteryState, whose voltage may not be known."""

from __future__ import annotations

import numpy as np

from quadpi_core.messages.payloads import Payloads

from .test_adapter_registry import opened
from .vendor_messages import START_NS, voltage


def test_a_voltage_that_was_not_measured_is_dropped(vendor):
    unpacker = opened(vendor.px4_1_14, "battery_state")
    messages = [voltage(vendor.px4_1_14, "battery_state", START_NS, volts) for volts in (np.nan, 0.0, 15.5)]
    assert unpacker.unpack(Payloads.join(messages)).voltage.tolist() == [15.5]
    assert dict(unpacker.dropped) == {"the voltage is not known": 2}
