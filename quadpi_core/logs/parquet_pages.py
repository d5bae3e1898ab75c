# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How much the pages of a Parquet file unpack to, by what each page says of itself.

A reader takes memory for a page as large as its own header says, whatever the footer of the file says.

Source: parquet.thrift (PageHeader: field 2 is the size unpacked, 3 the size in the file), Thrift's compact
protocol.
"""

from __future__ import annotations

from typing import Any

from quadpi_core.errors import LogError

_UNPACKED, _PACKED = 2, 3
_TRUE, _FALSE, _BYTE, _I16, _I64, _DOUBLE, _BINARY, _LIST, _SET, _STRUCT = 1, 2, 3, 4, 6, 7, 8, 9, 10, 12
_DEPTH_MAX = 8
# Bytes of the shortest header of a page that holds something.
_HEADER_MIN = 10


def unpacked_bytes(data: memoryview, metadata: Any) -> int:
    """Bytes that all pages of all columns unpack to.

    Args:
        data: of the file.
        metadata: as pyarrow reads it.

    Raises:
        LogError: naming the byte, for a page header that is none.
    """
    total, pages = 0, 0
    for group in range(metadata.num_row_groups):
        for place in range(metadata.num_columns):
            column = metadata.row_group(group).column(place)
            start = column.data_page_offset
            if column.has_dictionary_page and column.dictionary_page_offset > 0:
                start = min(start, column.dictionary_page_offset)
            end = start + column.total_compressed_size
            if not 0 <= start <= end <= len(data):
                raise LogError(f"damaged: a column from byte {start} to {end} of {len(data)}")
            while start < end:
                try:
                    sizes, stop = _sizes(data, start)
                    unpacked, packed = sizes[_UNPACKED], sizes[_PACKED]
                except (IndexError, KeyError):
                    raise LogError(f"damaged: the page header at byte {start} is none") from None
                if unpacked < 0 or packed < 0:
                    raise LogError(f"damaged: the page header at byte {start} names a negative size")
                total += unpacked
                start = stop + packed
                pages += 1
                if pages * _HEADER_MIN > len(data):
                    raise LogError("damaged: its columns overlap")
    return total


def _sizes(data: memoryview, position: int) -> tuple[dict[int, int], int]:
    """Whole numbers of a struct by their field, and where it ends."""
    numbers: dict[int, int] = {}
    field = 0
    while head := data[position]:
        position += 1
        kind, step = head & 0xF, head >> 4
        field += step
        if not step:
            field, position = _number(data, position)
        if _I16 <= kind <= _I64:
            numbers[field], position = _number(data, position)
        else:
            position = _skip(data, position, kind, 0)
    return numbers, position + 1


def _skip(data: memoryview, position: int, kind: int, depth: int) -> int:
    """Where a value of a field ends."""
    if depth > _DEPTH_MAX:
        raise IndexError
    if kind in {_TRUE, _FALSE}:
        return position
    if kind == _BYTE:
        return position + 1
    if _I16 <= kind <= _I64:
        return _number(data, position)[1]
    if kind == _DOUBLE:
        return position + 8
    if kind == _BINARY:
        length, position = _varint(data, position)
        return position + length
    if kind in {_LIST, _SET}:
        head, position = data[position], position + 1
        count = head >> 4
        if count == 0xF:
            count, position = _varint(data, position)
        for _ in range(min(count, len(data))):
            position = _skip(data, position, head & 0xF if head & 0xF > _FALSE else _BYTE, depth + 1)
        return position
    if kind == _STRUCT:
        while head := data[position]:
            position += 1
            if not head >> 4:
                _, position = _number(data, position)
            position = _skip(data, position, head & 0xF, depth + 1)
        return position + 1
    raise IndexError


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
    """A whole number with a sign, in zigzag."""
    value, position = _varint(data, position)
    return (value >> 1) ^ -(value & 1), position
