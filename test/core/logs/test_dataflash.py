# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of a DataFlash log: every kind of value, damage, and pymavlink's reading of a real log."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs.dataflash import DataFlash, decode_dataflash

from .dataflash_writer import definition, log, packed

IMU = {"IMU": ("QBf", "TimeUS,I,GyrX")}


def decoded(data: bytes) -> DataFlash:
    return decode_dataflash("flight.BIN", data)


# What a raw value is in the unit of the column, by ArduPilot's "Logging Messages".
UNITS = {
    **{"b": (-7, -7.0), "B": (250, 250.0), "M": (4, 4.0), "h": (-300, -300.0), "H": (60_000, 60_000.0)},
    **{"i": (-(2**31), -(2.0**31)), "I": (2**32 - 1, 2.0**32 - 1), "q": (-5, -5.0), "Q": (2**40, 2.0**40)},
    **{"g": (0.5, 0.5), "f": (-1.25, -1.25), "d": (0.1, 0.1)},
    **{"c": (-1234, -12.34), "C": (1234, 12.34), "e": (-123_456, -1234.56), "E": (123_456, 1234.56)},
    "L": (-353_632_608, -35.3632608),
}


@pytest.mark.parametrize("letter", UNITS)
def test_numbers_are_in_the_unit_of_their_letter(letter):
    raw, value = UNITS[letter]
    logged = decoded(log({"X": (f"Q{letter}", "TimeUS,V")}, [("X", 1, raw), ("X", 2, raw)])).messages["X"]
    assert logged.column("V") == pytest.approx([value] * 2, rel=1e-15)
    assert logged.holds("V")


def test_texts_are_no_numbers_and_end_where_they_do():
    text = {"MSG": ("QnNZ", "TimeUS,A,B,C")}
    logged = decoded(log(text, [("MSG", 5, "abcd", "ArduCopter", "v4.5 größer")])).messages["MSG"]
    assert (logged.text("A"), logged.text("B"), logged.text("C")) == (
        ["abcd"],
        ["ArduCopter"],
        ["v4.5 größer"],
    )
    assert logged.text("TimeUS") == logged.text("nothing") == []
    assert not logged.holds("A")


@pytest.mark.parametrize(("clock", "factor"), [("TimeUS", 1000), ("TimeMS", 10**6)])
def test_stamps_count_from_boot_in_micro_or_milliseconds(clock, factor):
    logged = decoded(log({"X": ("QB", f"{clock},I")}, [("X", 7, 0), ("X", 2**64 - 1, 1)])).messages["X"]
    stamps = logged.time_ns()
    assert stamps[0] == 7 * factor
    # More than 64 bits of nanoseconds: damage, but no wrap to a stamp that may seem right.
    assert stamps[1] > 2**61
    assert logged.where("I", 1).time_ns().tolist() == [stamps[1]]
    assert len(logged.where("C", 1)) == 2


def test_records_between_damaged_bytes_are_read():
    records = [("IMU", k, 0, 0.5) for k in range(6)]
    whole = log(IMU, records)
    size = 3 + struct.calcsize("<QBf")
    start = len(whole) - 3 * size
    # A head among other bytes is no record unless another one follows.
    damaged = whole[:start] + b"???\xa3\x95\x40" + b"?" * 20 + whole[start + size :]
    found = decoded(damaged)
    assert found.messages["IMU"].column("TimeUS").tolist() == [0.0, 1.0, 2.0, 4.0, 5.0]
    assert (found.skipped, found.first_skipped, found.cut_off) == (26, start, None)
    cut = decoded(whole[:-1])
    assert len(cut.messages["IMU"]) == 5
    assert (cut.skipped, cut.cut_off) == (0, len(whole) - size)


@pytest.mark.parametrize(
    "wrong",
    [
        definition(70, "X", "QB", "TimeUS,I", length=0),
        definition(70, "X", "QB", "TimeUS,I", length=99),
        definition(70, "X", "Q?", "TimeUS,I", length=12),
        definition(70, "X", "QB", "TimeUS"),
        definition(70, "X", "QB", "TimeUS,TimeUS"),
        definition(70, "X", "QB", "TimeUS,head"),
        definition(70, "X", "QB", "TimeUS,"),
    ],
)
def test_a_format_that_contradicts_itself_is_passed_over(wrong):
    """pymavlink's reader hangs on a length of zero, and stops at records of an unknown type."""
    good = log(IMU, [("IMU", 1, 0, 0.5)])
    found = decoded(good + wrong + b"\xa3\x95\x46" + packed("QB", (1, 2)) + good[-16:])
    assert set(found.messages) == {"FMT", "IMU"}
    assert len(found.messages["IMU"]) == 2
    assert found.skipped == 3 + 9


def test_of_two_formats_of_one_type_the_first_counts():
    twice = log(IMU, [("IMU", 1, 0, 0.5)]) + definition(64, "ACC", "QBf", "TimeUS,I,AccX")
    assert decoded(twice + log(IMU, [("IMU", 2, 0, 0.5)])[-16:]).messages["IMU"].column(
        "TimeUS"
    ).tolist() == [1.0, 2.0]


def test_nothing_but_damage_is_refused():
    with pytest.raises(LogError, match=r"^flight\.BIN: byte 0: not a DataFlash log: no record"):
        decoded(b"\xa3\x95" + bytes(200))


def test_a_real_log_agrees_with_pymavlink(shared_data: Path) -> None:
    DFReader = pytest.importorskip("pymavlink.DFReader", reason="pymavlink is not installed")
    path = shared_data / "logs" / "ardupilot_copter_2014.BIN"
    messages = decode_dataflash(str(path), path.read_bytes()).messages
    reader = DFReader.DFReader_binary(str(path))
    theirs: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        theirs.setdefault(message.get_type(), []).append(message)
    assert {name: len(found) for name, found in messages.items()} == {k: len(v) for k, v in theirs.items()}
    for name in ("IMU", "ATT", "EKF1", "RCOU", "BARO"):
        for column in messages[name].factors:
            mine = messages[name].column(column)
            assert mine == pytest.approx([getattr(one, column) for one in theirs[name]]), (name, column)
