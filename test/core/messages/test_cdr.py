# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import re

import numpy as np
import pytest
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore

from quadpi_core.errors import LogError, SampleError
from quadpi_core.messages.definitions import (
    codec,
    definition_text,
    parse_definition,
    parsed_definition,
    typestore,
)
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.topics import TOPIC_TYPES, qos_of
from quadpi_core.paths import message_directory
from quadpi_core.results import EVENTS_KEPT

TRANSFORM = "geometry_msgs/msg/TransformStamped"
ALARM = "quadpi/msg/ExtrapolationAlarm"
ROTORS = "quadpi/msg/RotorSpeeds"


def transforms(frame_ids, seed=0):
    """Serialized by rosbags: two strings before numbers, so that their lengths move the numbers."""
    types = typestore().types
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(len(frame_ids), 7))
    messages = []
    for sample, (frame_id, row) in enumerate(zip(frame_ids, values, strict=True)):
        stamp = types["builtin_interfaces/msg/Time"](sec=sample - 2, nanosec=7 * sample)
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)
        transform = types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](*row[:3]),
            rotation=types["geometry_msgs/msg/Quaternion"](*row[3:]),
        )
        message = types[TRANSFORM](header=header, child_frame_id=frame_id[::-1] + "x", transform=transform)
        messages.append(bytes(typestore().serialize_cdr(message, TRANSFORM)))
    return messages, values


