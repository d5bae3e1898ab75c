# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Motor commands and battery voltages of any package."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import SampleError
from quadpi_core.messages.payloads import Payloads

from .test_adapter_registry import opened
from .vendor_messages import START_NS, motor_commands


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
