# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of an ArduPilot DataFlash log (.BIN) as arrays.

Layout: every record is 0xA3 0x95, its type, and packed little-endian values. Records of type 128 (FMT) give
type, length, name, one format letter per value, and the columns. After damage, reading resumes at the next
record that is followed by another one; pymavlink's DFReader stops at an unknown type, and hangs on a length
of zero.

Source: ardupilot.org, "Logging Messages"; AP_Logger's README.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.flight import Stamps
from quadpi_core.frames import Array

# The first bytes of every record.
HEAD = b"\xa3\x95"
_HEADER_BYTES = 3
_FMT = 128
_FMT_LETTERS, _FMT_COLUMNS = "BBnNZ", "Type,Length,Name,Format,Columns"
_LETTERS: MappingProxyType[str, tuple[str, float]] = MappingProxyType(
    {
        "b": ("<i1", 1.0),
        "B": ("<u1", 1.0),
        "M": ("<u1", 1.0),
        "h": ("<i2", 1.0),
        "H": ("<u2", 1.0),
        "i": ("<i4", 1.0),
        "I": ("<u4", 1.0),
        "q": ("<i8", 1.0),
        "Q": ("<u8", 1.0),
        "g": ("<f2", 1.0),
        "f": ("<f4", 1.0),
        "d": ("<f8", 1.0),
        "c": ("<i2", 1e-2),
        "C": ("<u2", 1e-2),
        "e": ("<i4", 1e-2),
        "E": ("<u4", 1e-2),
        "L": ("<i4", 1e-7),
        "n": ("S4", 1.0),
        "N": ("S16", 1.0),
        "Z": ("S64", 1.0),
        "a": ("V64", 1.0),
    }
)
# Column names that numpy or the layout of a record reserves.
_NO_COLUMNS = ("", "head")
_TIME_UNITS = MappingProxyType({"TimeUS": 1_000, "TimeMS": 1_000_000})


