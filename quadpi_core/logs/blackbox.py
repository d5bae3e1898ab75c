# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Decoder of Blackbox logs: header lines, then frames whose fields are the residuals of a predictor.

A log has frames of the main loop (I: intra, P: predicted from the frames before), others that are skipped
(S, G, H) and events (E). There are no lengths and no checksums: a frame counts as whole if the byte behind
it starts another one and its time continues that of the frame before. After a damaged frame the search
resumes at its second byte, and P frames are used again from the next I frame on.

Source: Betaflight's documentation, "Blackbox Internals"; for the predictor of the motor's lowest output, the
values in logs.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.errors import LogError
from quadpi_core.frames import Array
from quadpi_core.logs.blackbox_encodings import (
    BROKEN,
    CUT,
    ENCODINGS,
    NULL,
    TAG8_4S16,
    Bytes,
    Integers,
    read_fields,
    read_unsigned,
    sign_extended,
)
from quadpi_core.logs.sandbox import require_unpackable

# Firmwares log up to 200 fields; their header lines are shorter than 2 kB.
_FIELDS_MAX = 256
_HEADER_LINE_MAX = 8192
# Largest number of fields read again behind damaged frames, per byte of the flight, before the rest counts as
# damaged; random bytes take about four.
_REREAD_MAX = 16
# Largest step in time from frame to frame, in µs: longer than any pause of a logger that resumes by itself.
_LEAP_MAX_US = 10_000_000

_KINDS = b"IPSGH"
_I, _P = 0, 1
_ZERO, _PREVIOUS, _LINE, _AVERAGE, _MINTHROTTLE, _MOTOR_0, _INCREMENT, _1500, _VBATREF, _MINMOTOR = (
    *(0, 1, 2, 3, 4, 5),
    *(6, 8, 9, 11),
)
_PREDICTORS = {*range(7), 8, 9, 11}
_UINT32 = 0xFFFFFFFF
_EVENT, _LOG_END = ord("E"), 255
_END_OF_LOG = np.frombuffer(b"End of log", dtype=np.uint8)
_NUMBER = re.compile(r"(-?[0-9]{1,10})|0x([0-9A-Fa-f]{1,8})")
_TIME, _ITERATION = "time", "loopIteration"


@dataclass(frozen=True)
class BlackboxLog:
    """One flight.

    Attributes:
        headers: those that are whole numbers, by name.
        fields: names of all fields of the main frames.
        columns: (N,) of the main frames, in the units of the log; `time` in µs is unwrapped beyond 32 bits.
        ended: whether the log has an end event.
        damaged_at: position in the flight of the first byte outside frames; None without one.
        damaged_bytes: number of such bytes.
    """

    headers: Mapping[str, int]
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
    encoding = np.full((len(_KINDS), _FIELDS_MAX), NULL, dtype=np.int64)
    predictor, count = np.zeros_like(encoding), np.zeros(len(_KINDS), dtype=np.int64)
    for place, kind in enumerate(_KINDS.decode()):
        fields = len(names) if place in {_I, _P} else len(texts.get(f"Field {kind} encoding", "").split(","))
        if place not in {_I, _P} and f"Field {kind} encoding" not in texts:
            continue
        count[place] = fields
        encoding[place, :fields] = _described(texts, f"Field {kind} encoding", fields, ENCODINGS)
        # Of the other frames only the length is needed.
        if place in {_I, _P}:
            predictor[place, :fields] = _described(texts, f"Field {kind} predictor", fields, _PREDICTORS)
    signed = np.zeros(_FIELDS_MAX, dtype=np.int64)
    if "Field I signed" in texts:
        signed[: len(names)] = _described(texts, "Field I signed", len(names), {0, 1})
    if headers.get("Data version") != 2 and np.any(encoding == TAG8_4S16):
        raise LogError(f"its header says data version {texts.get('Data version', 'unknown')}; read is 2")
    rules = _Rules(
        encoding,
        predictor,
        count,
        signed,
        np.array([names.index(_TIME), names.index(_ITERATION), _place(names, "motor[0]")], dtype=np.int64),
        np.array([*_intervals(texts), *_references(texts)], dtype=np.int64),
    )
    read = [_TIME, *(name for name in dict.fromkeys(wanted) if name in names and name != _TIME)]
    chosen = np.array([names.index(name) for name in read], dtype=np.int64)
    data = np.frombuffer(flight, dtype=np.uint8)
    rows = _decode(data, start, rules, chosen, np.empty((0, len(read))))[0]
    table: Array = np.empty((rows, len(read)))
    require_unpackable(len(flight), table.nbytes)
    _, ended, damaged_at, damaged = _decode(data, start, rules, chosen, table)
    columns = dict(zip(read, np.ascontiguousarray(table.T), strict=True))
    columns[_TIME] = np.unwrap(columns[_TIME], period=2.0**32)
    return BlackboxLog(headers, names, columns, bool(ended), damaged_at if damaged else None, damaged)


