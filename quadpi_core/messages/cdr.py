# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Serialized messages (CDR, little-endian) as arrays, without a Python loop over messages.

A message whose only variable parts are strings and sequences has one byte layout per tuple of their lengths.
As those hardly change within a topic (frame names, rotors), N messages are N rows of bytes that a structured
dtype views in place. CDR: OMG formal/02-06-51, 15.3; the encapsulation is DDSI-RTPS, 10.5.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import SampleError
from quadpi_core.flight import Stamps
from quadpi_core.messages.payloads import Bytes, Indices, Payloads

Columns: TypeAlias = dict[str, npt.NDArray[Any]]
# Sequences of texts that end a message.
Texts: TypeAlias = tuple[tuple[str, ...], ...]

_ENCAPSULATION = b"\x00\x01\x00\x00"
ORIGIN = len(_ENCAPSULATION)
# A message that begins with a header begins with its stamp.
STAMP = struct.Struct("<iI")
NANOSECONDS = 1_000_000_000
_MICROSECOND = 1_000
# The seconds of a stamp in a message are int32.
_LAST_US = ((np.iinfo(np.int32).max + 1) * NANOSECONDS - 1) // _MICROSECOND
_DOUBLE = "<f8"
_DOUBLE_BYTES = 8
_PADDING_MAX = 3
_LENGTH = struct.Struct("<I")
_LENGTH_DTYPE = np.dtype("<u4")
# `Field.count` of a sequence.
ANY = -1


@dataclass(frozen=True)
class Field:
    """A field of a flattened message.

    `format` is a numpy dtype string, "string", or "strings" for a sequence of strings. `count` is None for
    one number, and :data:`ANY` for a sequence of numbers.
    """

    name: str
    format: str
    count: int | None = None

    @property
    def is_variable(self) -> bool:
        """Whether its length differs between messages."""
        return not self.is_number or self.count == ANY

    @cached_property
    def is_number(self) -> bool:
        """Whether it holds numbers, not text."""
        return self.format not in {"string", "strings"}

    @property
    def is_scalar(self) -> bool:
        """Whether it is one number."""
        return self.is_number and self.count is None

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """Type of a numeric field, with its shape; of a sequence, that of one number."""
        fixed = self.count is not None and self.count != ANY
        return np.dtype((self.format, (self.count,)) if fixed else self.format)

    @cached_property
    def alignment(self) -> int:
        """CDR aligns a number, alone or in an array, to its own size."""
        return self.dtype.base.itemsize


@dataclass(frozen=True)
class Layout:
    """Where each field of a message lies, for one tuple of the lengths of its texts and sequences.

    Attributes:
        dtype: structured, the size of a message; a sequence of strings is one field per string.
        template: (size,) bytes of a message of zeros, with its encapsulation and lengths.
        identifying: indices of the bytes that distinguish this layout: encapsulation and lengths.
        names: fields of `dtype` that are fields of the message.
        sequences: for each sequence of strings, the fields of `dtype` that hold them.
        counts: how many numbers each sequence of numbers holds, by name.
        doubles: the bytes of the float64 fields that end the message.
    """

    dtype: np.dtype[Any]
    template: Bytes
    identifying: Indices
    names: tuple[str, ...]
    sequences: dict[str, tuple[str, ...]]
    counts: dict[str, int]
    doubles: slice

    @property
    def last_length(self) -> tuple[slice, bytes]:
        """Where the last length lies, and its bytes."""
        span = slice(int(self.identifying[-_LENGTH.size]), int(self.identifying[-1]) + 1)
        return span, self.template[span].tobytes()

    def require(self, counts: Mapping[str, int], sample: int) -> None:
        """Refuse other lengths of the sequences of numbers than `counts`.

        Raises:
            SampleError: naming the sample and the sequence, what it holds and what was expected.
        """
        for name, found in self.counts.items():
            if found != counts[name]:
                raise SampleError(sample, f"`{name}` holds {found} values, expected {counts[name]}")


