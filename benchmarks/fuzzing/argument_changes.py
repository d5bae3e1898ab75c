# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Calls, and random changes to their arguments, each with what the call must then do."""

from __future__ import annotations

import atexit
import random
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt


class Must(IntEnum):
    """What a call must do; of several changes the highest counts."""

    GIVE_THE_SAME = 0  # as with the clean arguments
    END_WELL = 1  # give finite numbers, or refuse
    REFUSE = 2  # with a QuadpiError
    REFUSE_AS_PYTHON = 3  # with a TypeError: arguments are missing, or too many


Changed = tuple[Any, Must]


@dataclass(frozen=True)
class Argument:
    """A parameter of a call.

    Attributes:
        clean: a value that is right.
        change: gives another one, and what the call must do with it.
        kind: arguments of different kinds may not take each other's place.
        required: whether the call cannot do without.
    """

    clean: Any
    change: Callable[[random.Random, Any], Changed]
    kind: str
    required: bool = True


@dataclass(frozen=True)
class Rows:
    """Changes to an array (N, …).

    Attributes:
        tied: whether N is that of another argument, or fixed.
        finite: whether numbers that are not finite are refused.
        optional: whether None may stand for the array.
        exact: whether nothing but an array of these numbers is taken, no list, no int for a float.
    """

    tied: bool = True
    finite: bool = True
    optional: bool = False
    exact: bool = False

    def __call__(self, rng: random.Random, array: npt.NDArray[Any]) -> Changed:
        """One change."""
        if rng.random() < 0.5:
            same = rng.choice(_SAME)(array)
            return same, Must.REFUSE if self.exact and isinstance(same, list) else Must.GIVE_THE_SAME
        return rng.choice((self._rows, self._shape, self._numbers, self._values))(rng, array)

    def _rows(self, rng: random.Random, array: npt.NDArray[Any]) -> Changed:
        count = len(array)
        other = rng.choice((0, 1, 2, count - 1, count + 1, 2 * count, 20 * count, rng.randrange(3 * count)))
        if other == count:
            return array, Must.GIVE_THE_SAME
        return np.resize(array, (other, *array.shape[1:])), Must.REFUSE if self.tied else Must.END_WELL

    def _shape(self, rng: random.Random, array: npt.NDArray[Any]) -> Changed:
        shapes = [array[None], array[:, None], array[..., None], np.broadcast_to(array, (2, *array.shape))]
        if array.ndim > 1:
            width = array.shape[1]
            shapes += [
                array[:, : width - 1],
                np.resize(array, (len(array), width + 1)),
                array[:, 0],
                array.ravel(),
            ]
            if array.shape[0] != width:
                shapes.append(array.T)
        return rng.choice(shapes), Must.REFUSE

    def _numbers(self, rng: random.Random, array: npt.NDArray[Any]) -> Changed:
        if array.dtype.names is not None:
            names = list(array.dtype.names)
            records = [array[names[::-1]], array[names[1:]], array.view(np.float64).reshape(len(array), -1)]
            records.append(array.astype([(name, np.int64, array.dtype[name].shape) for name in names]))
            return rng.choice(records), Must.REFUSE
        others: list[Any] = [
            array.astype(bool),
            array + 0j,
            array.astype(str),
            array.astype("S8"),
            array.astype(object),
        ]
        others += [np.zeros(array.shape, "datetime64[ns]"), np.zeros(array.shape, [("a", float)])]
        if array.dtype.kind == "i":
            others += [array.astype(float), 1e-9 * array, np.full(array.shape, np.nan)]
        if array.dtype.kind == "b":
            others = [array.astype(int), array.astype(float), array.astype(str)]
        return rng.choice(others), Must.REFUSE

    def _values(self, rng: random.Random, array: npt.NDArray[Any]) -> Changed:
        if rng.random() < 0.3:
            wrong = rng.choice(
                (None, "a.mcap", 5, 1.5, True, {}, object(), b"x", [[1.0], [1.0, 2.0]], Path("a"))
            )
            return (array, Must.GIVE_THE_SAME) if wrong is None and self.optional else (wrong, Must.REFUSE)
        if array.dtype.kind in "ib":
            return array[::-1].copy(), Must.END_WELL
        changed = array.copy()
        # Of records a field: what lies between the fields means nothing.
        names = changed.dtype.names
        field = changed[rng.choice(names)] if names else changed
        value = rng.choice((np.nan, np.inf, -np.inf, 1e300, -1e300, 1e30, 0.0, 5e-324, 1e6))
        field[np.unravel_index(rng.randrange(field.size), field.shape)] = value
        if self.finite and not np.isfinite(value):
            return changed, Must.REFUSE
        return changed, Must.END_WELL


def _read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    array = array.copy()
    array.flags.writeable = False
    return array


