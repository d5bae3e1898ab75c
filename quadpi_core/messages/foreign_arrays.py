# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Serialized messages that hold arrays of messages: ESC reports, rigid bodies.

As in `messages.cdr`, a layout follows from the lengths that a message holds; those of arrays are
among them. Items of N messages come as flat columns, message after message.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from quadpi_core.messages.cdr import Codec, Columns, Field, Layout, _aligned, _Place, _reunite
from quadpi_core.messages.payloads import Bytes, Indices, Payloads

# No vehicle has more speed controllers, and no flying arena more bodies or markers: a larger count is noise.
ITEMS_MAX = 1024
PLACES_MAX = 100_000

_LENGTH = np.dtype("<u4")


@dataclass(frozen=True)
class ItemsField(Field):
    """An array of messages: `count` of them, or as many as the message says; members by their own names."""

    members: tuple[Field, ...] = ()

    @cached_property
    def is_number(self) -> bool:
        """Whether it holds numbers: an array of messages does not."""
        return False


class Gather(NamedTuple):
    """Takes one column of the items of an array out of messages of one layout.

    Attributes:
        places: (items, bytes) where the bytes of each item lie.
        mask: (items, bytes) 0 beyond the end of a text that is shorter than others, else 1; None for numbers.
        dtype: of an element.
        shape: of an item: () for a scalar or a text.
    """

    places: Indices
    mask: Bytes | None
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    def __call__(self, rows: Bytes) -> npt.NDArray[Any]:
        """Items (n, items, ...) of n messages (n, length)."""
        found = np.take(rows, self.places, axis=1)
        if self.mask is not None:
            found *= self.mask
        return found.view(self.dtype).reshape(*found.shape[:2], *self.shape)


@dataclass(frozen=True)
class ArrayLayout(Layout):
    """A layout that takes columns out of messages.

    Attributes:
        counts: how many items each array has.
        columns: by path, those of items (`esc.esc_rpm`) and those of what is in no array.
    """

    counts: dict[str, int]
    columns: dict[str, Gather]


@dataclass(frozen=True)
class Items:
    """The items of one array in N messages.

    Attributes:
        counts: (N,) how many each message has.
        columns: (M, ...) one row per item, message after message.
    """

    counts: Indices
    columns: Columns

    @property
    def message(self) -> Indices:
        """(M,) the message that each item is of."""
        return np.repeat(np.arange(len(self.counts)), self.counts)


