# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Byte transports for MAVLink: serial port, UDP, TCP, or a telemetry log in real time."""

from __future__ import annotations

import socket
import time
from pathlib import Path
from typing import NamedTuple, Protocol

from quadpi_core.errors import LogError, QuadpiError, one_line, require_library
from quadpi_core.logs.formats.mavlink_tlog import TlogCounts, read_records

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


class Link(Protocol):
    """An open connection; every method raises LinkError when it is broken."""

    def read(self, timeout_s: float) -> Chunk | None:
        """The next bytes; None if nothing arrives within the timeout."""

    def write(self, data: bytes, address: object, /) -> None:
        """Send to the address of a chunk, or to the only peer; with None while no peer is known."""

    def close(self) -> None:
        """Close the connection."""


class UdpLink:
    """A UDP port that receives from anyone, or one that sends first and receives from that peer only."""

    def __init__(self, host: str, port: int, *, listens: bool) -> None:
        self._listens = listens
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        _widen(self._socket)
        try:
            if listens:
                self._socket.bind((host, port))
            else:
                self._socket.connect((host, port))
        except OSError:
            self._socket.close()
            raise

    def read(self, timeout_s: float) -> Chunk | None:
        """See :class:`Link`; one datagram."""
        self._socket.settimeout(timeout_s)
        try:
            data, address = self._socket.recvfrom(_READ_BYTES)
        except (TimeoutError, ConnectionRefusedError):
            # Linux reports that nobody received our last datagram; the peer may start later.
            return None
        return Chunk(data, time.time_ns(), complete=True, address=address)

    def write(self, data: bytes, address: object) -> None:
        """See :class:`Link`."""
        try:
            if not self._listens:
                self._socket.send(data)
            elif isinstance(address, tuple):
                self._socket.sendto(data, address)
        except ConnectionRefusedError:
            return

    def close(self) -> None:
        """See :class:`Link`."""
        self._socket.close()


def _widen(receiver: socket.socket) -> None:
    """Enlarge the receive buffer to seconds of packets, beyond the system's limit if permitted."""
    try:
        receiver.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _BUFFER_BYTES)
    except PermissionError:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)


class TcpLink:
    """A TCP connection to an autopilot or a router."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.create_connection((host, port), _CONNECT_TIMEOUT_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, timeout_s: float) -> Chunk | None:
        """See :class:`Link`."""
        self._socket.settimeout(timeout_s)
        try:
            data = self._socket.recv(_READ_BYTES)
        except TimeoutError:
            return None
        if not data:
            raise LinkError("the other side closed the connection")
        return Chunk(data, time.time_ns(), complete=False)

    def write(self, data: bytes, _: object) -> None:
        """See :class:`Link`."""
        self._socket.sendall(data)

    def close(self) -> None:
        """See :class:`Link`."""
        self._socket.close()


class SerialLink:
    """A serial port."""

    def __init__(self, device: str, baud: int) -> None:
        serial = require_library("serial", "mavlink")
        self._port = serial.Serial(device, baud, timeout=0.0, write_timeout=1.0, exclusive=True)

    def read(self, timeout_s: float) -> Chunk | None:
        """See :class:`Link`."""
        self._port.timeout = timeout_s
        data = self._port.read(max(1, self._port.in_waiting))
        return Chunk(data, time.time_ns(), complete=False) if data else None

    def write(self, data: bytes, _: object) -> None:
        """See :class:`Link`."""
        self._port.write(data)

    def close(self) -> None:
        """See :class:`Link`."""
        self._port.close()


class ReplayLink:
    """A telemetry log that delivers each packet when it is due, with the arrival time of the log."""

    def __init__(self, path: Path) -> None:
        self._records = list(read_records(path.read_bytes(), TlogCounts()))
        if not self._records:
            raise LogError(f"{path}: byte 0: no MAVLink packet in the whole file")
        self._next = 0
        self._ahead_ns: int | None = None

    def read(self, timeout_s: float) -> Chunk | None:
        """See :class:`Link`; one packet.

        Raises:
            EOFError: after the last.
        """
        if self._next == len(self._records):
            raise EOFError
        record = self._records[self._next]
        if self._ahead_ns is None:
            # The first packet is due at the first read.
            self._ahead_ns = record.arrival_ns - time.monotonic_ns()
        wait_s = (record.arrival_ns - self._ahead_ns - time.monotonic_ns()) * 1e-9
        if wait_s > timeout_s:
            time.sleep(timeout_s)
            return None
        if wait_s > 0.0:
            time.sleep(wait_s)
        self._next += 1
        return Chunk(record.frame.data, record.arrival_ns, complete=True)

    def write(self, data: bytes, _: object) -> None:
        """Do nothing: a log has no peer."""

    def close(self) -> None:
        """Do nothing."""


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
        if kind == "serial":
            return SerialLink(place, number)
        if kind == "tcp":
            return TcpLink(place, number)
        return UdpLink(place, number, listens=kind != "udpout")
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
