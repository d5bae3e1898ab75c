# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import struct

import pytest

from quadpi_core.errors import LogError
from quadpi_core.messages.payloads import Payloads

from .test_rotor_messages import RPMS, START_NS, STATUS, STEP_NS, TELEMETRY, make, opened


@pytest.mark.parametrize("name", [STATUS, TELEMETRY])
def test_mavros_announces_no_esc_or_too_few(vendor, name):
    """The array of ESCStatus is empty until the first ESC_INFO."""
    unpacker = opened(vendor.px4_1_14, name)
    payloads = [
        make(vendor.px4_1_14, name, sample, rpm) for sample, rpm in enumerate([[], [], RPMS[0][:3], RPMS[0]])
    ]
    stream = unpacker.unpack(Payloads.join(payloads))
    assert stream.time_ns.tolist() == [START_NS + 3 * STEP_NS]
    assert dict(unpacker.dropped) == {
        "no ESC is announced yet": 2,
        "fewer ESCs report than `rotors` names": 1,
    }


def test_a_stamp_that_is_none_names_the_message(vendor):
    """Stamps of items only tell new reports from old ones, so that theirs may be anything."""
    good = make(vendor.px4_1_14, STATUS, 0, RPMS[0])
    nanoseconds = good.index(struct.pack("<I", START_NS % 10**9))
    bad = good[:nanoseconds] + struct.pack("<I", 10**9) + good[nanoseconds + 4 :]
    with pytest.raises(LogError, match="sample 1: the stamp has 1000000000 ns beyond its second"):
        opened(vendor.px4_1_14, STATUS).unpack(Payloads.join([good, bad]))
    in_item = good.rindex(struct.pack("<I", START_NS % 10**9))
    odd = good[:in_item] + struct.pack("<I", 2**32 - 1) + good[in_item + 4 :]
    assert len(opened(vendor.px4_1_14, STATUS).unpack(odd)) == 1
