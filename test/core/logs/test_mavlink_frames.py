# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink packets out of bytes: noise, cuts, both versions, signatures, the messages that pymavlink lacks."""

from __future__ import annotations

import random
import re
from collections import Counter
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from quadpi_core.logs import mavlink_frames
from quadpi_core.logs.mavlink_frames import (
    Framer,
    MessageDecoder,
    Verifier,
    frame_length,
    signature_stamp,
    signing_key,
)

LONGEST = 10 + 255 + 2 + 13


def attitude(sender: Any, number: int, version: int = 2) -> bytes:
    return sender.packet("ATTITUDE", number, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, version=version)


def numbers(framer: Framer, data: bytes, *, complete: bool = True) -> list[int]:
    decoder = MessageDecoder()
    return [decoder.decode(frame).time_boot_ms for frame in framer.feed(data, complete=complete)]


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("step", [1, 7, 1000])
def test_packets_are_found_however_the_stream_is_cut(mavlink_sender: Any, version: int, step: int) -> None:
    sender, framer = mavlink_sender(), Framer()
    stream = b"".join(attitude(sender, number, version) for number in range(300))
    found = []
    for start in range(0, len(stream), step):
        found += numbers(framer, stream[start : start + step], complete=False)
    assert found == list(range(300))
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


@pytest.mark.parametrize("noise", ["random bytes", "stray markers"])
def test_packets_after_noise_are_found_that_pymavlink_drops(mavlink_sender: Any, noise: str) -> None:
    """Why framing is our own: pymavlink drops up to 280 bytes after a marker, with the packets among them."""
    from pymavlink.dialects.v20 import common

    sender, rng, count = mavlink_sender(), random.Random(1), 2000
    stream = b""
    for number in range(count):
        stream += rng.randbytes(20) if noise == "random bytes" else b"\xfd"
        stream += attitude(sender, number)
    parser = common.MAVLink(None)
    parser.robust_parsing = True
    parsed = parser.parse_buffer(stream)
    while more := parser.parse_buffer(b""):
        parsed += more
    # 1 357 and 0 of them, as of pymavlink 2.4.
    assert sum(message.get_type() == "ATTITUDE" for message in parsed) < 0.8 * count
    assert numbers(Framer(), stream) == list(range(count))


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
    found = []
    for start in range(0, len(stream), step):
        found += numbers_of_attitudes(framer, stream[start : start + step], complete=False)
    found += numbers_of_attitudes(framer, b"", complete=True)
    assert found == list(range(sent))


def numbers_of_attitudes(framer: Framer, data: bytes, *, complete: bool) -> list[int]:
    frames = framer.feed(data, complete=complete)
    decoder = MessageDecoder()
    decoded = [decoder.decode(frame) for frame in frames]
    return [one.time_boot_ms for one in decoded if type(one).__name__ == "ATTITUDE"]


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=600))
def test_nothing_breaks_on_any_bytes(data: bytes) -> None:
    framer = Framer()
    for frame in framer.feed(data, complete=True):
        MessageDecoder().decode(frame)
    assert framer.feed(b"", complete=True) == []
    decoded = framer.counts.frames + framer.counts.unknown
    assert decoded or framer.counts.noise_bytes == len(data)


