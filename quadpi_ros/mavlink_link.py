# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Byte transports for MAVLink: serial port, UDP, TCP, or a telemetry log in real time."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple, TypeAlias

from quadpi_core.errors import QuadpiError, one_line, require_library
from quadpi_core.logs.formats.mavlink_tlog import read_records
from quadpi_core.results import (
    CAUSES,
    CHANGED_CENTRE_FORWARD,
    CHANGED_CENTRE_RIGHT,
    CHANGED_FORCE_FORWARD,
    CHANGED_FORCE_RIGHT,
    CHANGED_MASS,
    CHANGED_ROTOR,
    LEVEL_ALARM,
    UNCALIBRATED_WORDS,
    ReportedAlarms,
)

FORMS = "udp:HOST:PORT (listens), udpout:HOST:PORT, tcp:HOST:PORT, serial:DEVICE:BAUD, or a .tlog file"

_READ_BYTES = 65_536
_BUFFER_BYTES = 4 << 20
# Linux constant that the module socket lacks.
_SO_RCVBUFFORCE = 33
_CONNECT_TIMEOUT_S = 3.0


class LinkError(QuadpiError):
    """A connection cannot be opened, or is broken."""


class Chunk(NamedTuple):
    """Bytes received at once.

    Attributes:
        data: the bytes.
        arrival_ns: time of arrival, ns since 1970.
        complete: whether packets are whole within the chunk, as in a datagram.
        address: of the sender; None on a link with a single peer.
    """

    data: bytes
    arrival_ns: int
    complete: bool
    address: object = None


class SocketLink:
    """A UDP port that receives from anyone, one that sends first and receives from that peer only, or TCP.

    pymavlink's own links do not say who sent a datagram, answer everybody who has, and do not notice the end
    of a TCP connection.

    Args:
        kind: `udp` (listens), `udpout` or `tcp`.
        host: of this computer for `udp`, else of the peer.
        port: see host.
    """

    def __init__(self, kind: str, host: str, port: int) -> None:
        self._is_stream = kind == "tcp"
        self._listens = kind not in {"tcp", "udpout"}
        if self._is_stream:
            self._socket = socket.create_connection((host, port), _CONNECT_TIMEOUT_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            _widen(self._socket)
            (self._socket.bind if self._listens else self._socket.connect)((host, port))
        except OSError:
            self._socket.close()
            raise

    def read(self, timeout_s: float) -> Chunk | None:
        """The next bytes, of one datagram; None if nothing arrives within the timeout.

        Raises:
            LinkError: at the end of a TCP connection.
        """
        self._socket.settimeout(timeout_s)
        try:
            data, address = self._socket.recvfrom(_READ_BYTES)
        except (TimeoutError, ConnectionRefusedError):
            # Linux reports that nobody received our last datagram; the peer may start later.
            return None
        if self._is_stream and not data:
            raise LinkError("the other side closed the connection")
        return Chunk(data, time.time_ns(), complete=not self._is_stream, address=address)

    def write(self, data: bytes, address: object) -> None:
        """Send to the address of a chunk, or to the only peer; None while no peer is known."""
        with suppress(ConnectionRefusedError):
            if not self._listens:
                self._socket.sendall(data)
            elif isinstance(address, tuple):
                self._socket.sendto(data, address)

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()


def _widen(receiver: socket.socket) -> None:
    """Enlarge the receive buffer to seconds of packets, beyond the system's limit if permitted."""
    try:
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)


class SerialLink:
    """A serial port."""

    def __init__(self, device: str, baud: int) -> None:
        serial = require_library("serial", "mavlink")
        self._port = serial.Serial(device, baud, timeout=0.0, write_timeout=1.0, exclusive=True)

    def read(self, timeout_s: float) -> Chunk | None:
        """The next bytes; None if nothing arrives within the timeout."""
        self._port.timeout = timeout_s
        data = self._port.read(max(1, self._port.in_waiting))
        return Chunk(data, time.time_ns(), complete=False) if data else None

    def write(self, data: bytes, _: object) -> None:
        """Send."""
        self._port.write(data)

    def close(self) -> None:
        """Close the port."""
        self._port.close()


class ReplayLink:
    """A telemetry log that delivers each packet when it is due, with the arrival time of the log."""

    def __init__(self, path: Path) -> None:
        self._records = iter(
            [(one.arrival_ns, bytes(one.message.get_msgbuf())) for one in read_records(path)]
        )
        self._next = next(self._records, None)
        self._ahead_ns: int | None = None

    def read(self, timeout_s: float) -> Chunk | None:
        """The next packet; None if it is not due within the timeout.

        Raises:
            EOFError: after the last.
        """
        if self._next is None:
            raise EOFError
        arrival_ns, packet = self._next
        if self._ahead_ns is None:
            # The first packet is due at the first read.
            self._ahead_ns = arrival_ns - time.monotonic_ns()
        wait_s = (arrival_ns - self._ahead_ns - time.monotonic_ns()) * 1e-9
        time.sleep(min(max(wait_s, 0.0), timeout_s))
        if wait_s > timeout_s:
            return None
        self._next = next(self._records, None)
        return Chunk(packet, arrival_ns, complete=True)

    def write(self, data: bytes, _: object) -> None:
        """Do nothing: a log has no peer."""

    def close(self) -> None:
        """Do nothing."""


