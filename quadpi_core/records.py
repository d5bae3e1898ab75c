# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records: structured arrays whose fields are declared once, for numpy, the core and mypy.

A class names the fields, :func:`record_dtype` makes the dtype::

    class ImuSample:
        time_ns: int
        rates: Annotated[Array, 3]  # rad/s

    samples = np.zeros(500, record_dtype(ImuSample))

The core has a struct of the same fields in the same order, which is the same memory; Python hands its
functions an array of records, of length one if need be. One structured array costs a call less than half of
what its fields would as arrays of their own.
"""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass, fields
from functools import cache
from typing import Annotated, Any, Generic, TypeAlias, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.frames import Array

Records: TypeAlias = npt.NDArray[Any]
Vector3: TypeAlias = Annotated[Array, 3]
Quaternion4: TypeAlias = Annotated[Array, 4]


class _Rotors(int):
    """Length of an axis of a field that has a place for each rotor."""


# Room for the rotors of a vehicle: the first places are of its rotors, those beyond mean nothing.
ROTORS_MAX: int = _Rotors(compiled.ROTORS_MAX)
PerRotor: TypeAlias = Annotated[Array, ROTORS_MAX]

_NUMBERS: dict[Any, Any] = {
    bool: np.bool_,
    float: np.float64,
    int: np.int64,
    Array: np.float64,
    npt.NDArray[np.int64]: np.int64,
}


@cache
def record_dtype(declaration: type, rotors: int = ROTORS_MAX) -> np.dtype[np.void]:
    """The dtype of a class whose annotated fields are numbers, arrays and other such classes.

    `float` and `int` have 64 bits, `bool` has one byte, `Annotated[Array, 3, 3]` is an array of that shape,
    and `Annotated[Records, Other, 2]` an array of two records of another class. Where the first length is
    ROTORS_MAX, the field has as many places as there are rotors; the memory has room for all.

    Raises:
        TypeError: for a class without annotated fields.
    """
    fields, seen = [], []
    for name, hint in get_type_hints(declaration, include_extras=True).items():
        kind, shape = hint, []
        if get_origin(hint) is Annotated:
            kind, *shape = get_args(hint)
        if kind == Records:
            kind, *shape = shape
        whole = _NUMBERS[kind] if kind in _NUMBERS else record_dtype(kind)
        dtype = _NUMBERS[kind] if kind in _NUMBERS else record_dtype(kind, rotors)
        fields.append((name, whole, tuple(shape)))
        by_rotor = bool(shape) and isinstance(shape[0], _Rotors)
        seen.append(np.dtype((dtype, (rotors, *shape[1:]) if by_rotor else tuple(shape))))
    if not fields:
        raise TypeError(f"{declaration.__name__} declares no fields")
    layout = np.dtype(fields, align=True)
    names, offsets = list(layout.names or ()), [place[1] for place in (layout.fields or {}).values()]
    own: Any = {"names": names, "formats": seen, "offsets": offsets, "itemsize": layout.itemsize}
    return layout if rotors == ROTORS_MAX else np.dtype(own, align=True)


def columns_of(declaration: type) -> tuple[slice, ...]:
    """The columns of each field of a class in an array of its numbers, for kernels that treat all alike.

    Raises:
        TypeError: for a class with other fields than `float` and arrays of it.
    """
    columns, stop = [], 0
    for dtype, *_ in (record_dtype(declaration).fields or {}).values():
        if dtype.base != np.float64:
            raise TypeError(f"{declaration.__name__}: not all fields are float64")
        start, stop = stop, stop + dtype.itemsize // dtype.base.itemsize
        columns.append(slice(start, stop))
    return tuple(columns)


# A test finds every :class:`Threshold` of the package and fails when the value is changed or decides nothing.

Number = TypeVar("Number", float, int, tuple[float, ...])

# Data that many thresholds were set on: flights of the simulated Bebop 2 with hidden effects, whose seeds no
# published figure uses.
DEVELOPMENT = "development cases of the blind benchmark (experiments/discovery.py --development)"
CONVENTION = "none: a convention"


@dataclass(frozen=True)
class Threshold(Generic[Number]):
    """A number that decides.

    Attributes:
        name: in words.
        value: in its unit; several where they form a scale.
        unit: of the value.
        reason: for this value and no other.
        data: that it was set on.
    """

    name: str
    value: Number
    unit: str
    reason: str
    data: str


@dataclass(frozen=True)
class Column:
    """An attribute of a class with records `rows` (N,): a view of one of their fields, an array."""

    name: str

    def __get__(self, instance: Any, owner: type | None = None) -> Array:
        if instance is None:
            raise AttributeError(f"{self.name}: a column of the records of an instance")
        view: Array = instance.rows[self.name]
        return view


RATE_MAX_RAD_S = compiled.RATE_MAX_RAD_S
STANDARD_GRAVITY = compiled.STANDARD_GRAVITY
SPECIFIC_FORCE_MAX_M_S2 = compiled.SPECIFIC_FORCE_MAX_M_S2
AIRSPEED_MAX_M_S = compiled.AIRSPEED_MAX_M_S
POSITION_MAX_M = compiled.POSITION_MAX_M
MEASURED_SPEED_MAX_M_S = compiled.MEASURED_SPEED_MAX_M_S
# Of a state. What an estimator is given may be off by any scale: it is normalised.
QUATERNION_NORM_TOLERANCE = compiled.QUATERNION_NORM_TOLERANCE
# Of an attitude in a log or message.
NORM_TOLERANCE = compiled.NORM_TOLERANCE


LONGEST = 200
_WORD_MAX = 40


def brief_repr(record: Any) -> str:
    """A dataclass or named tuple in one line of at most :data:`LONGEST` characters; for its `__repr__`.

    Numbers and words stand as they are, arrays as their shapes, collections as how many they hold.
    """
    named = isinstance(record, tuple)
    names = record._fields if named else [column.name for column in fields(record) if column.repr]
    text = f"{type(record).__name__}("
    for place, name in enumerate(names):
        part = f"{', ' if place else ''}{name}={_brief(getattr(record, name))}"
        if len(text) + len(part) > LONGEST - len(", …)"):
            return f"{text}, …)"
        text += part
    return f"{text})"


def _brief(value: Any) -> str:
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    if value is None or isinstance(value, (str, int, float, np.generic)):
        text = repr(value)
        return text if len(text) <= _WORD_MAX else f"{text[: _WORD_MAX - 1]}…"
    count = f" of {len(value)}" if isinstance(value, Sized) else ""
    return f"<{type(value).__name__}{count}>"
