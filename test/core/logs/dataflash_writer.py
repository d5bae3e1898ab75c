# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""DataFlash logs of any records, as AP_Logger's README lays them out."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Any

# The struct of each format letter, by ArduPilot's "Logging Messages".
LETTERS = {
    **{"b": "b", "B": "B", "M": "B", "h": "h", "H": "H", "i": "i", "I": "I", "q": "q", "Q": "Q"},
    **{"g": "e", "f": "f", "d": "d", "c": "h", "C": "H", "e": "i", "E": "I", "L": "i"},
    **{"n": "4s", "N": "16s", "Z": "64s", "a": "64s"},
}
FMT = ("BBnNZ", "Type,Length,Name,Format,Columns")
Record = tuple[Any, ...]


def packed(letters: str, values: Iterable[Any]) -> bytes:
    """The values of one record."""
    whole = [value.encode() if isinstance(value, str) else value for value in values]
    return struct.pack("<" + "".join(LETTERS[letter] for letter in letters), *whole)


def definition(number: int, name: str, letters: str, columns: str, length: int | None = None) -> bytes:
    """The record that says what records of a type hold; `length` where it is wrong."""
    right = 3 + struct.calcsize("<" + "".join(LETTERS.get(letter, "") for letter in letters))
    row = (number, right if length is None else length, name, letters, columns)
    return b"\xa3\x95\x80" + packed(FMT[0], row)


def log(formats: dict[str, tuple[str, str]], records: Iterable[Record]) -> bytes:
    """A log of records (name, value, …), whose formats are given as name: (letters, columns)."""
    numbers = {name: 64 + place for place, name in enumerate(formats)}
    heads = [definition(128, "FMT", *FMT)]
    heads += [definition(numbers[name], name, *form) for name, form in formats.items()]
    rows = (
        b"\xa3\x95" + bytes((numbers[name],)) + packed(formats[name][0], values) for name, *values in records
    )
    return b"".join((*heads, *rows))