class Scanner:
    """The pattern that finds where a packet may begin; counts the bytes that it walks through."""

    def __init__(self, pattern: re.Pattern[bytes]) -> None:
        self.pattern = pattern
        self.scanned = 0

    def search(self, buffer: bytearray, start: int) -> re.Match[bytes] | None:
        found = self.pattern.search(buffer, start)
        self.scanned += (found.end() if found else len(buffer)) - start
        return found


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
    """Whatever it is made of: each byte is walked through once, and begins one packet at most."""
    data = (noise * 70_000)[:65_507]
    scanner = Scanner(mavlink_frames.PACKET_BEGIN)
    monkeypatch.setattr(mavlink_frames, "PACKET_BEGIN", scanner)
    headers: Counter[int] = Counter()

    def counted(buffer: bytearray, position: int) -> int | None:
        headers[position] += 1
        return frame_length(buffer, position)

    monkeypatch.setattr(mavlink_frames, "frame_length", counted)
    framer = Framer()
    framer.feed(data, complete=complete)
    assert headers.total() <= len(data)
    assert set(headers.values()) == {1}
    # The pattern looks up to three bytes ahead.
    assert scanner.scanned <= 3 * len(data)
    counts = framer.counts
    noise_bytes = counts.noise_bytes
    framer.feed(b"", complete=True)
    assert counts.noise_bytes - noise_bytes <= (0 if complete else LONGEST)
    assert counts.unknown or counts.noise_bytes == len(data)


def test_a_row_of_markers_looks_like_no_packet() -> None:
    framer = Framer()
    for marker in mavlink_frames.MARKERS:
        assert framer.feed(bytes([marker]) * 65_507, complete=True) == []
    assert framer.counts.checksum_errors == 0
    assert framer.counts.noise_bytes == 2 * 65_507


def test_a_packet_by_itself_is_read_from_end_to_end(mavlink_sender: Any) -> None:
    """As in a telemetry log, where the place of each is known."""
    whole, framer = attitude(mavlink_sender(), 7), Framer()
    frame = framer.packet(whole)
    assert frame
    assert MessageDecoder().decode(frame).time_boot_ms == 7
    for wrong in (b"", whole[:-1], whole + b"\0", b"\xfd" + whole, whole[:20] + b"?" + whole[21:]):
        assert framer.packet(wrong) is None
    assert framer.counts.frames == 1


def test_lost_packets_are_counted_and_a_restart_is_none(mavlink_sender: Any) -> None:
    sender, framer = mavlink_sender(), Framer()
    packets = [attitude(sender, number) for number in range(10)]
    framer.feed(b"".join(packets[:3] + packets[7:]))
    assert framer.counts.lost == 4
    framer.feed(b"".join(packets[:1]))
    assert framer.counts.lost == 4


def test_signed_packets_are_read_without_a_key(mavlink_sender: Any) -> None:
    sender, framer = mavlink_sender(key=signing_key("secret")), Framer()
    assert numbers(framer, attitude(sender, 1) + attitude(sender, 2)) == [1, 2]


def test_signatures_are_checked_with_a_key(mavlink_sender: Any) -> None:
    key = signing_key("secret")
    framer = Framer(Verifier(key))
    signed, unsigned, forged = (
        mavlink_sender(key=key),
        mavlink_sender(),
        mavlink_sender(key=signing_key("guess")),
    )
    for sender in (signed, forged):
        sender.mav.signing.timestamp = int(2e14)
    # What a forger claims about the time does not keep the right sender out.
    forged.mav.signing.timestamp = int(2.5e14)
    first, second = attitude(signed, 1), attitude(signed, 2)
    assert numbers(framer, first + attitude(unsigned, 7) + attitude(forged, 8) + second) == [1, 2]
    assert framer.counts.refused_signatures == 2
    assert numbers(framer, first + second) == []  # replayed
    assert framer.counts.refused_signatures == 4


def test_a_signature_of_long_ago_is_refused(mavlink_sender: Any) -> None:
    key = signing_key("secret")
    sender = mavlink_sender(key=key)
    sender.mav.signing.timestamp = 1000
    assert numbers(Framer(Verifier(key)), attitude(sender, 1)) == []


@pytest.mark.parametrize(("age_s", "found"), [(59, [1]), (61, [])])
def test_a_new_sender_may_sign_a_minute_late(mavlink_sender: Any, age_s: int, found: list[int]) -> None:
    key, now = signing_key("secret"), 1_700_000_000.0
    sender = mavlink_sender(key=key)
    sender.mav.signing.timestamp = signature_stamp(now - age_s)
    assert numbers(Framer(Verifier(key, now)), attitude(sender, 1)) == found
