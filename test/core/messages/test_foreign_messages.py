# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import struct

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.messages.definitions import ITEMS_MAX, codec, definition_text, foreign_codec, typestore
from quadpi_core.messages.payloads import Payloads

TRANSFORMS = "tf2_msgs/msg/TFMessage"
WANTED = (
    ("transforms.header.stamp.sec", 1),
    ("transforms.child_frame_id", 0),
    ("transforms.transform.rotation", 4),
)


def serialized(frames_of_messages, seed=0):
    """TFMessages, whose items begin with a text, by rosbags; and the rotations in them."""
    types, rng = typestore().types, np.random.default_rng(seed)
    payloads, rotations = [], []
    for frames in frames_of_messages:
        items = []
        for index, frame in enumerate(frames):
            rotations.append(rng.normal(size=4))
            transform = types["geometry_msgs/msg/Transform"](
                translation=types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0),
                rotation=types["geometry_msgs/msg/Quaternion"](*rotations[-1]),
            )
            stamp = types["builtin_interfaces/msg/Time"](sec=index, nanosec=0)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="map" * index)
            items.append(types["geometry_msgs/msg/TransformStamped"](header, frame, transform))
        payloads.append(bytes(typestore().serialize_cdr(types[TRANSFORMS](items), TRANSFORMS)))
    return payloads, np.reshape(rotations, (-1, 4))


def decode(payloads):
    made = foreign_codec(TRANSFORMS, definition_text(TRANSFORMS), WANTED)
    _, items = made.decode(payloads)
    return items["transforms"]


@pytest.mark.parametrize("text", ["", "a", "ab", "abc", "abcdefg", "åß"])
def test_every_alignment_agrees_with_rosbags(text):
    frames = [[text, text + "x", "b"]] * 5
    payloads, rotations = serialized(frames)
    items = decode(Payloads.join(payloads))
    np.testing.assert_array_equal(items.columns["transform.rotation"], rotations)
    assert items.columns["child_frame_id"].tolist() == [name.encode() for name in frames[0]] * 5
    assert items.columns["header.stamp.sec"].tolist() == [0, 1, 2] * 5


def test_counts_and_texts_that_change_keep_the_order():
    frames = [["a", "bc"], [], ["long name"], ["a", "bc"], ["x", "y", "z"], []]
    payloads, rotations = serialized(frames)
    items = decode(Payloads.join(payloads))
    assert items.counts.tolist() == [2, 0, 1, 2, 3, 0]
    assert items.message.tolist() == [0, 0, 2, 3, 3, 4, 4, 4]
    assert items.columns["child_frame_id"].tolist() == [name.encode() for each in frames for name in each]
    np.testing.assert_array_equal(items.columns["transform.rotation"], rotations)
    for payload, names in zip(payloads, frames, strict=True):
        assert decode(payload).columns["child_frame_id"].tolist() == [name.encode() for name in names]


def test_messages_that_are_cut_or_announce_too_much_are_refused():
    (payload,), _ = serialized([["a", "b"]])
    for cut in range(4, len(payload)):
        with pytest.raises(LogError, match="sample 0"):
            decode(payload[:cut])
    for count in (3, ITEMS_MAX, ITEMS_MAX + 1, 2**31, 2**32 - 1):
        with pytest.raises(LogError, match=f"sample 1: its {len(payload)} bytes are no tf2_msgs"):
            decode(Payloads.join([payload, payload[:4] + struct.pack("<I", count) + payload[8:]]))


def test_definitions_that_are_none_or_of_another_version_are_refused():
    with pytest.raises(LogError, match=r"has no field transforms\.rpm"):
        foreign_codec(TRANSFORMS, definition_text(TRANSFORMS), (("transforms.rpm", 1),))
    with pytest.raises(LogError, match=r"has no field transforms\.transform\.rotation"):
        foreign_codec(TRANSFORMS, definition_text(TRANSFORMS), (("transforms.transform.rotation", 3),))
    for broken in (
        "",
        "uint8",
        "Nothing[] x",
        "Self[] x\n" + "=" * 80 + "\nMSG: a/Self\nSelf[] y",
        "wstring x",
        "uint8 x\nint8 x",
        "Part[] x\n" + "=" * 80 + "\nMSG: a/Part\nuint8 y\nuint8 y",
    ):
        with pytest.raises(LogError) as caught:
            foreign_codec("a/msg/B", broken, (("x.y", 1),))
        assert len(str(caught.value)) < 200


def test_a_codec_of_plain_messages_takes_no_arrays_of_messages():
    with pytest.raises(TypeError, match="no codec for this kind of field"):
        codec(TRANSFORMS)
