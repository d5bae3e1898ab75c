# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Opening the messages of a topic: what settings and which version of the type it takes."""

import pytest

from quadpi_core.errors import LogError
from quadpi_core.messages.adapters import AdapterSettings, known_adapters

from .test_adapter_registry import opened
from .vendor_messages import START_NS, px4_status

STATUS, PX4 = "mavros_status", "px4_status"


def test_settings_of_the_kind_are_needed(vendor):
    adapter = known_adapters()[STATUS]
    with pytest.raises(LogError, match="needs settings for `rotor_speeds`"):
        adapter.open(vendor.px4_1_14.definition(adapter.type_name), AdapterSettings(), None)


def test_definition_of_another_version_does_not_decode_silently(vendor):
    payload = px4_status(vendor.px4_1_18, START_NS, [1000, 2000, 3000, 4000])
    with pytest.raises(LogError, match=r"sample 0: .* px4_msgs/msg/EscStatus"):
        opened(vendor.px4_1_14, PX4).unpack(payload)


@pytest.mark.parametrize("name", known_adapters())
def test_a_version_without_a_field_that_is_read_is_refused(vendor, name):
    """The last field that an adapter reads has another name in it."""
    adapter = known_adapters()[name]
    field = list(adapter.columns)[-1].rpartition(".")[2]
    renamed = vendor.px4_1_14.definition(adapter.type_name).replace(f" {field}\n", f" {field}_2\n")
    with pytest.raises(LogError, match=rf"this version of {adapter.type_name} has no field \S*{field} of"):
        opened(vendor.px4_1_14, name, renamed)