class _Rules(NamedTuple):
    """Layout of the frames of a log.

    Attributes:
        encoding, predictor: (5, F) of each field, by kind of frame as `_KINDS`.
        sizes: (5,) number of fields; 0 for a kind that the log does not have.
        signed: (F,) whether a field of main frames is signed.
        places: indices of the fields time, loopIteration and motor[0].
        numbers: :func:`_intervals` and :func:`_references`.
    """

    encoding: Integers
    predictor: Integers
    sizes: Integers
    signed: Integers
    places: Integers
    numbers: Integers


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


def _described(texts: Mapping[str, str], name: str, fields: int, known: set[int]) -> list[int]:
    """The numbers of a header line, one for each field."""
    numbers = [_whole(text) for text in texts.get(name, "").split(",")]
    if len(numbers) != fields or fields > _FIELDS_MAX:
        raise LogError(f"its header `{name}` has {len(numbers)} entries for {fields} fields")
    for number in numbers:
        if number not in known:
            raise LogError(f"its header `{name}` has an entry that is not known: {number}")
    return [number for number in numbers if number is not None]


def _place(names: Sequence[str], name: str) -> int:
    return names.index(name) if name in names else 0


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


@njit(cache=True)
def _event(data: Bytes, position: int) -> tuple[int, bool]:
    """Position behind an event, and whether it is the end of the log."""
    if position >= len(data):
        return CUT, False
    kind = data[position]
    position += 1
    if kind == _LOG_END:
        for k in range(len(_END_OF_LOG)):
            if position + k >= len(data):
                return CUT, False
            if data[position + k] != _END_OF_LOG[k]:
                return BROKEN, False
        return position + len(_END_OF_LOG), True
    # Sync beep, disarmed; then logging resumed, flight mode: one or two numbers.
    if kind in (0, 15):
        return read_unsigned(data, position)[1], False
    if kind in (14, 30):
        position = read_unsigned(data, position)[1]
        return (read_unsigned(data, position)[1] if position >= 0 else position), False
    if kind == 13:
        # In-flight adjustment; a single-precision number where the highest bit is set.
        if position >= len(data):
            return CUT, False
        if data[position] < 0x80:
            return read_unsigned(data, position + 1)[1], False
        return (position + 5 if position + 5 <= len(data) else CUT), False
    return BROKEN, False


@njit(cache=True)
def _kind(byte: int) -> int:
    for k in range(len(_KINDS)):
        if _KINDS[k] == byte:
            return k
    return -1


@njit(cache=True)
def _step(iteration: int, every: int, numerator: int, denominator: int) -> int:
    """Number of iterations of the main loop to the next one that is logged."""
    since = iteration % every
    phase = (since + numerator - 1) % denominator
    to_next = 1 if (phase + 1) % denominator < numerator else denominator - phase
    return min(to_next, every - since)


