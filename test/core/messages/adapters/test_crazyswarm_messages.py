# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Logged variables of Crazyswarm2, which do not say what they are."""

from __future__ import annotations

import numpy as np

from quadpi_core.messages.adapters import AdapterSettings, known_adapters
from quadpi_core.messages.adapters.adapter_settings import CommandSettings

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