@pytest.mark.parametrize("frame_id", ["", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg", "åß"])
def test_every_alignment_agrees_with_rosbags(frame_id):
    messages, values = transforms([frame_id] * 5)
    columns = codec(TRANSFORM).decode(Payloads.join(messages))
    np.testing.assert_array_equal(columns["transform.translation"], values[:, :3])
    np.testing.assert_array_equal(columns["transform.rotation"], values[:, 3:])
    np.testing.assert_array_equal(columns["header.stamp.sec"], np.arange(5) - 2)
    np.testing.assert_array_equal(columns["header.stamp.nanosec"], 7 * np.arange(5))
    one = codec(TRANSFORM).decode(messages[2])
    np.testing.assert_array_equal(one["transform.rotation"], values[2:3, 3:])
    encoded = codec(TRANSFORM).encode(
        5,
        {
            "header.stamp.sec": columns["header.stamp.sec"],
            "header.stamp.nanosec": columns["header.stamp.nanosec"],
            "header.frame_id": frame_id,
            "child_frame_id": frame_id[::-1] + "x",
            "transform.translation": values[:, :3],
            "transform.rotation": values[:, 3:],
        },
    )
    assert list(encoded) == messages


def test_lengths_that_change_within_a_topic_keep_the_order():
    frame_ids = ["map", "odom", "map", "m", "earth", "odom", "abc"]
    messages, values = transforms(frame_ids)
    columns = codec(TRANSFORM).decode(Payloads.join(messages))
    np.testing.assert_array_equal(columns["transform.translation"], values[:, :3])
    assert columns["header.frame_id"].tolist() == [frame_id.encode() for frame_id in frame_ids]


def test_equal_size_with_other_string_lengths_is_told_apart():
    codec_ = codec(TRANSFORM)
    texts = [("ab", "abcdef"), ("abcdef", "ab")]
    parts = [
        codec_.encode(1, {"header.frame_id": frame, "child_frame_id": child, "transform.translation": number})
        for number, (frame, child) in enumerate(texts, start=1)
    ]
    messages = [part[0] for part in parts]
    assert len(messages[0]) == len(messages[1])
    columns = codec_.decode(Payloads.join([messages[0], messages[1], messages[0]]))
    assert columns["transform.translation"][:, 0].tolist() == [1.0, 2.0, 1.0]


@pytest.mark.parametrize("count", [0, 1, 4, 6])
@pytest.mark.parametrize("frame_id", ["", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg"])
def test_sequences_of_numbers_agree_with_rosbags(frame_id, count):
    values = np.random.default_rng(count).normal(size=(3, count))
    columns = {"header.frame_id": frame_id, "header.stamp.sec": [1, 2, 3], "rotor_speeds": values}
    encoded = codec(ROTORS).encode(3, columns)
    for message, row in zip(encoded, values, strict=True):
        reference = typestore().deserialize_cdr(message, ROTORS)
        np.testing.assert_array_equal(reference.rotor_speeds, row)
        assert bytes(typestore().serialize_cdr(reference, ROTORS)) == message
    np.testing.assert_array_equal(codec(ROTORS).decode(encoded)["rotor_speeds"], values)
    np.testing.assert_array_equal(codec(ROTORS).decode_stamped(encoded, {"rotor_speeds": count})[1], values)


def test_a_sequence_of_another_length_is_refused_by_its_sample():
    parts = [codec(ROTORS).encode(2, {"rotor_speeds": np.ones((2, count))}) for count in (4, 6)]
    joined = Payloads.concatenate(parts)
    with pytest.raises(SampleError, match="sample 2: `rotor_speeds` holds 6 values, expected 4"):
        codec(ROTORS).decode(joined)
    with pytest.raises(SampleError, match="sample 0: `rotor_speeds` holds 4 values, expected 6"):
        codec(ROTORS).decode_stamped(joined, {"rotor_speeds": 6})


@pytest.mark.parametrize("padding", [1, 2, 3])
def test_trailing_padding_of_a_middleware_is_ignored(padding):
    messages, values = transforms(["map"] * 3)
    padded = Payloads.join([message + bytes(padding) for message in messages])
    np.testing.assert_array_equal(codec(TRANSFORM).decode(padded)["transform.translation"], values[:, :3])


def test_sequences_of_strings_agree_with_rosbags():
    names = [(), ("u",), ("omega_avg", "v"), ("v",), ()]
    encoded = Payloads.concatenate(
        [
            codec(ALARM).encode(1, {"header.frame_id": "b", "width": np.arange(6.0), "inputs_outside": row})
            for row in names
        ]
    )
    for message, row in zip(encoded, names, strict=True):
        reference = typestore().deserialize_cdr(message, ALARM)
        assert tuple(reference.inputs_outside) == row
        assert bytes(typestore().serialize_cdr(reference, ALARM)) == message
    decoded = codec(ALARM).decode(encoded)["inputs_outside"]
    assert [tuple(name.decode() for name in row) for row in decoded] == names


def test_no_messages_decode_to_empty_columns():
    columns = codec(TRANSFORM).decode(Payloads.join([]))
    assert columns["transform.rotation"].shape == (0, 4)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda message: message[:-1], "bytes"),
        (lambda message: message[:10], "are no geometry_msgs/msg/TransformStamped"),
        (lambda message: message + bytes(4), "takes"),
        (lambda message: b"\x00\x00" + message[2:], "not little-endian CDR"),
        (lambda message: message[:12] + b"\xff\xff\xff\xff" + message[16:], "are no"),
        (lambda _: b"", "not little-endian CDR"),
    ],
)
def test_damaged_message_is_named_by_its_sample(damage, reason):
    messages, _ = transforms(["map"] * 4)
    messages[2] = damage(messages[2])
    with pytest.raises(LogError, match=rf"sample 2: .*{reason}"):
        codec(TRANSFORM).decode(Payloads.join(messages))


def test_stamped_messages_move_their_numbers_at_once():
    messages, values = transforms(["map", "m", "map"])
    kind = codec(TRANSFORM)
    stamps, numbers = kind.decode_stamped(Payloads.join(messages))
    np.testing.assert_array_equal(stamps, np.array([-2, -1, 0]) * 1_000_000_000 + [0, 7, 14])
    np.testing.assert_array_equal(numbers, values)
    assert kind.places == {"transform.translation": slice(0, 3), "transform.rotation": slice(3, 7)}
    for sample, message in enumerate(messages):
        one = kind.decode_stamped(message)
        assert (one[0][0], one[1].tolist()) == (stamps[sample], [values[sample].tolist()])
        frame_id = "m" if sample == 1 else "map"
        texts = (("header.frame_id", frame_id), ("child_frame_id", frame_id[::-1] + "x"))
        assert list(kind.encode_stamped(*one, texts)) == [message]
    texts = (("header.frame_id", "map"), ("child_frame_id", "pamx"))
    assert list(kind.encode_stamped(stamps[::2], values[::2], texts)) == messages[::2]


def test_a_stamp_beyond_its_second_is_named():
    messages, _ = transforms(["map"] * 3)
    broken = bytearray(messages[1])
    broken[8:12] = (2_000_000_000).to_bytes(4, "little")
    for payloads in (bytes(broken), Payloads.join([messages[0], bytes(broken)])):
        with pytest.raises(LogError, match=r"sample [01]: the stamp has 2000000000 ns"):
            codec(TRANSFORM).decode_stamped(payloads)


# Definitions of messages: what a bag embeds, what a codec makes of them, and which rosbags never sees.


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


# The standard topics: their types exist, and what is offered on each is what bags and nodes declare.


def test_every_type_is_one_that_messages_are_made_of():
    assert set(TOPIC_TYPES.values()) <= set(typestore().types)


@pytest.mark.parametrize(
    ("topic", "depth", "reliable", "latched"),
    [
        # Two seconds of an IMU of 500 Hz.
        ("imu", 1000, False, False),
        ("mocap/pose", 1000, False, False),
        ("anything/else", 1000, False, False),
        ("odometry", 200, True, False),
        ("prediction", 200, True, False),
        ("wrench/predicted", 200, True, False),
        ("wrench/residual", 200, True, False),
        ("extrapolation_alarm", 200, True, False),
        ("alarm_log", EVENTS_KEPT, True, True),
    ],
)
def test_sensors_are_best_effort_results_reliable_and_the_log_is_kept(topic, depth, reliable, latched):
    """A reliable subscription gets nothing of a best-effort publisher, and says nothing."""
    profile = qos_of(topic).profile()
    assert profile.depth == depth
    assert (profile.reliability == QosReliability.RELIABLE) is reliable
    assert (profile.durability == QosDurability.TRANSIENT_LOCAL) is latched