@dataclass(frozen=True)
class Messages:
    """All records of one name.

    Attributes:
        records: (N,) as packed in the log.
        factors: from each numeric column to its unit.
        offsets: (N,) of the records in the log.
    """

    records: npt.NDArray[np.void]
    factors: dict[str, float]
    offsets: npt.NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.records)

    def __contains__(self, column: str) -> bool:
        return column in self.factors

    def holds(self, *columns: str) -> bool:
        """Whether the log has these numeric columns and stamps; in a damaged log names may differ."""
        return all(column in self for column in columns) and any(name in self for name in _TIME_UNITS)

    def column(self, name: str) -> Array:
        """One column (N,) in its unit."""
        return self.records[name].astype(np.float64) * self.factors[name]

    def stack(self, *names: str) -> Array:
        """Columns side by side (N, len(names))."""
        return np.stack([self.column(name) for name in names], axis=1)

    def text(self, name: str) -> list[str]:
        """One column of text; empty where there is no such column."""
        if name not in (self.records.dtype.names or ()) or self.records.dtype[name].kind != "S":
            return []
        return [value.decode(errors="replace") for value in self.records[name].tolist()]

    def time_ns(self) -> Stamps:
        """Stamps (N,) since the boot of the autopilot."""
        for name, factor in _TIME_UNITS.items():
            if name in self:
                # Unsigned 64-bit counters; one too large for nanoseconds is damage, dropped as not rising.
                ticks = np.minimum(self.records[name].astype(np.uint64), np.uint64(2**62 // factor))
                return ticks.astype(np.int64) * factor
        raise KeyError("TimeUS")

    def where(self, column: str, value: int) -> Messages:
        """The records with this value; all where there is no such column."""
        if column not in self:
            return self
        return self.take(self.records[column] == value)

    def take(self, which: npt.NDArray[np.bool_]) -> Messages:
        """The records that a mask (N,) selects."""
        return Messages(self.records[which], self.factors, self.offsets[which])


@dataclass
class _Format:
    name: str
    layout: np.dtype[Any]
    factors: dict[str, float]
    offsets: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class DataFlash:
    """Content of a log.

    Attributes:
        messages: by their name; names without records are left out.
        skipped: number of bytes outside records.
        first_skipped: offset of the first of them.
        cut_off: offset of a last record that is not whole, or None.
    """

    messages: dict[str, Messages]
    skipped: int
    first_skipped: int
    cut_off: int | None


def decode_dataflash(source: str, data: bytes) -> DataFlash:
    """All records of a log.

    Raises:
        LogError: if it does not hold a single record.
    """
    formats = {_FMT: _format("FMT", _FMT_LETTERS, _FMT_COLUMNS)}
    position, skipped, first_skipped = 0, 0, 0
    cut_off = None
    while position < len(data):
        length = _length(data, position, formats)
        if length and position + length > len(data):
            cut_off = position
            break
        if not length:
            following = _next_record(data, position + 1, formats)
            first_skipped = first_skipped if skipped else position
            skipped += following - position
            position = following
            continue
        number = data[position + 2]
        if number == _FMT:
            _define(data, position, formats)
        formats[number].offsets.append(position)
        position += length
    if not any(known.offsets for known in formats.values()):
        raise LogError(f"{source}: byte 0: not a DataFlash log: no record in the whole file")
    return DataFlash(_gathered(data, formats), skipped, first_skipped, cut_off)


def _length(data: bytes, position: int, formats: dict[int, _Format]) -> int:
    """Length of the record at a position; 0 if it is of an unknown type or not a record."""
    if data[position : position + 2] != HEAD or position + 2 >= len(data):
        return 0
    known = formats.get(data[position + 2])
    return 0 if known is None else known.layout.itemsize


def _next_record(data: bytes, start: int, formats: dict[int, _Format]) -> int:
    """Position of the next record that is followed by another one, or the end."""
    position = data.find(HEAD, start)
    while position >= 0:
        length = _length(data, position, formats)
        follows = position + length
        if length and (follows == len(data) or data[follows : follows + 2] == HEAD):
            return position
        position = data.find(HEAD, position + 1)
    return len(data)


def _define(data: bytes, position: int, formats: dict[int, _Format]) -> None:
    """Register the format in an FMT record, unless it is damaged or already known."""
    record = np.frombuffer(data, formats[_FMT].layout, 1, position)[0]
    number, length = int(record["Type"]), int(record["Length"])
    name, letters, columns = (record[key].decode(errors="replace") for key in ("Name", "Format", "Columns"))
    is_whole = all(letter in _LETTERS for letter in letters) and letters.count("") == len(letters) + 1
    if (
        not is_whole
        or len(columns.split(",")) != len(letters)
        or len(set(columns.split(","))) != len(letters)
        or not set(columns.split(",")).isdisjoint(_NO_COLUMNS)
    ):
        return
    known = _format(name, letters, columns)
    if known.layout.itemsize == length and number not in formats:
        formats[number] = known


def _format(name: str, letters: str, columns: str) -> _Format:
    names = columns.split(",")
    layout = np.dtype(
        [
            ("head", f"V{_HEADER_BYTES}"),
            *((name, _LETTERS[x][0]) for name, x in zip(names, letters, strict=True)),
        ]
    )
    numbers = [(name, x) for name, x in zip(names, letters, strict=True) if layout[name].kind in "iuf"]
    return _Format(name, layout, {name: _LETTERS[x][1] for name, x in numbers})


def _gathered(data: bytes, formats: dict[int, _Format]) -> dict[str, Messages]:
    content = np.frombuffer(data, dtype=np.uint8)
    gathered = {}
    for known in formats.values():
        if known.offsets:
            offsets = np.array(known.offsets, dtype=np.int64)
            rows = np.lib.stride_tricks.sliding_window_view(content, known.layout.itemsize)[offsets]
            gathered[known.name] = Messages(rows.view(known.layout)[:, 0], known.factors, offsets)
    return gathered
