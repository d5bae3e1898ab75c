# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink packets out of bytes: noise, cuts, both versions, signatures, the messages that pymavlink lacks."""

from __future__ import annotations

import random
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from quadpi_core.logs import mavlink_frames
from quadpi_core.logs.mavlink_frames import Framer, packet_length, signature_stamp, signing_key

LONGEST = 10 + 255 + 2 + 13


def attitude(sender: Any, number: int, version: int = 2) -> bytes:
    return sender.packet("ATTITUDE", number, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, version=version)


def numbers(framer: Framer, data: bytes, step: int = 0) -> list[int]:
    """The attitudes in a whole stream, given in pieces or as one datagram."""
    pieces = [data[at : at + step] for at in range(0, len(data), step)] if step else []
    found = [message for piece in pieces for message in framer.feed(piece)]
    found += framer.feed(b"" if step else data, complete=True)
    return [message.time_boot_ms for message in found if message.get_type() == "ATTITUDE"]


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("step", [1, 7, 1000])
def test_packets_are_found_however_the_stream_is_cut(mavlink_sender: Any, version: int, step: int) -> None:
    sender, framer = mavlink_sender(), Framer()
    stream = b"".join(attitude(sender, number, version) for number in range(300))
    assert numbers(framer, stream, step) == list(range(300))
    assert framer.counts.frames == 300
    assert (framer.counts.lost, framer.counts.noise_bytes, framer.counts.checksum_errors) == (0, 0, 0)


def test_no_packet_is_lost_to_noise_before_it(mavlink_sender: Any) -> None:
    sender, framer = mavlink_sender(), Framer()
    first, second, third = (attitude(sender, number) for number in range(3))
    # A marker with the largest length: a parser that trusts it would swallow what follows.
    noise = b"\xfd\xff\x00abc"
    assert numbers(framer, noise + first + second[:-5] + noise + third) == [0, 2]
    assert framer.counts.noise_bytes == 2 * len(noise) + len(second) - 5
    assert framer.counts.lost == 1


@pytest.mark.parametrize("damage", ["lost byte", "noise"])
def test_packets_are_found_that_pymavlink_drops(mavlink_sender: Any, damage: str) -> None:
    """Why the search is our own: pymavlink drops up to 280 bytes after a marker, and packets among them."""
    sender, rng, count = mavlink_sender(), random.Random(1), 2000
    packets = [attitude(sender, number) for number in range(count)]
    if damage == "noise":
        stream, sent = b"".join(rng.randbytes(20) + packet for packet in packets), list(range(count))
    else:
        places = [rng.randrange(10, len(packets[0])) if number % 10 == 0 else 99 for number in range(count)]
        cut = [packet[:at] + packet[at + 1 :] for packet, at in zip(packets, places, strict=True)]
        stream, sent = b"".join(cut), [number for number in range(count) if number % 10]
    parser = Framer().mav
    parser.robust_parsing = True
    parsed = parser.parse_buffer(stream)
    assert sum(message.get_type() == "ATTITUDE" for message in parsed) < 0.9 * len(sent)
    assert numbers(Framer(), stream) == sent


@settings(max_examples=200, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=60), st.just(None)), max_size=12), st.integers(1, 50))
def test_any_noise_leaves_every_packet(mavlink_sender: Any, parts: list[bytes | None], step: int) -> None:
    """Unless the noise is a packet itself, which a checksum of 16 bits lets pass once in 65 000."""
    sender, framer = mavlink_sender(), Framer()
    stream, sent = b"", 0
    for part in parts:
        if part is None:
            stream += attitude(sender, sent)
            sent += 1
        else:
            stream += part.replace(b"\xfe", b"").replace(b"\xfd", b"\xfd\x80")
    assert numbers(framer, stream, step) == list(range(sent))


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=600))
def test_nothing_breaks_on_any_bytes(data: bytes) -> None:
    framer = Framer()
    framer.feed(data, complete=True)
    assert framer.feed(b"", complete=True) == []
    decoded = framer.counts.frames + framer.counts.unknown
    assert decoded or framer.counts.noise_bytes == len(data)