def _unaligned(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    memory = np.zeros(array.nbytes + 1, np.uint8)
    shifted = memory[1:].view(array.dtype).reshape(array.shape)
    shifted[:] = array
    return shifted


def _wider(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A view of every other column of a larger array."""
    larger = np.zeros((*array.shape, 2), array.dtype)
    larger[..., 0] = array
    return larger[..., 0]


def _narrow(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The same numbers with fewer bits: those of clean arrays fit."""
    if array.dtype.names is not None:
        kinds = [(name, array.dtype[name].base.kind, array.dtype[name].shape) for name in array.dtype.names]
        return array.astype(
            [(name, "f4", shape) for name, kind, shape in kinds if kind == "f"]
            if all(kind == "f" for _, kind, _ in kinds)
            else array.dtype
        )
    return array.astype(np.float32) if array.dtype.kind == "f" else array


def _list(array: npt.NDArray[Any]) -> Any:
    return array if array.dtype.names is not None else array.tolist()


_SAME: Sequence[Callable[[npt.NDArray[Any]], Any]] = (
    lambda array: array.astype(array.dtype.newbyteorder(">")),
    lambda array: np.repeat(array, 2, axis=0)[::2],
    lambda array: array[::-1].copy()[::-1],
    np.asfortranarray,
    _read_only,
    _unaligned,
    _wider,
    _narrow,
    _list,
    lambda array: array if array.dtype.names is not None else np.ma.masked_array(array),
)


@dataclass(frozen=True)
class Number:
    """Changes to a number: others of its kind may give other results, what is none is refused.

    Attributes:
        others: numbers that the call may take.
        refused: numbers that it must not.
        optional: whether None may stand for it.
    """

    others: Sequence[float] = ()
    refused: Sequence[float] = (float("nan"), float("inf"))
    optional: bool = False

    def __call__(self, rng: random.Random, value: Any) -> Changed:
        """One change."""
        kind = rng.random()
        if kind < 0.3:
            same = rng.choice((np.float64(value), np.array(value)[()], value))
            return (np.int64(value) if isinstance(value, int) else same), Must.GIVE_THE_SAME
        if kind < 0.5 and self.others:
            return rng.choice(self.others), Must.END_WELL
        if kind < 0.7:
            return rng.choice(self.refused), Must.REFUSE
        wrong = rng.choice(("0.95", [value], (value,), np.array([value]), {}, object(), b"1", 1j, True, None))
        return wrong, Must.END_WELL if wrong is None and self.optional else Must.REFUSE


_NO_OBJECTS: Sequence[Any] = (
    *(None, "bebop2", "", 5, 1.5, b"x", True, 1j, object(), Path("a"), np.zeros(3), np.zeros((2, 2))),
    *(np.array(1.5), [], {}, (), [None], [5], {"a": 1}, len, int, "\0", [[]]),
)


@dataclass(frozen=True)
class Other:
    """Changes to any other argument: something else in its place.

    Attributes:
        same: other ways to say the same.
        refused: more that is refused.
        allowed: which things of all kinds it takes, or may take.
    """

    same: Sequence[Any] = ()
    refused: Sequence[Any] = ()
    allowed: Callable[[Any], bool] = field(default=lambda _: False)

    def __call__(self, rng: random.Random, _value: Any) -> Changed:
        """One change."""
        kind = rng.random()
        if kind < 0.3 and self.same:
            return rng.choice(self.same), Must.GIVE_THE_SAME
        if kind < 0.6 and self.refused:
            return rng.choice(self.refused), Must.REFUSE
        wrong = rng.choice(_NO_OBJECTS)
        return wrong, Must.END_WELL if self.allowed(wrong) else Must.REFUSE


@dataclass(frozen=True)
class Call:
    """A public call.

    Attributes:
        function: what is called, with `arguments` by keyword.
        arguments: by parameter.
        share: of all calls.
        slow: whether it takes more than some milliseconds to give a result.
        keeps: whether it gives a record that keeps what it is given, finite or not.
    """

    function: Callable[..., Any]
    arguments: Mapping[str, Argument]
    share: float = 1.0
    slow: bool = False
    keeps: bool = False


def short(values: Any) -> npt.NDArray[np.float64]:
    """Numbers that fit 32 bits, so that arrays of them say the same."""
    return np.asarray(values, np.float32).astype(np.float64)


@cache
def folder() -> Path:
    """A folder for what calls write, until this process ends."""
    place = "/dev/shm" if Path("/dev/shm").is_dir() else None
    path = tempfile.mkdtemp(prefix="quadpi.fuzz.", dir=place)
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return Path(path)


def of_kinds(*kinds: type) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, kinds) and not isinstance(value, bool)


def output(name: str) -> Argument:
    """A path to write to; no other one, as files of the calls would lie about."""
    path = folder() / name

    def change(rng: random.Random, _value: Any) -> tuple[Any, Must]:
        if rng.random() < 0.5:
            return rng.choice((path, str(path))), Must.GIVE_THE_SAME
        return rng.choice((None, 5, 1.5, b"x", [], [str(path)], 1j, "\0", "")), Must.REFUSE

    return Argument(str(path), change, "name")


def no_value(value: Any) -> bool:
    return value is None


def rows_of(clean: Any, **how: bool) -> Argument:
    return Argument(clean, Rows(**how), f"array {np.shape(clean)[1:]} {np.asarray(clean).dtype.kind}")


def thing(clean: Any, kind: str = "", *, required: bool = True, **how: Any) -> Argument:
    return Argument(clean, Other(**how), kind or type(clean).__name__, required)


def figure(clean: float, *others: float, optional: bool = False, refused: tuple[float, ...] = ()) -> Argument:
    refused = (*Number.refused, *refused)
    return Argument(clean, Number(others, refused, optional), "number", required=False)


def named(clean: str, *same: Any, **how: Any) -> Argument:
    how.setdefault("allowed", lambda value: isinstance(value, str | Path))
    return thing(clean, "name", same=(Path(clean), clean, *same), **how)


def confidence_level() -> Argument:
    return figure(0.95, 0.9, 0.5, 0.99, 0.0, -1.0, 95.0, 1.0, optional=True)
