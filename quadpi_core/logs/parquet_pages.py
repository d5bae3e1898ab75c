# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Unpacked size of a Parquet file, from its footer and the headers of its pages.

Readers allocate the size in a page's own header, not the one in the footer. Both are parsed here without
pyarrow, which crashes the process on some damaged footers.

Source: parquet.thrift, by whose numbers fields are named here; Thrift's compact protocol.
"""

from __future__ import annotations

from typing import Any

from quadpi_core.errors import LogError

_MAGIC = b"PAR1"
_ENDING = 8
# FileMetaData, RowGroup, ColumnChunk, ColumnMetaData, PageHeader.
_ROW_GROUPS = 4
_COLUMNS, _ROWS = 1, 3
_COLUMN = 3
_PACKED_COLUMN, _DATA_PAGE, _DICTIONARY_PAGE = 7, 9, 11
_UNPACKED, _PACKED = 2, 3
_TRUE, _FALSE, _BYTE, _I16, _I64, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 1, 2, 3, 4, 6, 7, 8, 9, 10, 12
_DEPTH_MAX = 12
_NUMBER_BYTES = 8
# Size of the shortest header of a page that is not empty.
_HEADER_MIN = 10


def unpacked_bytes(data: memoryview) -> int:
    """Bytes that a table takes: the sum of its pages, or its rows as numbers, whichever is more.

    Raises:
        LogError: naming the byte, for an invalid footer or page header.
    """
    if len(data) < _ENDING or bytes(data[-len(_MAGIC) :]) != _MAGIC:
        raise LogError("cut off, or no Parquet file: it has no footer")
    start = len(data) - _ENDING - int.from_bytes(data[-_ENDING : -len(_MAGIC)], "little")
    numbers, pages, count = 0, 0, 0
    try:
        for group in _struct(data, max(start, 0), 0)[0][_ROW_GROUPS]:
            numbers += max(group[_ROWS], 0) * len(group[_COLUMNS]) * _NUMBER_BYTES
            for chunk in group[_COLUMNS]:
                column = chunk[_COLUMN]
                start = column[_DATA_PAGE]
                if column.get(_DICTIONARY_PAGE, 0) > 0:
                    start = min(start, column[_DICTIONARY_PAGE])
                end = start + column[_PACKED_COLUMN]
                if not 0 <= start <= end <= len(data):
                    raise LogError(f"damaged: a column from byte {start} to {end} of {len(data)}")
                while start < end:
                    header, stop = _struct(data, start, 0)
                    if min(header[_UNPACKED], header[_PACKED]) < 0:
                        raise LogError(f"damaged: the page header at byte {start} names a negative size")
                    pages += header[_UNPACKED]
                    count += 1
                    if count * _HEADER_MIN > len(data):
                        raise LogError("damaged: its columns overlap")
                    start = stop + header[_PACKED]
    except (IndexError, KeyError, TypeError, AttributeError):
        raise LogError(f"damaged: the footer or page header at byte {start} is none") from None
    return max(numbers, pages)


def _struct(data: memoryview, position: int, depth: int) -> tuple[dict[int, Any], int]:
    """Values of a struct by field number, and the position behind it."""
    values: dict[int, Any] = {}
    field = 0
    while head := data[position]:
        position += 1
        kind, step = head & 0xF, head >> 4
        field += step
        if not step:
            field, position = _number(data, position)
        if kind in {_TRUE, _FALSE}:
            values[field] = kind == _TRUE
        else:
            values[field], position = _value(data, position, kind, depth + 1)
    return values, position + 1


def _value(data: memoryview, position: int, kind: int, depth: int) -> tuple[Any, int]:
    """A value (of text only the length), and the position behind it."""
    if depth > _DEPTH_MAX:
        raise IndexError
    if kind in {_TRUE, _FALSE, _BYTE}:
        return data[position], position + 1
    if _I16 <= kind <= _I64:
        return _number(data, position)
    if kind == _DOUBLE:
        return None, position + 8
    if kind == _BINARY:
        length, position = _varint(data, position)
        return length, position + length
    if kind == _STRUCT:
        return _struct(data, position, depth)
    if kind not in {_LIST, _SET}:
        raise IndexError
    head, position = data[position], position + 1
    count = head >> 4
    if count == 0xF:
        count, position = _varint(data, position)
    if count > len(data) - position:
        raise IndexError
    values = []
    for _ in range(count):
        value, position = _value(data, position, head & 0xF, depth + 1)
        values.append(value)
    return values, position


def _varint(data: memoryview, position: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
    raise IndexError


def _number(data: memoryview, position: int) -> tuple[int, int]:
    """A signed integer in zigzag encoding, and the position behind it."""
    value, position = _varint(data, position)
    return (value >> 1) ^ -(value & 1), position