@njit(cache=True)
def _predict(values: Integers, before: Integers, earlier: Integers, rules: _Rules, kind: int) -> None:
    """Add to the residuals of a main frame the predictions from the two frames before it and the headers."""
    every, numerator, denominator, minthrottle, vbatref, minmotor = rules.numbers
    for place in range(rules.sizes[kind]):
        rule, value = rules.predictor[kind, place], values[place]
        if rule == _PREVIOUS:
            value += before[place]
        elif rule == _LINE:
            value += 2 * before[place] - earlier[place]
        elif rule == _AVERAGE:
            # Rounded toward zero, as in the firmware.
            total = before[place] + earlier[place]
            value += total // 2 if total >= 0 else -(-total // 2)
        elif rule == _MINTHROTTLE:
            value += minthrottle
        elif rule == _MOTOR_0:
            value += values[rules.places[2]]
        elif rule == _INCREMENT:
            value += before[place] + _step(before[place], every, numerator, denominator)
        elif rule == _1500:
            value += 1500
        elif rule == _VBATREF:
            value += vbatref
        elif rule == _MINMOTOR:
            value += minmotor
        value &= _UINT32
        values[place] = sign_extended(value, 32) if rules.signed[place] else value


@njit(cache=True)
def _frame(data: Bytes, position: int, rules: _Rules, values: Integers) -> int:
    """Read the residuals of a frame or step over an event; returns the position behind it.

    It also counts as broken if neither another frame nor the end of the file follows.
    """
    kind, count = _kind(data[position]), rules.sizes
    if data[position] == _EVENT:
        stop, last = _event(data, position + 1)
        if last:
            return stop
    elif kind >= 0 and count[kind] > 0:
        stop = read_fields(data, position + 1, rules.encoding[kind], count[kind], values)
    else:
        return BROKEN
    if stop < 0 or stop == len(data) or data[stop] == _EVENT:
        return stop
    following = _kind(data[stop])
    return stop if following >= 0 and count[following] > 0 else BROKEN


@njit(cache=True)
def _goes_on(since: int, now: int, most: int) -> bool:
    """Whether a 32-bit counter has advanced by at most `most`."""
    return (now - since) & _UINT32 <= most


@njit(cache=True)
def _decode(
    data: Bytes,
    position: int,
    rules: _Rules,
    chosen: Integers,
    table: Array,
) -> tuple[int, bool, int, int]:
    """Fill a table with the chosen fields of the main frames, up to its number of rows.

    Returns:
        Number of main frames, whether the log has an end, position of the first damaged byte, and number of
        damaged bytes.
    """
    time, iteration, _ = rules.places
    values = np.zeros(rules.encoding.shape[1], dtype=np.int64)
    before, earlier = np.zeros_like(values), np.zeros_like(values)
    rows, damaged_at, damaged, reread = 0, 0, 0, 0
    # Whether a valid frame precedes, for P frames to be predicted from; time of an I frame that was refused.
    builds, refused = False, -1
    while position < len(data):
        stop = _frame(data, position, rules, values)
        if stop == CUT:
            break
        kind, whole = _kind(data[position]), stop >= 0
        if whole and (kind == _I or (kind == _P and builds)):
            _predict(values, before, earlier, rules, kind)
            whole = rows == 0 or (
                _goes_on(before[time], values[time], _LEAP_MAX_US)
                and _goes_on(before[iteration], values[iteration], _UINT32 >> 1)
            )
            # Two refused I frames that agree with each other are right, and the frame before them was wrong.
            if not whole and kind == _I:
                whole = refused >= 0 and _goes_on(refused, values[time], _LEAP_MAX_US)
                refused = values[time]
            if whole:
                builds, refused = True, -1
                earlier[:] = values if kind == _I else before
                before[:] = values
                if rows < len(table):
                    for column in range(len(chosen)):
                        table[rows, column] = values[chosen[column]]
                rows += 1
        if whole:
            if data[position] == _EVENT and data[position + 1] == _LOG_END:
                return rows, True, damaged_at, damaged
            position = stop
            continue
        if damaged == 0:
            damaged_at = position
        builds = False
        damaged += 1
        reread += max(rules.sizes[kind] if kind >= 0 else 0, 1)
        position += 1
        if reread > _REREAD_MAX * len(data):
            damaged += len(data) - position
            break
    return rows, False, damaged_at, damaged
