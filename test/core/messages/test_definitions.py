# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions of messages: what a bag embeds, what a codec makes of them, and which rosbags never sees."""

import re

import pytest
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from quadpi_core.messages.definitions import (
    codec,
    definition_text,
    parse_definition,
    parsed_definition,
    typestore,
)
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.topics import TOPIC_TYPES
from quadpi_core.paths import message_directory

OWN = sorted(path.stem for path in message_directory().glob("*.msg"))


def test_own_messages_are_known_beside_those_of_ros():
    assert len(OWN) >= 5
    assert {f"quadpi/msg/{name}" for name in OWN} <= set(typestore().types)
    assert set(get_typestore(Stores.ROS2_JAZZY).types) <= set(typestore().types)


@pytest.mark.parametrize("type_name", sorted(set(TOPIC_TYPES.values())))
def test_a_program_without_our_packages_reads_the_embedded_definition(type_name):
    found = get_types_from_msg(definition_text(type_name), type_name)
    known = typestore().fielddefs
    assert {name: fields for name, (_, fields) in found.items()} == {name: known[name][1] for name in found}
    contained = {text for _, fields in found.values() for text in re.findall(r"'(\w+/msg/\w+)'", str(fields))}
    assert contained <= set(found)


def test_own_definitions_travel_with_units_and_contained_types():
    text = definition_text("quadpi/msg/Erpm")
    assert "[rev/min]" in text
    assert "MSG: std_msgs/Header" in text
    assert "MSG: builtin_interfaces/Time" in text


def shapes(type_name):
    """Shape and type of each column that a codec decodes."""
    columns = codec(type_name).decode(Payloads.join([]))
    return {name: (column.shape[1:], column.dtype.str) for name, column in columns.items()}


def test_columns_of_a_codec_are_whole_vectors():
    """A vector, a covariance, an array by axis: one array each."""
    imu = shapes("sensor_msgs/msg/Imu")
    assert imu["header.stamp.sec"] == ((), "<i4")
    assert imu["header.stamp.nanosec"] == ((), "<u4")
    assert imu["orientation"] == ((4,), "<f8")
    assert imu["angular_velocity"] == ((3,), "<f8")
    assert imu["linear_acceleration_covariance"] == ((9,), "<f8")
    prediction = shapes("quadpi/msg/WrenchPrediction")
    wrenches = ("predicted", "lower", "upper", "measured")
    vectors = [f"{name}.{part}" for name in wrenches for part in ("force", "torque")]
    assert {prediction[name] for name in vectors} == {((3,), "<f8")}
    assert prediction["relative_width"] == ((6,), "<f8")
    assert prediction["axes"] == ((), "|u1")


@pytest.mark.parametrize(
    ("type_name", "text"),
    [
        ("a/msg/B; import os", "uint8 x"),
        ("B", "uint8 x"),
        ("a/msg/B", "string[1025] x"),
        ("a/msg/B", "Part[1025] x\n" + "=" * 80 + "\nMSG: a/Part\nuint8 y"),
        ("a/msg/B", "uint8 = 3 3 3"),
    ],
)
def test_definitions_of_others_that_would_run_or_grow_are_refused(type_name, text):
    """rosbags executes code that it makes of names, and repeats it for each item of a fixed array."""
    with pytest.raises(TypesysError):
        parsed_definition(type_name, text)


def test_definitions_of_others_up_to_1024_items_are_read():
    types = parsed_definition(
        "a/msg/B", "string[1024] x\nfloat64[2000] y\nPart[] z\n" + "=" * 80 + "\nMSG: a/Part\nuint8 w"
    )
    assert set(types) == {"a/msg/B", "a/msg/Part"}
    assert [name for name, _ in types["a/msg/B"][1]] == ["x", "y", "z"]


def test_a_separator_with_no_type_behind_it_is_refused():
    with pytest.raises(ValueError, match="no type behind it"):
        parse_definition("a/msg/B", "float64 value\n====\n====\nMSG: a/C\nfloat64 other\n")
