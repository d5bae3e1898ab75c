# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Connections that are refused or cannot be opened, and a telemetry log as a link."""

from __future__ import annotations

import socket
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from quadpi_core.logs.mavlink_frames import load_dialect
from quadpi_ros import mavlink_link
from quadpi_ros.mavlink_link import LinkError, check_connection, open_link

from .mavlink_rig import free_port


@pytest.mark.parametrize(
    ("connection", "message"),
    [
        ("", "is none of udp:HOST:PORT"),
        ("udp:14550", "is none of"),
        ("udp:127.0.0.1:x", "is none of"),
        ("ftp:127.0.0.1:1", "is none of"),
        ("tcp:127.0.0.1:70000", "70000 is no port"),
    ],
)
def test_wrong_connections_are_refused(connection: str, message: str) -> None:
    with pytest.raises(LinkError, match=message):
        check_connection(connection)


def test_what_cannot_be_opened_is_named() -> None:
    port = free_port(socket.SOCK_STREAM)
    with pytest.raises(LinkError, match=rf"tcp:127.0.0.1:{port}: .*refused"):
        open_link(f"tcp:127.0.0.1:{port}")
    with pytest.raises(LinkError, match="serial:/dev/no-such-port:57600: "):
        open_link("serial:/dev/no-such-port:57600")
    with pytest.raises(LinkError, match=r"no-such\.tlog: "):
        open_link("no-such.tlog")


def test_a_telemetry_log_begins_when_it_is_read_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dialect = load_dialect()
    packet = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(dialect.MAVLink(None, 1, 1))
    stamps = [1_700_000_000_000_000, 1_700_000_000_010_000]
    (tmp_path / "two.tlog").write_bytes(b"".join(stamp.to_bytes(8, "big") + packet for stamp in stamps))
    now_s = [100.0]
    monkeypatch.setattr(
        mavlink_link,
        "time",
        SimpleNamespace(
            monotonic_ns=lambda: round(1e9 * now_s[0]),
            sleep=lambda seconds: now_s.append(now_s.pop() + seconds),
        ),
    )
    link = open_link(str(tmp_path / "two.tlog"))
    now_s[0] += 10.0  # until somebody subscribes
    read_s = []
    for _ in stamps:
        assert link.read(0.02) is not None
        read_s.append(now_s[0])
    assert read_s == pytest.approx([110.0, 110.01])
