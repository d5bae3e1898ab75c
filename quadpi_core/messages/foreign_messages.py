# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages of types that other packages define (ESC reports, rigid bodies), deserialised by rosbags.

They may hold arrays of messages, and their definition comes with the bag or from the package. About 10 µs a
message is fast enough for topics of 50 to 500 Hz; :mod:`quadpi_core.messages.cdr` has the codec for our own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import TypesysError
from rosbags.typesys.store import Typestore

from quadpi_core.errors import LogError, SampleError, one_line
from quadpi_core.messages.cdr import Columns
from quadpi_core.messages.definitions import FORMATS, ITEMS_MAX, parsed_definition, typestore
from quadpi_core.messages.payloads import Indices, Payloads

_REASON_LENGTH = 80


@dataclass(frozen=True)
class Items:
    """The items of one array in N messages.

    Attributes:
        counts: (N,) number of items in each message.
        columns: (M, ...) one row per item, message after message.
    """

    counts: Indices
    columns: Columns

    @property
    def message(self) -> Indices:
        """(M,) the message that each item is of."""
        return np.repeat(np.arange(len(self.counts)), self.counts)


@dataclass(frozen=True)
class _Column:
    """How a column is taken out of messages, or out of the items of an array.

    Attributes:
        shape: of one row: () for a number, (n,) for n of them, (0,) for text.
    """

    value_of: Callable[[Any], Any]
    dtype: np.dtype[Any]
    shape: tuple[int, ...]

    def values(self, owners: Sequence[object]) -> npt.NDArray[Any]:
        found = [self.value_of(owner) for owner in owners]
        if self.dtype.kind == "S":
            return np.array([text.encode() for text in found], dtype=np.bytes_)
        return np.array(found, dtype=self.dtype).reshape(-1, *self.shape)


class ForeignCodec:
    """Decodes messages of one type, at most one array of messages deep.

    Args:
        type_name: of the message.
        types: definitions of the type and all that it contains.
        wanted: see :func:`foreign_codec`.
    """

    def __init__(self, type_name: str, types: Typesdict, wanted: Mapping[str, int]) -> None:
        self._type_name = type_name
        # Beyond this a sequence is noise, and rosbags would make an object of each item.
        self._store = Typestore(max_sequence_length=ITEMS_MAX)
        self._store.register(types)
        self._top: dict[str, _Column] = {}
        self._arrays: dict[str, dict[str, _Column]] = {}
        fields = dict(types[type_name][1])
        for path, width in wanted.items():
            array, _, member = path.partition(".")
            match fields.get(array):
                case (Nodetype.ARRAY | Nodetype.SEQUENCE, ((Nodetype.NAME, str(item)), _)) if member:
                    column = _column(types, item, member)
                    place = self._arrays.setdefault(array, {}), member
                case _:
                    column = _column(types, type_name, path)
                    place = self._top, path
            if column is None or width != (column.shape[0] if column.shape else 1):
                raise LogError(f"this version of {type_name} has no field {path} of the kind known here")
            place[0][place[1]] = column

    def decode(self, payloads: Payloads | bytes) -> tuple[Columns, dict[str, Items]]:
        """Decode N > 0 messages (or one): columns of what is in no array, and the items of each array.

        Raises:
            SampleError: naming the sample whose bytes are no message of this type.
        """
        messages = []
        for sample, payload in enumerate((payloads,) if isinstance(payloads, bytes) else payloads):
            try:
                messages.append(self._store.deserialize_cdr(payload, self._type_name))
            except Exception as error:  # rosbags raises many kinds on damaged bytes
                raise SampleError(sample, f"its {len(payload)} bytes are no {self._type_name}") from error
        columns = {path: column.values(messages) for path, column in self._top.items()}
        return columns, {name: _items(name, members, messages) for name, members in self._arrays.items()}


@cache
def foreign_codec(type_name: str, definition: str, wanted: tuple[tuple[str, int], ...]) -> ForeignCodec:
    """The codec of a type that others define.

    Args:
        type_name: such as `px4_msgs/msg/EscStatus`.
        definition: of that type and all that it contains, as a bag embeds it (`ros2msg`).
        wanted: columns to decode, by path (`timestamp`, `esc.esc_rpm` for the items of `esc`), and how many
            numbers each has; 0 for text.

    Raises:
        LogError: for a definition that cannot be used, or lacks a wanted column.
    """
    try:
        types = _with_standard_types(parsed_definition(type_name, definition))
        return ForeignCodec(type_name, types, dict(wanted))
    except (TypesysError, TypeError, KeyError, RecursionError, SyntaxError) as error:
        reason = one_line(error)[:_REASON_LENGTH]
        raise LogError(f"the definition of {type_name} cannot be used: {reason}") from error


def _with_standard_types(types: Typesdict) -> Typesdict:
    """The types, and those of ROS 2 that they refer to without defining them."""
    known = typestore().fielddefs
    whole = dict(types)
    waiting = list(types)
    while waiting:
        for _, description in whole[waiting.pop()][1]:
            match description:
                case (Nodetype.NAME, str(name)) | (_, ((Nodetype.NAME, str(name)), _)) if name not in whole:
                    whole[name] = known[name]
                    waiting.append(name)
    return whole


def _column(types: Typesdict, type_name: str, path: str) -> _Column | None:
    """A column by its path below a type; None for a path that leads to no numbers and no text.

    A message whose members are all numbers of one type, as a vector is, makes one column.
    """
    description: Any = (Nodetype.NAME, type_name)
    for name in path.split("."):
        fields = dict(types[description[1]][1]) if description[0] == Nodetype.NAME else {}
        description = fields.get(name, (None, None))
    match description:
        case (Nodetype.BASE, ("string", _)):
            return _Column(attrgetter(path), np.dtype("S"), (0,))
        case (Nodetype.BASE, (str(base), _)) if base in FORMATS:
            return _Column(attrgetter(path), np.dtype(FORMATS[base]), ())
        case (Nodetype.ARRAY, ((Nodetype.BASE, (str(base), _)), int(count))) if base in FORMATS:
            return _Column(attrgetter(path), np.dtype(FORMATS[base]), (count,))
        case (Nodetype.NAME, str(contained)):
            names, members = zip(*types[contained][1], strict=True)
            base = members[0][1][0]
            if len(members) > 1 and base in FORMATS and set(members) == {(Nodetype.BASE, (base, 0))}:
                values_of = attrgetter(*(f"{path}.{name}" for name in names))
                return _Column(values_of, np.dtype(FORMATS[base]), (len(members),))
    return None


def _items(array: str, members: Mapping[str, _Column], messages: Sequence[object]) -> Items:
    arrays = [getattr(message, array) for message in messages]
    counts = np.array([len(items) for items in arrays], dtype=np.int64)
    items = [item for each in arrays for item in each]
    return Items(counts, {name: column.values(items) for name, column in members.items()})
