# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Matrices of real numbers out of MATLAB files of level 5 (`save -v6` and `-v7`), with every size checked.

scipy's reader trusts the lengths in a file: one that is damaged can end the process.

Source: MathWorks, "MAT-File Format", level 5.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError, one_line
from quadpi_core.logs.unpacking import require_unpackable, unpacked_limit, unzlib

_HEADER_BYTES = 128
_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_BYTE_ORDERS = MappingProxyType({b"IM": "<", b"MI": ">"})
_LEVEL_5 = 0x0100
_TAG_BYTES = 8
_MATRIX, _COMPRESSED = 14, 15
_INT8, _INT32, _UINT32 = 1, 5, 6
_NUMBERS = MappingProxyType(
    {
        1: "i1",
        2: "u1",
        3: "i2",
        4: "u2",
        5: "i4",
        6: "u4",
        7: "f4",
        9: "f8",
        12: "i8",
        13: "u8",
    }
)
_CLASSES = MappingProxyType({1: "cell array", 2: "struct", 3: "object", 4: "text", 5: "sparse matrix"})
_NUMERIC_CLASSES = MappingProxyType(
    {
        6: "f8",
        7: "f4",
        8: "i1",
        9: "u1",
        10: "i2",
        11: "u2",
        12: "i4",
        13: "u4",
        14: "i8",
        15: "u8",
    }
)
_STRUCT = 2
_COMPLEX = 0x0800
# Structs within structs; loggers write two or three.
_DEPTH_MAX = 8
_NAME_MAX = 63


class Variable(NamedTuple):
    """A variable: its name, what MATLAB calls its kind, and its numbers where it is a real matrix.

    Fields of a struct are variables `STRUCT.FIELD`.
    """

    name: str
    kind: str
    values: npt.NDArray[Any] | None


class _Element(NamedTuple):
    kind: int
    data: memoryview


def read_matlab(data: bytes) -> list[Variable]:
    """The variables of a file.

    Raises:
        LogError: if it is of another version, cut off or damaged, or unpacks to too much.
    """
    if data.startswith(_HDF5_MAGIC) or data[:10] == b"MATLAB 7.3":
        raise LogError("a MATLAB 7.3 file (HDF5): save it with `-v7`")
    order = _BYTE_ORDERS.get(data[_HEADER_BYTES - 2 : _HEADER_BYTES])
    if order is None or struct.unpack_from(f"{order}H", data, _HEADER_BYTES - 4)[0] != _LEVEL_5:
        raise LogError("not a readable MATLAB 5 file: its header is of another version")
    variables: list[Variable] = []
    unpacked_bytes = 0
    for element in _elements(memoryview(data)[_HEADER_BYTES:], order):
        matrices = [element]
        if element.kind == _COMPRESSED:
            most = unpacked_limit(len(data))
            try:
                content = unzlib(element.data, most + 1)
            except zlib.error as error:
                raise LogError(f"not a readable MATLAB 5 file: {one_line(error)}") from error
            unpacked_bytes += len(content)
            require_unpackable(len(data), unpacked_bytes)
            matrices = list(_elements(memoryview(content), order))
        for matrix in matrices:
            variables += _variables(matrix.data, order) if matrix.kind == _MATRIX else []
    return variables


def _elements(data: memoryview, order: str) -> Iterator[_Element]:
    """The data elements of a section, one after the other."""
    position = 0
    while position < len(data):
        if len(data) - position < _TAG_BYTES:
            raise LogError("not a readable MATLAB 5 file: it is cut off")
        kind, length = struct.unpack_from(f"{order}II", data, position)
        start = position + _TAG_BYTES
        if kind >> 16:  # the small format: kind and length share four bytes, and the data are the next four
            kind, length, start = kind & 0xFFFF, kind >> 16, position + 4
            if length > 4:
                raise LogError("not a readable MATLAB 5 file: a small element is longer than 4 bytes")
        if length > len(data) - start:
            raise LogError("not a readable MATLAB 5 file: an element runs beyond its section")
        yield _Element(kind, data[start : start + length])
        padding = 0 if kind == _COMPRESSED else -(start + length) % _TAG_BYTES
        position = start + length + padding