class ArrayCodec(Codec):
    """Decodes messages of one type with arrays of messages in it, at the top level or in each other.

    Args:
        type_name: of the message.
        fields: see :class:`Codec`.
        wanted: columns to decode, by path: `timestamp`, `esc.esc_rpm`; the others are passed over.
    """

    def __init__(self, type_name: str, fields: tuple[Field, ...], wanted: Collection[str]) -> None:
        arrays = [field for field in fields if isinstance(field, ItemsField)]
        self.columns = {field.name: field for field in fields} | {
            f"{array.name}.{member.name}": member for array in arrays for member in array.members
        }
        self._top = tuple(field.name for field in fields if field.name in wanted)
        self._members = {
            array.name: {
                member.name: path
                for member in array.members
                if (path := f"{array.name}.{member.name}") in wanted
            }
            for array in arrays
        }
        super().__init__(type_name, fields)

    def decode_arrays(self, payloads: Payloads | bytes) -> tuple[Columns, dict[str, Items]]:
        """Decode N > 0 messages (or one): columns of what is in no array, and the items of each array.

        Raises:
            LogError: naming the sample whose bytes are no message of this type.
        """
        if isinstance(payloads, bytes):
            layout = self._layout_of(payloads, 0)
            rows = np.frombuffer(payloads, np.uint8, count=len(layout.template))[np.newaxis]
            parts = [(np.zeros(1, dtype=np.int64), cast(ArrayLayout, layout), rows)]
        else:
            parts = [
                (order, cast(ArrayLayout, layout), rows) for order, layout, rows in self._row_parts(payloads)
            ]
        top = _joined(
            [
                (order, {name: layout.columns[name](rows)[:, 0] for name in self._top})
                for order, layout, rows in parts
            ]
        )
        return top, {array: _items(array, members, parts) for array, members in self._members.items()}

    def _build_layout(self, text_lengths: tuple[int, ...]) -> Layout:
        plain = super()._build_layout(text_lengths)
        counts = dict.fromkeys(self._members, 0)
        found: dict[str, list[str]] = {path: [] for path in self._top}
        found |= {path: [] for members in self._members.values() for path in members.values()}
        for name in plain.names:
            array = next((array for array in counts if name.startswith(f"{array}.")), None)
            path = name
            if array is not None:
                index, _, member = name.removeprefix(f"{array}.").partition(".")
                counts[array] = max(counts[array], int(index) + 1)
                path = f"{array}.{member}"
            if path in found:
                found[path].append(name)
        columns = {path: _gather(plain, self.columns[path], names) for path, names in found.items()}
        known = {field.name: getattr(plain, field.name) for field in fields(plain)}
        return ArrayLayout(**known, counts=counts, columns=columns)

    def _walk(self, length_at: Callable[[int], int]) -> Iterator[_Place]:
        places: list[_Place] = []
        self._place(self._fields, "", 0, length_at, places)
        return iter(places)

    def _place(
        self,
        members: Iterable[Field],
        item: str,
        position: int,
        length_at: Callable[[int], int],
        places: list[_Place],
    ) -> int:
        """Place the members of one item, or of the message, from a position on; where they end.

        Args:
            members: in their order.
            item: its path, such as `esc.3`; empty for the message itself.
            position: of the first byte.
            length_at: gives the length that stands at a position.
            places: takes what is placed.
        """

        def place_length(name: str) -> int:
            nonlocal position
            position = _aligned(position, _LENGTH.itemsize)
            length = length_at(position)
            places.append(_Place(name, _LENGTH, position, is_length=True))
            position += _LENGTH.itemsize
            return length

        for field in members:
            name = f"{item}.{field.name}" if item else field.name
            if field.is_number:
                position = _aligned(position, field.alignment)
                places.append(_Place(name, field.dtype, position))
                position += field.dtype.itemsize
            elif isinstance(field, ItemsField):
                count = place_length(name) if field.count is None else field.count
                if count > ITEMS_MAX:
                    raise struct.error
                for index in range(count):
                    if len(places) > PLACES_MAX:
                        raise struct.error
                    position = self._place(field.members, f"{name}.{index}", position, length_at, places)
            elif field.format == "string":
                length = place_length(name)
                places.append(_Place(name, np.dtype((np.bytes_, length)), position))
                position += length
            else:
                raise TypeError(f"{self.type_name}: {name}: there is no codec for this kind of field")
        return position


def _gather(layout: Layout, field: Field, names: Sequence[str]) -> Gather:
    """Takes the fields `names` of a layout, each of another item, as one column."""
    places = [cast(Any, layout.dtype.fields)[name] for name in names]
    starts = np.array([offset for _, offset, *_ in places], dtype=np.int64)
    if field.is_number:
        index = starts[:, np.newaxis] + np.arange(field.dtype.itemsize)
        return Gather(index, None, field.dtype.base, field.dtype.shape)
    lengths = np.array([dtype.itemsize for dtype, *_ in places], dtype=np.int64)
    offsets = np.arange(max(lengths.max(initial=0), 1))
    mask = offsets < lengths[:, np.newaxis]
    index = np.where(mask, starts[:, np.newaxis] + offsets, 0)
    return Gather(index, mask.astype(np.uint8), np.dtype((np.bytes_, len(offsets))), ())


def _items(array: str, members: dict[str, str], parts: Sequence[tuple[Indices, ArrayLayout, Bytes]]) -> Items:
    """The items of one array, its wanted members given by their names and paths."""
    counts = np.zeros(sum(len(order) for order, _, _ in parts), dtype=np.int64)
    for order, layout, _ in parts:
        counts[order] = layout.counts[array]
    starts = np.cumsum(counts) - counts
    flat = []
    for order, layout, rows in parts:
        places = (starts[order][:, np.newaxis] + np.arange(layout.counts[array])).reshape(-1)
        found = {member: layout.columns[path](rows) for member, path in members.items()}
        flat.append((places, {name: values.reshape(-1, *values.shape[2:]) for name, values in found.items()}))
    return Items(counts, _joined(flat))


def _joined(parts: Sequence[tuple[Indices, Columns]]) -> Columns:
    """Columns of which each part holds some rows."""
    if len(parts) == 1:
        return parts[0][1]
    return {name: _reunite(name, parts) for name in parts[0][1]}
