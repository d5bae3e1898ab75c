# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where MAVLink packets begin in a stream of bytes; pymavlink checks and decodes them.

pymavlink's own parser drops as many bytes as the packet that it expected has, whatever follows a lost byte.
Over a serial link that loses one byte in 10 000, it drops 1.02 % of the packets that arrived whole (of
192 600, with 72 bytes on average), and with 20 random bytes before each packet 32 %; this search drops
0.004 % and none. Of wrong bytes, not lost ones, it would not be worth a search: 0.03 %.

Source: mavlink.io, "Packet Serialization" and "Message Signing".
"""

from __future__ import annotations

import hashlib
import re
import struct
import time
from collections import Counter
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.errors import require_library

_V2_MARKER = 0xFD
MARKERS = (_V2_MARKER, 0xFE)
# Possible start of a packet; one of version 2 has only known flags, as far as its bytes have arrived.
PACKET_BEGIN = re.compile(rb"\xfd(?:.?\Z|.[\x00\x01])|\xfe", re.DOTALL)
# Header and checksum of either version, signature, and the longest packet.
_V2_BYTES, _V1_BYTES, _SIGNATURE_BYTES, _LONGEST = 12, 8, 13, 280
_SIGNED = 0x01
_SEQUENCES = 256
# A larger step in the sequence means that the sender has restarted.
_LOST_AT_MOST = 128
# Signature stamps count units of 10 µs since 2015.
_SIGNATURE_EPOCH_S = 1_420_070_400
_SIGNATURE_UNITS_PER_S = 100_000
# How packets name their sender: a companion computer of no certain vehicle.
_OWN_SYSTEM, _COMPANION = 255, 191


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


def signature_stamp(seconds: float) -> int:
    """Signature stamp of a time in seconds since 1970."""
    return int((seconds - _SIGNATURE_EPOCH_S) * _SIGNATURE_UNITS_PER_S)


def signing_key(passphrase: str) -> bytes:
    """Key that ground stations derive from a passphrase: its SHA-256."""
    return hashlib.sha256(passphrase.encode()).digest()


class Framer:
    """Splits a stream of bytes, or datagrams, into the messages of pymavlink.

    Args:
        key: 32 bytes to sign with; packets without a valid and newer signature are refused. None: signatures
            are ignored.
        now: seconds since 1970; signatures of new senders must not be older than a minute.

    Attributes:
        counts: what was seen, of all senders.
        lost: packets missing of each sender, by system and component.
        mav: pymavlink's protocol, also to pack what is sent.
    """

    def __init__(self, key: bytes | None = None, now: float | None = None) -> None:
        dialect = load_dialect()
        self.counts = FrameCounts()
        self.mav = dialect.MAVLink(None, _OWN_SYSTEM, _COMPANION)
        if key is not None:
            self.mav.signing.secret_key = key
            self.mav.signing.sign_outgoing = True
            self.mav.signing.allow_unsigned_callback = lambda *_: False
            self.mav.signing.timestamp = signature_stamp(time.time() if now is None else now)
        self._error: type[Exception] = dialect.MAVError
        self._sizes = {number: kind.unpacker.size for number, kind in dialect.mavlink_map.items()}
        self._buffer = bytearray()
        self.lost: Counter[tuple[int, int]] = Counter()
        self._sequence: dict[tuple[int, int], int] = {}

    def feed(self, data: bytes, *, complete: bool = False) -> list[Any]:
        """Messages completed by new bytes, without those of unknown types and refused signatures.

        Args:
            data: received bytes.
            complete: whether no packet continues after them, as in a datagram or at the end of a file.
        """
        buffer = self._buffer
        buffer += data
        messages: list[Any] = []
        position = 0
        while begin := PACKET_BEGIN.search(buffer, position):
            start = begin.start()
            end = start + packet_length(buffer, start)
            is_whole = end <= len(buffer)
            if not is_whole and not complete:
                break
            found = is_whole and self.read(buffer[start:end], messages, buffer[end : end + 1])
            self.counts.noise_bytes += start - position + (not found)
            position = end if found else start + 1
        kept = begin.start() if begin else len(buffer)
        self.counts.noise_bytes += kept - position
        del buffer[:kept]
        return messages

    def read(self, packet: bytearray, messages: list[Any], follows: bytes | bytearray = b"") -> bool:
        """Whether exactly these bytes are a packet; its message is appended as :meth:`feed` would give it.

        Args:
            packet: from a marker on, as long as it says.
            messages: to append to.
            follows: what comes behind it, for messages whose checksum cannot be verified.
        """
        is_v1 = packet[0] != _V2_MARKER
        size = self._sizes.get(packet[5] if is_v1 else int.from_bytes(packet[7:10], "little"))
        if size is None:
            # Of an unknown message: require another packet behind it instead of the checksum.
            is_packet = not follows or follows[0] in MARKERS
            self.counts.unknown += is_packet
            return is_packet
        if is_v1 and packet[1] > size:
            # Only version 2 allows extension fields. A run of marker bytes would look like such packets.
            return False
        signing = self.mav.signing
        stamps = dict(signing.stream_timestamps)
        try:
            message = self.mav.decode(packet)
        except self._error:
            # pymavlink keeps the stamp of a forged packet, which would shut out the right sender.
            signing.stream_timestamps = stamps
            if signing.reject_count == self.counts.refused_signatures:
                self.counts.checksum_errors += 1
                return False
            self.counts.refused_signatures = signing.reject_count
        else:
            self._count_lost(message)
            messages.append(message)
        self.counts.frames += 1
        return True

    def _count_lost(self, message: Any) -> None:
        sender, sequence = (message.get_srcSystem(), message.get_srcComponent()), message.get_seq()
        missing = (sequence - self._sequence.get(sender, sequence - 1) - 1) % _SEQUENCES
        if missing < _LOST_AT_MOST:
            self.counts.lost += missing
            self.lost[sender] += missing
        self._sequence[sender] = sequence


def packet_length(data: bytes | bytearray, start: int) -> int:
    """Length of a packet by its header; of the longest one where the header is cut off."""
    if len(data) < start + 3:
        return _LONGEST
    marker, payload, flags = data[start : start + 3]
    if marker != _V2_MARKER:
        return _V1_BYTES + payload
    return _V2_BYTES + payload + _SIGNATURE_BYTES * (flags & _SIGNED)


# ESC_INFO (290) and ESC_STATUS (291) of common.xml are marked as work in progress there, so that pymavlink
# leaves them out; PX4 sends them. docs/esc_messages.xml defines them.

# "common" lacks ArduPilot's ESC telemetry, and "all" imports far more.
_DIALECT = "pymavlink.dialects.v20.ardupilotmega"


class _Definition(NamedTuple):
    """A message: `fields` are names in the order of the XML, each with its format for :mod:`struct`."""

    message_id: int
    name: str
    crc_extra: int
    fields: dict[str, str]


_ESC_INFO = _Definition(
    290,
    "ESC_INFO",
    251,
    {
        "index": "B",
        "time_usec": "Q",
        "counter": "H",
        "count": "B",
        "connection_type": "B",
        "info": "B",
        "failure_flags": "4H",
        "error_count": "4I",
        "temperature": "4h",
    },
)
_ESC_STATUS = _Definition(
    291, "ESC_STATUS", 10, {"index": "B", "time_usec": "Q", "rpm": "4i", "voltage": "4f", "current": "4f"}
)


def load_dialect() -> Any:
    """The module of pymavlink's message types, with ESC_INFO and ESC_STATUS added.

    Raises:
        LogError: if pymavlink is not installed.
    """
    dialect = require_library(_DIALECT, "mavlink")
    for definition in (_ESC_INFO, _ESC_STATUS):
        # A later pymavlink may bring its own.
        if definition.message_id not in dialect.mavlink_map:
            dialect.mavlink_map[definition.message_id] = _message_class(dialect, definition)
    return dialect


def _message_class(dialect: Any, definition: _Definition) -> Any:
    """What pymavlink's generator writes, as far as packing and parsing look at it."""
    message_id, name, crc_extra, fields = definition
    # On the wire, larger numbers come first.
    wire = sorted(fields, key=lambda field: -struct.calcsize(fields[field][-1]))

    def initialise(self: Any, *values: Any) -> None:
        dialect.MAVLink_message.__init__(self, message_id, name)
        self._fieldnames = list(fields)
        self.__dict__ |= dict(zip(fields, values, strict=True))

    def pack(self: Any, mav: Any, force_mavlink1: bool = False) -> Any:
        values = np.hstack([np.array(getattr(self, field), dtype=object) for field in wire])
        return self._pack(mav, crc_extra, self.unpacker.pack(*values), force_mavlink1=force_mavlink1)

    attributes = {
        "__init__": initialise,
        "pack": pack,
        "id": message_id,
        "msgname": name,
        "fieldnames": list(fields),
        "ordered_fieldnames": wire,
        "orders": [wire.index(field) for field in fields],
        "lengths": [int(fields[field][:-1] or 1) for field in wire],
        "crc_extra": crc_extra,
        "unpacker": struct.Struct("<" + "".join(fields[field] for field in wire)),
    }
    return type(f"MAVLink_{name.lower()}_message", (dialect.MAVLink_message,), attributes)