def _variables(data: memoryview, order: str, above: str = "", depth: int = 0) -> list[Variable]:
    """A variable by the elements of its matrix: flags, dimensions, name, real part; or fields of a struct."""
    if above and not len(data):
        return [Variable(above, "empty matrix", None)]
    elements = _elements(data, order)
    flags, dimensions, name = (next(elements, None) for _ in range(3))
    if (
        flags is None
        or dimensions is None
        or name is None
        or (flags.kind, dimensions.kind, name.kind) != (_UINT32, _INT32, _INT8)
        or len(flags.data) != 8
        or len(dimensions.data) % 4
        or len(name.data) > _NAME_MAX
    ):
        raise LogError("not a readable MATLAB 5 file: a variable has no whole head")
    text = above or bytes(name.data).decode(errors="replace")
    (word,) = struct.unpack_from(f"{order}I", flags.data)
    kind = word & 0xFF
    shape = np.frombuffer(dimensions.data, f"{order}i4").tolist()
    if kind == _STRUCT and shape == [1, 1] and depth < _DEPTH_MAX:
        fields = zip(_field_names(text, elements, order), elements, strict=False)
        return [
            variable
            for field, element in fields
            if element.kind == _MATRIX
            for variable in _variables(element.data, order, f"{text}.{field}", depth + 1)
        ]
    return [_numbers_of(text, word, shape, next(elements, None), order)]


def _field_names(struct_name: str, elements: Iterator[_Element], order: str) -> list[str]:
    """Names of the fields of a struct, each padded to the same number of bytes."""
    size, names = next(elements, None), next(elements, None)
    if size is None or names is None or size.kind != _INT32 or names.kind != _INT8 or len(size.data) != 4:
        raise LogError(f"not a readable MATLAB 5 file: the struct {struct_name} has no names of fields")
    (length,) = struct.unpack_from(f"{order}i", size.data)
    if not 0 < length <= _NAME_MAX + 1:
        raise LogError(f"not a readable MATLAB 5 file: the struct {struct_name} has no names of fields")
    text = bytes(names.data)
    padded = (text[start : start + length] for start in range(0, len(text), length))
    return [one.partition(b"\0")[0].decode(errors="replace") for one in padded]


def _numbers_of(text: str, word: int, shape: list[int], numbers: _Element | None, order: str) -> Variable:
    """A variable that is no struct: its numbers, if it is a real matrix."""
    kind = word & 0xFF
    if kind not in _NUMERIC_CLASSES or word & _COMPLEX:
        known = "complex matrix" if kind in _NUMERIC_CLASSES else _CLASSES.get(kind, f"class {kind}")
        return Variable(text, known, None)
    if len(shape) != 2:
        return Variable(text, f"array of {len(shape)} dimensions", None)
    dtype = np.dtype(f"{order}{_NUMBERS[numbers.kind]}") if numbers and numbers.kind in _NUMBERS else None
    # In Python's whole numbers, which do not overflow.
    if numbers is None or dtype is None or min(shape, default=-1) < 0:
        raise LogError(f"not a readable MATLAB 5 file: {text} has no numbers")
    if math.prod(shape) * dtype.itemsize != len(numbers.data):
        raise LogError(
            f"not a readable MATLAB 5 file: {text} is said to be {' by '.join(map(str, shape))}, but has "
            f"{len(numbers.data)} bytes of numbers"
        )
    # Whole numbers are stored in fewer bytes than those of the class.
    values = np.frombuffer(numbers.data, dtype).reshape(shape, order="F").astype(_NUMERIC_CLASSES[kind])
    return Variable(text, "matrix", values)
