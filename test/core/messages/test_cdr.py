# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from quadpi_core.errors import LogError, SampleError
from quadpi_core.messages.definitions import codec, typestore
from quadpi_core.messages.payloads import Payloads

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
