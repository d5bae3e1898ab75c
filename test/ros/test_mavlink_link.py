# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Connections that are refused or cannot be opened, and a telemetry log as a link."""

from __future__ import annotations

import socket
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from typing import Any

from quadpi_core.logs.mavlink_frames import Framer, load_dialect
from quadpi_core.logs.mavlink_session import MavlinkSession, SessionSettings
from quadpi_core.results import CHANGED_MASS, CHANGED_ROTOR, UNCALIBRATED_WORDS, UNCHANGED
from quadpi_core.rotor_order import RotorOrder
from quadpi_ros import mavlink_link
from quadpi_ros.mavlink_link import AlarmTold, LinkError, Text, check_connection, open_link

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


S = 1_000_000_000
LOST = "rotor 3 gives 3.10 ± 0.40 % less thrust than its speed says since 12:41:07 UTC"
OUTSIDE = "vertical force outside its interval 80 % of the time"


class Alarm(SimpleNamespace):
    """One message of the monitor: levels of extrapolation, miscoverage, bad data, change."""

    def __init__(self, levels: tuple[int, ...], kind: int, rotor: int, size: float, *reasons: str) -> None:
        super().__init__(
            cause_level=[levels], changed=[kind], changed_rotor=[rotor], change_size=[size], reasons=[reasons]
        )

    def __len__(self) -> int:
        return 1


SOUND = Alarm((0, 1, 0, 0), UNCHANGED, 0, 0.0)
WEAK = Alarm((0, 0, 0, 2), CHANGED_ROTOR, 3, 0.031, LOST)
BOTH = Alarm((0, 2, 0, 2), CHANGED_ROTOR, 3, 0.031, LOST, OUTSIDE)


def texts(told: list[Any]) -> list[str]:
    whole: dict[int, str] = {}
    for one in told:
        if isinstance(one, Text):
            assert len(one.text) <= 50
            whole[one.number] = whole.get(one.number, "") + one.text.decode()
    return list(whole.values())


def numbers(told: list[Any]) -> list[tuple[bytes, float]]:
    return [(one.name, round(one.value, 6)) for one in told if not isinstance(one, Text)]


def test_a_change_is_told_once_as_text_and_once_a_second_as_a_number() -> None:
    told = AlarmTold()
    said = [list(told.take(alarm, k * S // 10)) for k, alarm in enumerate([SOUND] + 25 * [WEAK], 100)]
    assert [texts(one) for one in said] == [[], [f"ALARM: {LOST}".replace("±", "+-")]] + 24 * [[]]
    assert [one for part in said for one in numbers(part)] == 3 * [(b"rotor3_pc", 3.1)]


@pytest.mark.parametrize("reasons", [(LOST,), (LOST, OUTSIDE), (LOST, OUTSIDE, "not judged")])
def test_behind_the_reasons_that_fit_it_is_told_that_no_rate_holds(reasons: tuple[str, ...]) -> None:
    alarm = Alarm((0, 2, 0, 2), CHANGED_ROTOR, 3, 0.031, *reasons, UNCALIBRATED_WORDS)
    (said,) = texts(list(AlarmTold().take(alarm, 10 * S)))
    assert said == "ALARM: " + "; ".join((*reasons[:2], "uncalibrated")).replace("±", "+-")


def test_what_is_new_is_told_and_that_it_is_over() -> None:
    told = AlarmTold()
    (first,) = texts(list(told.take(WEAK, 10 * S)))
    (second,) = texts(list(told.take(BOTH, 12 * S)))
    assert second == f"{first}; {OUTSIDE}"
    assert texts(list(told.take(WEAK, 13 * S))) == []
    heavier = Alarm((0, 0, 0, 2), CHANGED_MASS, 0, 0.012, "12.0 ± 3.0 g heavier")
    changed = list(told.take(heavier, 14 * S))
    assert texts(changed) == ["ALARM: 12.0 +- 3.0 g heavier"]
    assert numbers(changed) == [(b"add_g", 12.0)]
    (over,) = told.take(SOUND, 15 * S)
    assert isinstance(over, Text)
    assert (over.severity, over.text) == (5, b"quadpi: the alarm is over")
    # An alarm that comes and goes is not told each time, nor that it is over; one that stays is.
    assert texts(list(told.take(heavier, 16 * S))) == []
    assert texts(list(told.take(SOUND, 17 * S))) == []
    assert texts(list(told.take(heavier, 18 * S))) == []
    assert len(texts(list(told.take(heavier, 19 * S)))) == 1
    assert texts(list(told.take(heavier, 30 * S))) == []
    assert texts(list(told.take(SOUND, 31 * S))) == ["quadpi: the alarm is over"]
    assert len(texts(list(told.take(heavier, 32 * S)))) == 1


def test_a_clock_that_is_set_back_hides_no_alarm() -> None:
    told = AlarmTold()
    assert len(texts(list(told.take(WEAK, 3600 * S)))) == 1
    assert len(texts(list(told.take(SOUND, 3601 * S)))) == 1
    assert len(texts(list(told.take(WEAK, 10 * S)))) == 1


@pytest.mark.parametrize("length", [49, 50, 100])
def test_a_zero_behind_the_last_piece_ends_a_text(length: int) -> None:
    alarm = Alarm((0, 0, 0, 2), UNCHANGED, 0, 0.0, "x" * (length - len("ALARM: ")))
    pieces = [one for one in AlarmTold().take(alarm, 10 * S) if isinstance(one, Text)]
    assert sum(len(one.text) for one in pieces) == length
    assert len(pieces[-1].text) < 50


@pytest.mark.parametrize("passive", [False, True])
def test_an_autopilot_hears_it(passive: bool) -> None:
    session = MavlinkSession(None, RotorOrder((0, 1, 2, 3), "rpm"), SessionSettings(passive=passive))
    told = list(AlarmTold().take(WEAK, 100 * S))

    def heard() -> list[Any]:
        for one in told:
            session.tell("STATUSTEXT" if isinstance(one, Text) else "NAMED_VALUE_FLOAT", one, 101 * S)
        messages = [message for packet in session.due(101 * S) for message in Framer().feed(packet)]
        return [one for one in messages if one.get_type() in {"STATUSTEXT", "NAMED_VALUE_FLOAT"}]

    assert heard() == []  # nobody is there
    dialect = load_dialect()
    heartbeat = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    session.take(bytes(heartbeat.pack(dialect.MAVLink(None, 1, 1))), 100 * S, complete=True)
    messages = heard()
    if passive:
        assert messages == []
        return
    first, second, number = messages
    assert first.text + second.text == f"ALARM: {LOST}".replace("±", "+-")
    assert (first.severity, first.chunk_seq, second.chunk_seq, second.id) == (2, 0, 1, first.id)
    assert (number.name, number.time_boot_ms) == ("rotor3_pc", 1000)
    assert number.value == pytest.approx(3.1)
