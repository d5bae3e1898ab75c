# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Decoding of the fields of a Blackbox frame: variable-length numbers, alone or in groups of 3, 4 and 8.

Source: Betaflight's documentation, "Blackbox Internals"; for triples of variable size, the values in logs.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit

SIGNED_VB, UNSIGNED_VB, NEG_14BIT = 0, 1, 3
TAG8_8SVB, TAG2_3S32, TAG8_4S16 = 6, 7, 8
NULL, TAG2_3SVARIABLE = 9, 10
ENCODINGS = {SIGNED_VB, UNSIGNED_VB, NEG_14BIT, TAG8_8SVB, TAG2_3S32, TAG8_4S16, NULL, TAG2_3SVARIABLE}
# Given in place of the position behind a frame: the file ends within it, or its bytes are invalid.
CUT, BROKEN = -1, -2

Bytes = npt.NDArray[np.uint8]
Integers = npt.NDArray[np.int64]


@njit(cache=True)
def _byte(data: Bytes, position: int) -> int:
    return np.int64(data[position])  # type: ignore[return-value]


@njit(cache=True)
def read_unsigned(data: Bytes, position: int) -> tuple[int, int]:
    """A number of up to 32 bits, seven in each byte, lowest first; and the position behind it."""
    value = 0
    for shift in range(0, 35, 7):
        if position >= len(data):
            return 0, CUT
        byte = _byte(data, position)
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
    return 0, BROKEN


@njit(cache=True)
def _read_signed(data: Bytes, position: int) -> tuple[int, int]:
    """A signed number in zigzag encoding, and the position behind it."""
    value, position = read_unsigned(data, position)
    return (value >> 1) ^ -(value & 1), position


@njit(cache=True)
def sign_extended(value: int, bits: int) -> int:
    """The number in the lowest bits, read as two's complement."""
    value &= (1 << bits) - 1
    return value - (1 << bits) if value >> (bits - 1) else value


@njit(cache=True)
def _little(data: Bytes, position: int, size: int) -> int:
    value = 0
    for k in range(size):
        value |= _byte(data, position + k) << (8 * k)
    return value


@njit(cache=True)
def _triple(data: Bytes, position: int, variable: bool, values: Integers) -> int:
    """Three numbers whose size the first two bits give; returns the position behind them."""
    if position >= len(data):
        return CUT
    lead = _byte(data, position)
    size = lead >> 6
    if size == 3:
        position += 1
        for k in range(3):
            length = (lead >> (2 * k) & 3) + 1
            if position + length > len(data):
                return CUT
            values[k] = sign_extended(_little(data, position, length), 8 * length)
            position += length
        return position
    if position + size >= len(data):
        return CUT
    bits = 0
    for k in range(size + 1):
        bits = bits << 8 | _byte(data, position + k)
    if size == 2 and not variable:
        # The numbers of six bits fill a byte each.
        for k in range(3):
            values[k] = sign_extended(bits >> (16 - 8 * k), 6)
        return position + 3
    first, second, third = 2, 2, 2
    if size == 1:
        first, second, third = (5, 5, 4) if variable else (4, 4, 4)
    elif size == 2:
        first, second, third = 8, 7, 7
    values[0] = sign_extended(bits >> (second + third), first)
    values[1] = sign_extended(bits >> third, second)
    values[2] = sign_extended(bits, third)
    return position + size + 1


@njit(cache=True)
def _quadruple(data: Bytes, position: int, values: Integers) -> int:
    """Four numbers of 0, 4, 8 or 16 bits, by the byte before them; returns the position behind them."""
    if position >= len(data):
        return CUT
    sizes = _byte(data, position)
    # Position in nibbles from here on, the higher one of a byte first.
    nibble = 2 * (position + 1)
    for k in range(4):
        tag = sizes >> (2 * k) & 3
        length = 0 if tag == 0 else 1 << (tag - 1)
        if nibble + length > 2 * len(data):
            return CUT
        value = 0
        for _ in range(length):
            byte = _byte(data, nibble >> 1)
            value = value << 4 | (byte & 0xF if nibble & 1 else byte >> 4)
            nibble += 1
        values[k] = sign_extended(value, 4 * length) if length else 0
    return (nibble + 1) >> 1


@njit(cache=True)
def read_fields(data: Bytes, position: int, encoding: Integers, count: int, values: Integers) -> int:
    """Residuals of the fields of a frame; returns the position behind the frame."""
    some = np.zeros(4, dtype=np.int64)
    place = 0
    while place < count and position >= 0:
        kind, group = encoding[place], 1
        if kind == SIGNED_VB:
            values[place], position = _read_signed(data, position)
        elif kind == UNSIGNED_VB:
            values[place], position = read_unsigned(data, position)
        elif kind == NEG_14BIT:
            value, position = read_unsigned(data, position)
            values[place] = -sign_extended(value, 14)
        elif kind == TAG8_8SVB:
            while group < 8 and place + group < count and encoding[place + group] == TAG8_8SVB:
                group += 1
            there = 1
            if group > 1:
                if position >= len(data):
                    return CUT
                there = _byte(data, position)
                position += 1
            for k in range(group):
                values[place + k] = 0
                if there >> k & 1 and position >= 0:
                    values[place + k], position = _read_signed(data, position)
        elif kind in (TAG2_3S32, TAG2_3SVARIABLE, TAG8_4S16):
            if kind == TAG8_4S16:
                group = 4
                position = _quadruple(data, position, some)
            else:
                group = 3
                position = _triple(data, position, kind == TAG2_3SVARIABLE, some)
            group = min(group, count - place)
            values[place : place + group] = some[:group]
        else:
            values[place] = 0
        place += group
    return position