class Codec:
    """Encodes and decodes messages of one type, as a flat list of fields.

    :meth:`decode` and :meth:`encode` know every field by its name; :meth:`decode_stamped` and
    :meth:`encode_stamped` move all doubles at once. A sequence of numbers has the same length in all messages
    that are decoded together.

    Attributes:
        places: columns of the float64 fields of fixed length that end a message, by name.
        template: gives the layout for constants, and a message of them and zeros.
    """

    def __init__(self, type_name: str, fields: tuple[Field, ...]) -> None:
        self.type_name = type_name
        self._fields = fields
        self._variable = tuple(field for field in fields if field.is_variable)
        self._layout = lru_cache(maxsize=256)(self._build_layout)
        self.template = lru_cache(maxsize=256)(self._build_template)
        self.places = _places_of_doubles(fields)

    def decode(self, payloads: Payloads | bytes) -> Columns:
        """Decode N messages (or one) into an array of N rows per field.

        Strings come as bytes; a sequence of strings as an object array of tuples of bytes.

        Raises:
            SampleError: naming the sample whose bytes are no message of this type, or whose sequence of
                numbers is not as long as that of the first.
        """
        if isinstance(payloads, bytes):
            layout = self.layout_of(payloads, 0)
            return self._columns(layout, np.frombuffer(payloads, layout.dtype, count=1))
        if len(payloads) == 0:
            layout, _ = self.template(())
            return self._columns(layout, np.empty(0, layout.dtype))
        parts = [
            (order, self._columns(layout, rows.view(layout.dtype)[:, 0]))
            for order, layout, rows in self._row_parts(payloads)
        ]
        if len(parts) == 1:
            return parts[0][1]
        return {name: _reunite(name, parts) for name in parts[0][1]}

    def decode_stamped(
        self, payloads: Payloads | bytes, counts: Mapping[str, int] = MappingProxyType({})
    ) -> tuple[Stamps, npt.NDArray[np.float64]]:
        """Header stamps (N,), and a copy (N, K) of the float64 fields that end messages (:attr:`places`).

        Args:
            payloads: N messages, or one.
            counts: how many numbers each sequence of numbers must hold, by name.

        Raises:
            SampleError: naming the sample whose bytes are no message of this type, whose stamp is none, or
                whose sequences are of other lengths.
        """
        if isinstance(payloads, bytes):
            payloads = Payloads.join([payloads])
        time_ns = np.empty(len(payloads), dtype=np.int64)
        values = np.empty((len(payloads), self._ending(counts)))
        for order, layout, rows in self._row_parts(payloads, counts):
            stamp = np.ascontiguousarray(rows[:, ORIGIN : ORIGIN + STAMP.size])
            seconds, nanoseconds = stamp.view("<i4")[:, 0], stamp.view("<u4")[:, 1]
            beyond = nanoseconds >= NANOSECONDS
            if beyond.any():
                sample = int(np.argmax(beyond))
                raise no_stamp(int(order[sample]), int(nanoseconds[sample]))
            time_ns[order] = seconds.astype(np.int64) * NANOSECONDS + nanoseconds
            values[order] = np.ascontiguousarray(rows[:, layout.doubles]).view(_DOUBLE)
        return time_ns, values

    def encode_stamped(
        self,
        time_ns: Stamps,
        values: npt.NDArray[np.float64],
        constants: tuple[tuple[str, str | float | tuple[float, ...]], ...],
    ) -> Payloads:
        """Encode messages.

        Args:
            time_ns: (N,) header stamps.
            values: (N, K) the float64 fields that end the messages, see :attr:`places`.
            constants: other fields with their values, the same in all messages; of a sequence of numbers that
                ends them, as many as it holds.
        """
        layout, template = self.template(constants)
        rows = np.repeat(template[None], len(time_ns), axis=0)
        seconds, nanoseconds = np.divmod(time_ns, NANOSECONDS)
        stamps = np.stack((seconds, nanoseconds), axis=1).astype("<u4")
        rows[:, ORIGIN : ORIGIN + STAMP.size] = stamps.view(np.uint8)
        rows[:, layout.doubles] = values.view(np.uint8)
        return Payloads.from_rows(rows)

    def encode(self, count: int, columns: Mapping[str, Any]) -> Payloads:
        """Encode `count` messages; a text is one `str` (or a tuple of them) for all of them.

        Fields without a column are zero or empty. A sequence of numbers is a column (count, n).
        """
        variable = tuple(
            (field.name, (0.0,) * np.shape(column)[-1] if field.is_number else column)
            for field in self._variable
            if (column := columns.get(field.name)) is not None
        )
        layout, template = self.template(variable)
        rows = np.repeat(template[None], count, axis=0)
        table = rows.view(layout.dtype)[:, 0]
        for name, value in columns.items():
            if not isinstance(value, str | tuple):
                table[name] = value
        return Payloads.from_rows(rows)

    def encode_each(self, columns: Mapping[str, Any], texts: Sequence[Texts]) -> Payloads:
        """Encode messages that end with sequences of texts, each with its own.

        Args:
            columns: of the other fields, see :meth:`encode`.
            texts: of each message, its sequences.
        """
        messages, known = [], {}
        for head, sequences in zip(self.encode(len(texts), columns), texts, strict=True):
            # Of the sequences it has the lengths, which are zero.
            size = len(head) - _LENGTH.size * len(sequences)
            if sequences not in known:
                known[sequences] = _ending(size - ORIGIN, sequences)
            messages.append(head[:size] + known[sequences])
        return Payloads.join(messages)

    def _row_parts(
        self, payloads: Payloads, counts: Mapping[str, int] | None = None
    ) -> Iterator[tuple[Indices, Layout, Bytes]]:
        """Split messages by layout: (indices, layout, one row of bytes per message) of each part."""
        remaining = np.arange(len(payloads))
        while len(remaining):
            first = int(remaining[0])
            layout = self.layout_of(payloads[first], first)
            counts = layout.counts if counts is None else counts
            layout.require(counts, first)
            alike = remaining[payloads.lengths[remaining] == payloads.lengths[first]]
            rows = payloads.rows(alike, int(payloads.lengths[first]))
            matching = (rows[:, layout.identifying] == layout.template[layout.identifying]).all(axis=1)
            if not matching.all():
                alike, rows = alike[matching], rows[matching]
            yield alike, layout, rows[:, : len(layout.template)]
            remaining = np.setdiff1d(remaining, alike, assume_unique=True)

    def _columns(self, layout: Layout, table: npt.NDArray[Any]) -> Columns:
        columns = {name: table[name] for name in layout.names}
        for name, items in layout.sequences.items():
            column = np.empty(len(table), dtype=object)
            column[:] = list(zip(*(table[item].tolist() for item in items), strict=True)) or [()] * len(table)
            columns[name] = column
        return columns

    def layout_of(self, message: bytes, sample: int) -> Layout:
        """The layout of one message, found from the lengths that it holds."""
        if message[:2] != _ENCAPSULATION[:2]:
            raise SampleError(sample, f"not little-endian CDR (starts with {message[:4].hex(' ')})")
        lengths: list[int] = []

        def read_length(position: int) -> int:
            (length,) = _LENGTH.unpack_from(message, ORIGIN + position)
            if length > len(message):
                raise struct.error
            lengths.append(length)
            return int(length)

        try:
            for _ in self._walk(read_length):
                pass
            layout = self._layout(tuple(lengths))
        except struct.error:
            raise SampleError(sample, f"its {len(message)} bytes are no {self.type_name}") from None
        if not 0 <= len(message) - len(layout.template) <= _PADDING_MAX:
            counted = "".join(f" with {count} values of `{name}`" for name, count in layout.counts.items())
            raise SampleError(
                sample, f"{len(message)} bytes where {self.type_name}{counted} takes {len(layout.template)}"
            )
        return layout

    def _build_template(
        self, constants: tuple[tuple[str, str | float | tuple[str | float, ...]], ...]
    ) -> tuple[Layout, Bytes]:
        """The layout for some texts and numbers, and a message of them and zeros."""
        columns = dict(constants)
        layout = self._layout(_lengths(self._variable, columns))
        template = layout.template.copy()
        message = template.view(layout.dtype)
        for name, value in columns.items():
            items = {name: value}
            if name in layout.sequences and isinstance(value, tuple):
                items = dict(zip(layout.sequences[name], value, strict=True))
            for item_name, item in items.items():
                message[item_name] = item.encode() if isinstance(item, str) else item
        return layout, template

    def _build_layout(self, stored: tuple[int, ...]) -> Layout:
        remaining = iter(stored)
        places = list(self._walk(lambda _: next(remaining)))
        last = places[-1]
        size = ORIGIN + last.position + last.dtype.itemsize
        template = np.zeros(size, dtype=np.uint8)
        template[:ORIGIN] = np.frombuffer(_ENCAPSULATION, dtype=np.uint8)
        identifying = [0, 1]
        lengths = iter(stored)
        for place in places:
            if place.is_length:
                start = ORIGIN + place.position
                template[start : start + _LENGTH.size] = np.frombuffer(
                    _LENGTH.pack(next(lengths)), dtype=np.uint8
                )
                identifying.extend(range(start, start + _LENGTH.size))
        values = [place for place in places if not place.is_length]
        names = [place.name for place in values]
        dtype = np.dtype(
            {
                "names": names,
                "formats": [place.dtype for place in values],
                "offsets": [ORIGIN + place.position for place in values],
                "itemsize": size,
            }
        )
        sequences = {
            field.name: tuple(name for name in names if name.startswith(f"{field.name}."))
            for field in self._fields
            if field.format == "strings"
        }
        in_sequences = {item for items in sequences.values() for item in items}
        numbers = {field.name for field in self._variable if field.is_number}
        counts = {place.name: place.dtype.shape[0] for place in values if place.name in numbers}
        return Layout(
            dtype=dtype,
            template=template,
            identifying=np.array(identifying),
            names=tuple(name for name in names if name not in in_sequences),
            sequences=sequences,
            counts=counts,
            doubles=slice(size - _DOUBLE_BYTES * self._ending(counts), size),
        )

    def _ending(self, counts: Mapping[str, int]) -> int:
        """How many float64 values end a message whose sequences of numbers have these lengths."""
        last = self._fields[-1]
        return counts[last.name] if last.count == ANY else _width(self.places)

    def _walk(self, length_at: Callable[[int], int]) -> Iterator[_Place]:
        """Place numbers, texts and lengths one after the other, aligned by the rules of CDR.

        Args:
            length_at: gives the length stored at a position.
        """
        position, count = 0, 0
        for field in self._fields:
            if field.format == "strings" or field.count == ANY:
                position = _aligned(position, _LENGTH.size)
                count = length_at(position)
                yield _Place(field.name, _LENGTH_DTYPE, position, is_length=True)
                position += _LENGTH.size
            if field.is_number:
                dtype = np.dtype((field.dtype, (count,))) if field.count == ANY else field.dtype
                # Writers differ in whether they align a sequence of nothing.
                position = _aligned(position, field.alignment) if dtype.itemsize else position
                yield _Place(field.name, dtype, position)
                position += dtype.itemsize
                continue
            is_text = field.format == "string"
            for name in [field.name] if is_text else [f"{field.name}.{index}" for index in range(count)]:
                position = _aligned(position, _LENGTH.size)
                length = length_at(position)
                yield _Place(name, _LENGTH_DTYPE, position, is_length=True)
                position += _LENGTH.size
                yield _Place(name, np.dtype((np.bytes_, length)), position)
                position += length