@pytest.mark.parametrize("complete", [True, False])
@pytest.mark.parametrize(
    "noise",
    [
        bytes([0xFD]),
        bytes([0xFE]),
        bytes([0xFD, 0xFF, 0]),
        bytes([0xFD, 0xFE]),
        # Headers of ATTITUDE, version 1, and of ESC_STATUS, version 2, one upon another.
        bytes([0xFE, 28, 0, 1, 1, 30]),
        bytes([0xFD, 56, 0, 0, 0, 1, 1, 0x23, 1, 0]),
        bytes(200) + bytes([0xFD]),
    ],
)
def test_noise_costs_in_proportion_to_its_length(
    noise: bytes, complete: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever it is made of, each byte begins one packet at most."""
    data = (noise * 70_000)[:65_507]
    begun: list[int] = []

    def counted(buffer: bytearray, position: int) -> int:
        begun.append(position)
        return packet_length(buffer, position)

    monkeypatch.setattr(mavlink_frames, "packet_length", counted)
    framer = Framer()
    framer.feed(data, complete=complete)
    assert len(begun) == len(set(begun))
    counts = framer.counts
    noise_bytes = counts.noise_bytes
    framer.feed(b"", complete=True)
    assert counts.noise_bytes - noise_bytes <= (0 if complete else LONGEST)
    assert counts.unknown or counts.noise_bytes == len(data)
    # A row of markers looks like no packet.
    assert counts.checksum_errors == 0 or len(noise) > 1


def test_a_packet_by_itself_is_read_from_end_to_end(mavlink_sender: Any) -> None:
    """As in a telemetry log, where the place of each is known."""
    whole, framer, messages = bytearray(attitude(mavlink_sender(), 7)), Framer(), []
    assert packet_length(whole, 0) == len(whole)
    assert framer.read(whole, messages)
    assert not framer.read(whole[:20] + b"?" + whole[21:], messages)
    assert [message.time_boot_ms for message in messages] == [7]
    assert framer.counts.frames == 1


def test_lost_packets_are_counted_and_a_restart_is_none(mavlink_sender: Any) -> None:
    sender, framer = mavlink_sender(), Framer()
    packets = [attitude(sender, number) for number in range(10)]
    framer.feed(b"".join(packets[:3] + packets[7:]))
    assert framer.counts.lost == 4
    framer.feed(b"".join(packets[:1]))
    assert framer.counts.lost == 4


def test_signatures_are_checked_with_a_key_and_ignored_without(mavlink_sender: Any) -> None:
    key = signing_key("secret")
    framer = Framer(key)
    signed, unsigned, forged = (
        mavlink_sender(key=key),
        mavlink_sender(),
        mavlink_sender(key=signing_key("guess")),
    )
    for sender in (signed, forged):
        sender.mav.signing.timestamp = int(2e14)
    # What a forger claims about the time does not keep the right sender out.
    forged.mav.signing.timestamp = int(2.5e14)
    first, second, third = (attitude(signed, number) for number in (1, 2, 3))
    stream = first + attitude(unsigned, 7) + attitude(forged, 8) + second
    assert numbers(framer, stream + first + third) == [1, 2, 3]
    assert framer.counts.refused_signatures == 3  # unsigned, forged and played again
    assert framer.counts.noise_bytes == 0
    assert numbers(Framer(), stream) == [1, 7, 8, 2]


@pytest.mark.parametrize(("age_s", "found"), [(59, [1]), (61, []), (10**8, [])])
def test_a_new_sender_may_sign_a_minute_late(mavlink_sender: Any, age_s: int, found: list[int]) -> None:
    key, now = signing_key("secret"), 1_700_000_000.0
    sender = mavlink_sender(key=key)
    sender.mav.signing.timestamp = signature_stamp(now - age_s)
    assert numbers(Framer(key, now), attitude(sender, 1)) == found
