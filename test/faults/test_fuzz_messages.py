# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bytes that are no messages: a decoder refuses them in one line that names the sample, or gives arrays."""

from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.fuzzing.message_readers import UNPACKERS, sound_message
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.messages.adapters import known_adapters
from quadpi_core.messages.payloads import Payloads

from ..core.messages.adapters.vendor_messages import DEFINITIONS, EXAMPLES, PX4_1_18, SETTINGS, Messages
from .damage import bounded, damaged, refusing

pytestmark = pytest.mark.slow

CASES = 60
# Events come as records instead of arrays.
READERS = UNPACKERS | {
    sensor_messages.EVENT: lambda payloads: [
        np.array([event.time_ns for event in result_messages.unpack_events(payloads)], dtype=np.int64)
    ]
}


def assert_arrays(stream, count):
    """One row per message in every array, and whole stamps."""
    names = [field.name for field in fields(stream)] if is_dataclass(stream) else []
    values = [getattr(stream, name) for name in names] or list(stream)
    for value in values:
        assert len(value) <= count
    assert values[0].dtype == np.int64


@pytest.mark.parametrize("type_name", READERS)
def test_damaged_messages(type_name):
    good, unpack = sound_message(type_name), READERS[type_name]
    assert_arrays(unpack(good), 1)

    @bounded(CASES)
    @given(damaged(good) | st.binary(max_size=200))
    def check(data):
        with refusing("sample 0"):
            assert_arrays(unpack(data), 1)
        with refusing("sample 1"):
            assert_arrays(unpack(Payloads.join([good, data, good])), 3)

    check()


def test_every_type_of_the_project_is_here():
    known = {name for name in vars(sensor_messages).values() if isinstance(name, str) and "/msg/" in name}
    # Motor commands are read by an adapter, which has a test of its own below.
    read = READERS.keys() | {sensor_messages.MOTOR_COMMANDS}
    assert {name for name in known if name.startswith("quadpi/")} <= read


@pytest.mark.parametrize(
    ("name", "definitions"), [*((name, DEFINITIONS) for name in known_adapters()), ("px4_status", PX4_1_18)]
)
def test_damaged_messages_of_other_packages(name, definitions):
    made = Messages(definitions)
    adapter, good = known_adapters()[name], EXAMPLES[name](made)
    definition = made.definition(adapter.type_name)
    assert len(adapter.open(definition, SETTINGS, None).unpack(good)) == 1

    @bounded(CASES)
    @given(damaged(good) | st.binary(max_size=200))
    def check(data):
        with refusing("sample 0"):
            assert_arrays(adapter.open(definition, SETTINGS, None).unpack(data), 1)
        with refusing("sample"):
            stream = adapter.open(definition, SETTINGS, None).unpack(Payloads.join([good, data, good]))
            assert_arrays(stream, 3)

    check()


@pytest.mark.parametrize("name", known_adapters())
def test_damaged_definitions_of_other_packages(name):
    made = Messages(DEFINITIONS)
    adapter, good = known_adapters()[name], EXAMPLES[name](made)
    definition = made.definition(adapter.type_name)

    @bounded(CASES)
    @given(damaged(definition.encode()))
    def check(data):
        with refusing():
            stream = adapter.open(data.decode(errors="replace"), SETTINGS, None).unpack(good)
            assert_arrays(stream, 1)

    check()
