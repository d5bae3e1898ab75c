# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Decoder of Blackbox logs: header lines, then frames whose fields are the residuals of a predictor.

The header lines are read here, the frames in core/include/quadpi/logs/blackbox.hpp, which says how.

Source: Betaflight's documentation, "Blackbox Internals".
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.frames import Array
from quadpi_core.logs.sandbox import require_unpackable
from quadpi_core.messages.payloads import Indices
from quadpi_core.records import record_dtype

# Header lines of firmwares are shorter than 2 kB.
_HEADER_LINE_MAX = 8192

# Kinds of frames: those of the main loop come first.
_KINDS, _MAIN = len(compiled.BLACKBOX_KINDS), "IP"
_NUMBER = re.compile(r"(-?[0-9]{1,10})|0x([0-9A-Fa-f]{1,8})")
_TIME, _ITERATION = "time", "loopIteration"


@dataclass(frozen=True)
class BlackboxLog:
    """One flight.

    Attributes:
        headers: those that are whole numbers, by name.
        texts: all of them, by name.
        fields: names of all fields of the main frames.
        columns: (N,) of the main frames, in the units of the log; `time` in µs is unwrapped beyond 32 bits.
        ended: whether the log has an end event.
        damaged_at: position in the flight of the first byte outside frames; None without one.
        damaged_bytes: number of such bytes.
    """

    headers: Mapping[str, int]
    texts: Mapping[str, str]
    fields: Sequence[str]
    columns: Mapping[str, Array]
    ended: bool
    damaged_at: int | None
    damaged_bytes: int


def decode_blackbox(flight: bytes, wanted: Sequence[str]) -> BlackboxLog:
    """Those of the wanted columns that one flight has.

    Args:
        flight: from its first header line on.
        wanted: names of fields of the main frames; `time` is always read.

    Raises:
        LogError: for headers that do not describe its frames, or more frames than may be unpacked.
    """
    texts, start = _header(flight)
    headers = {name: number for name, text in texts.items() if (number := _whole(text)) is not None}
    names = texts.get("Field I name", "").split(",")
    for name in (_TIME, _ITERATION):
        if names.count(name) != 1:
            raise LogError(f"its headers name the field {name} {names.count(name)} times, not once")
    rules = np.zeros(1, RULES)
    encoding = rules["encoding"][0]
    encoding[:] = compiled.BLACKBOX_NOTHING
    for place, kind in enumerate(compiled.BLACKBOX_KINDS):
        fields = len(names) if kind in _MAIN else len(texts.get(f"Field {kind} encoding", "").split(","))
        if kind not in _MAIN and f"Field {kind} encoding" not in texts:
            continue
        rules["sizes"][0, place] = fields
        described = _described(texts, f"Field {kind} encoding", fields, compiled.BLACKBOX_ENCODINGS)
        encoding[place, :fields] = described
        # Of the other frames only the length is needed.
        if kind in _MAIN:
            described = _described(texts, f"Field {kind} predictor", fields, compiled.BLACKBOX_PREDICTORS)
            rules["predictor"][0, place, :fields] = described
    if "Field I signed" in texts:
        rules["signed"][0, : len(names)] = _described(texts, "Field I signed", len(names), (0, 1))
    if headers.get("Data version") != 2 and np.any(encoding == compiled.BLACKBOX_TAG8_4S16):
        raise LogError(f"its header says data version {texts.get('Data version', 'unknown')}; read is 2")
    rules["time"], rules["iteration"] = names.index(_TIME), names.index(_ITERATION)
    rules["motor"] = names.index("motor[0]") if "motor[0]" in names else 0
    rules["every"], rules["numerator"], rules["denominator"] = _intervals(texts)
    rules["minthrottle"], rules["vbatref"], rules["minmotor"] = _references(texts)
    read = [_TIME, *(name for name in dict.fromkeys(wanted) if name in names and name != _TIME)]
    chosen = np.array([names.index(name) for name in read], dtype=np.int64)
    rows = compiled.decode_blackbox(flight, start, rules, chosen, np.empty(0))[0]
    table: Array = np.empty((rows, len(read)))
    require_unpackable(len(flight), table.nbytes)
    _, ended, damaged_at, damaged = compiled.decode_blackbox(flight, start, rules, chosen, table)
    columns = dict(zip(read, np.ascontiguousarray(table.T), strict=True))
    columns[_TIME] = np.unwrap(columns[_TIME], period=2.0**32)
    return BlackboxLog(headers, texts, names, columns, ended, damaged_at if damaged else None, damaged)


class _Rules:
    """Layout of the frames of a log: that of core/include/quadpi/logs/blackbox.hpp."""

    encoding: Annotated[Indices, _KINDS, compiled.BLACKBOX_FIELDS_MAX]
    predictor: Annotated[Indices, _KINDS, compiled.BLACKBOX_FIELDS_MAX]
    sizes: Annotated[Indices, _KINDS]
    signed: Annotated[Indices, compiled.BLACKBOX_FIELDS_MAX]
    time: int
    iteration: int
    motor: int
    every: int
    numerator: int
    denominator: int
    minthrottle: int
    vbatref: int
    minmotor: int


RULES = record_dtype(_Rules)


def _header(flight: bytes) -> tuple[dict[str, str], int]:
    """The header lines by name, and where the frames begin."""
    texts: dict[str, str] = {}
    position = 0
    while flight.startswith(b"H ", position):
        end = flight.find(b"\n", position, position + _HEADER_LINE_MAX)
        line = flight[position:end]
        # A frame of kind H may begin with the same bytes.
        if end < 0 or b":" not in line or not line.isascii():
            break
        name, _, text = line[2:].decode().partition(":")
        texts[name] = text.strip()
        position = end + 1
    return texts, position


def _whole(text: str) -> int | None:
    match = _NUMBER.fullmatch(text)
    if match is None:
        return None
    return int(match[1]) if match[1] else int(match[2], 16)


def _described(texts: Mapping[str, str], name: str, fields: int, known: Collection[int]) -> list[int]:
    """The numbers of a header line, one for each field."""
    numbers = [_whole(text) for text in texts.get(name, "").split(",")]
    if len(numbers) != fields or fields > compiled.BLACKBOX_FIELDS_MAX:
        raise LogError(f"its header `{name}` has {len(numbers)} entries for {fields} fields")
    for number in numbers:
        if number not in known:
            raise LogError(f"its header `{name}` has an entry that is not known: {number}")
    return [number for number in numbers if number is not None]


def _intervals(texts: Mapping[str, str]) -> tuple[int, int, int]:
    """Logged iterations of the main loop: one in N as an I frame, M in K as a P frame."""
    first, _, second = texts.get("P interval", "1/1").partition("/")
    # Early firmware writes a fraction, later firmware the interval.
    share = (first, second) if second else ("1", first)
    found = [_whole(text) for text in (texts.get("I interval", "32"), *share)]
    every, numerator, denominator = (1 if number is None or number < 1 else number for number in found)
    return every, numerator, denominator


def _references(texts: Mapping[str, str]) -> tuple[int, int, int]:
    """Constants of predictors: minthrottle, vbatref, the lowest output of a motor."""
    minimum, battery, output = (
        _whole(texts.get(name, "").partition(",")[0]) or 0
        for name in ("minthrottle", "vbatref", "motorOutput")
    )
    return minimum, battery, output