Link: TypeAlias = SocketLink | SerialLink | ReplayLink


def is_replay(connection: str) -> bool:
    """Whether a connection string is the path of a telemetry log."""
    return connection.lower().endswith(".tlog")


def check_connection(connection: str) -> None:
    """Refuse an invalid connection string.

    Raises:
        LinkError: naming the valid forms.
    """
    if not is_replay(connection):
        _parts(connection)


def open_link(connection: str) -> Link:
    """Open a connection by its string (see :data:`FORMS`).

    Raises:
        LinkError: naming the connection and the reason.
        LogError: for a telemetry log without packets, or if pyserial is not installed.
    """
    try:
        if is_replay(connection):
            return ReplayLink(Path(connection))
        kind, place, number = _parts(connection)
        return SerialLink(place, number) if kind == "serial" else SocketLink(kind, place, number)
    except OSError as error:  # pyserial's errors are of this kind too
        raise LinkError(f"{connection}: {one_line(error)}") from error


def _parts(connection: str) -> tuple[str, str, int]:
    kind, _, rest = connection.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in {"udp", "udpin", "udpout", "tcp", "serial"} or not place or not number.isdecimal():
        raise LinkError(f"connection `{connection}` is none of {FORMS}")
    if kind != "serial" and not 0 < int(number) < 65_536:
        raise LinkError(f"connection `{connection}`: {number} is no port")
    return kind, place, int(number)


# Source: mavlink.io, common message set: STATUSTEXT (253), NAMED_VALUE_FLOAT (251).

# Bytes of a STATUSTEXT, and severities of MAVLink: a failure that needs care, and what is normal but worth a
# word.
_TEXT_BYTES, _CRITICAL, _NOTICE = 50, 2, 5
# Reasons of an alarm that are told, the first ones.
_REASONS = 2
# A cause that comes again sooner [ns] is told after that long, if it stands then; a number at most so often.
_AGAIN_NS, _NUMBER_NS = 5_000_000_000, 1_000_000_000
# Names of at most ten letters, with the unit, and the factor to it.
_NUMBERS = {
    CHANGED_MASS: ("add_g", 1e3),
    CHANGED_FORCE_FORWARD: ("push_fwd_N", 1.0),
    CHANGED_FORCE_RIGHT: ("push_rgt_N", 1.0),
    CHANGED_CENTRE_FORWARD: ("cg_fwd_mm", 1e3),
    CHANGED_CENTRE_RIGHT: ("cg_rgt_mm", 1e3),
    CHANGED_ROTOR: ("rotor{}_pc", 1e2),
}


class Text(NamedTuple):
    """A piece of a STATUSTEXT."""

    severity: int
    text: bytes
    number: int  # of the text, the same for its pieces
    piece: int


class Number(NamedTuple):
    """A NAMED_VALUE_FLOAT."""

    name: bytes
    value: float


class AlarmTold:
    """Follows alarm messages, which repeat at a steady rate, and tells what is new."""

    def __init__(self) -> None:
        # What was told, and stands.
        self._standing: set[object] = set()
        self._told_ns: dict[object, int] = {}
        self._number_ns = 0
        self._texts = 0

    def take(self, alarms: ReportedAlarms, now_ns: int) -> Iterator[Text | Number]:
        """What is to be sent because of alarm messages."""
        for row in range(len(alarms)):
            levels, reasons = zip(CAUSES, alarms.cause_level[row], strict=True), alarms.reasons[row]
            raised: set[object] = {cause for cause, level in levels if level == LEVEL_ALARM}
            kind, rotor = int(alarms.changed[row]), int(alarms.changed_rotor[row])
            if kind in _NUMBERS:
                # What has changed may be named anew while the alarm stands.
                raised.add(("change", kind, rotor))
            # In the future is what was told before the clock was set back.
            if any(
                one not in self._told_ns or not 0 <= now_ns - self._told_ns[one] < _AGAIN_NS
                for one in raised - self._standing
            ):
                self._standing = raised
                self._told_ns |= dict.fromkeys(raised, now_ns)
                told = [text for text in reasons if text != UNCALIBRATED_WORDS][:_REASONS]
                told += ["uncalibrated"] if UNCALIBRATED_WORDS in reasons else []
                yield from self._text(_CRITICAL, "ALARM: " + "; ".join(told))
            elif self._standing and not raised:
                yield from self._text(_NOTICE, "quadpi: the alarm is over")
            self._standing = self._standing & raised
            if kind in _NUMBERS and not 0 <= now_ns - self._number_ns < _NUMBER_NS:
                self._number_ns = now_ns
                name, factor = _NUMBERS[kind]
                yield Number(name.format(rotor).encode(), factor * float(alarms.change_size[row]))

    def _text(self, severity: int, words: str) -> Iterator[Text]:
        """A text in pieces, of which a zero ends the last; old ground stations know ASCII alone."""
        whole = words.replace("±", "+-").encode("ascii", "replace")
        self._texts = self._texts % 0xFFFF + 1
        for piece, start in enumerate(range(0, len(whole) + 1, _TEXT_BYTES)):
            yield Text(severity, whole[start : start + _TEXT_BYTES], self._texts, piece)