def _places_of_doubles(fields: Sequence[Field]) -> dict[str, slice]:
    """Columns of the float64 fields at the end of a message, by name."""
    ending: list[Field] = []
    for field in reversed(fields):
        if field.format != _DOUBLE or field.is_variable:
            break
        ending.insert(0, field)
    places, start = {}, 0
    for field in ending:
        places[field.name] = slice(start, start + (field.count or 1))
        start = places[field.name].stop
    return places


def _width(places: Mapping[str, slice]) -> int:
    return max((place.stop for place in places.values()), default=0)


def no_stamp(sample: int, nanoseconds: int) -> SampleError:
    """The error of a stamp with that many nanoseconds."""
    return SampleError(sample, f"the stamp has {nanoseconds} ns beyond its second")


class _Place(NamedTuple):
    name: str
    dtype: np.dtype[Any]
    position: int
    is_length: bool = False


def _aligned(position: int, alignment: int) -> int:
    return -(-position // alignment) * alignment


def _ending(position: int, sequences: Texts) -> bytes:
    """Sequences of texts from a position in a message on."""
    ending = bytearray()
    for sequence in sequences:
        texts = [text.encode() + b"\0" for text in sequence]
        for length, content in ((len(texts), b""), *((len(text), text) for text in texts)):
            ending += bytes(-(position + len(ending)) % _LENGTH.size) + _LENGTH.pack(length) + content
    return bytes(ending)


def _lengths(variable: Iterable[Field], columns: Mapping[str, Any]) -> tuple[int, ...]:
    """The lengths in a message of these texts and sequences, in its order; a string counts its NUL."""
    lengths: list[int] = []
    for field in variable:
        items = (columns.get(field.name, ""),) if field.format == "string" else columns.get(field.name, ())
        if field.format != "string":
            lengths.append(len(items))
        if not field.is_number:
            lengths.extend(len(item.encode()) + 1 for item in items)
    return tuple(lengths)


def _reunite(name: str, parts: Sequence[tuple[Indices, Columns]]) -> npt.NDArray[Any]:
    """Put the rows of all parts back into the order of the messages."""
    columns = [part[name] for _, part in parts]
    dtype = np.result_type(*columns) if columns[0].dtype.kind == "S" else columns[0].dtype
    whole = np.empty((sum(map(len, columns)), *columns[0].shape[1:]), dtype=dtype)
    for (order, _), column in zip(parts, columns, strict=True):
        whole[order] = column
    return whole


def header_stamps(columns: Columns, prefix: str = "header.stamp.") -> Stamps:
    """Stamps (N,) from the columns of a builtin_interfaces/Time.

    Raises:
        SampleError: naming the sample, for a stamp that is none.
    """
    nanoseconds = columns[f"{prefix}nanosec"]
    _check_stamps(nanoseconds < NANOSECONDS, nanoseconds, "ns beyond its second")
    return columns[f"{prefix}sec"].astype(np.int64) * NANOSECONDS + nanoseconds


def microsecond_stamps(microseconds: npt.NDArray[np.uint64]) -> Stamps:
    """Stamps (N,) of a clock that counts microseconds.

    Raises:
        SampleError: naming the sample, for a stamp that no message can hold.
    """
    _check_stamps(microseconds <= _LAST_US, microseconds, "µs")
    return microseconds.astype(np.int64) * _MICROSECOND


def _check_stamps(usable: npt.NDArray[np.bool_], value: npt.NDArray[np.unsignedinteger], unit: str) -> None:
    if not usable.all():
        sample = int(np.argmin(usable))
        raise SampleError(sample, f"the stamp has {value[sample]} {unit}")
