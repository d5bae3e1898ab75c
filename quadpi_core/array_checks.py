# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of what callers of the library hand in, before compiled code reads it by its length.

Each public call takes its arguments through these. An array comes back as compiled code takes it: of one
kind of number, contiguous, aligned, in this machine's byte order and writable; it is copied only if it is not
so already. For what cannot be used each raises an ArgumentError with the argument's name, what was expected
and what was found.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ArgumentError, one_line
from quadpi_core.frames import Array
from quadpi_core.records import Records

_Kind = TypeVar("_Kind")
_FLOAT, _INT, _BOOL = np.dtype(np.float64), np.dtype(np.int64), np.dtype(np.bool_)
_SHOWN_MAX = 60
# Length of an axis that may have any.
ANY = -1
# What compiled code takes: contiguous, aligned, writable, no class of its own beside ndarray.
REQUIREMENTS: Any = ["C", "A", "W", "E"]


def floats(
    name: str, values: Any, *columns: int, rows: int | None = None, of: str = "", finite: bool = True
) -> Array:
    """Numbers (N, *columns) as float64.

    Args:
        name: of the argument.
        values: an array, or what numpy makes one of; masked values count as not finite.
        columns: lengths of the axes behind the first, ANY for any; none for (N,).
        rows: N, where another argument decides it.
        of: name of that argument.
        finite: whether to refuse what is not finite.
    """
    array = _as(_FLOAT, "iuf", "numbers", name, values)
    _require_shape(name, array, columns, rows, of)
    if finite and not np.isfinite(array).all():
        raise _not_finite(name, np.isfinite(array))
    return array


def are_samples(time_ns: Any, values: Any, columns: int) -> bool:
    """Whether stamps (N,) and numbers (N, columns) are as compiled code takes them: what a node hands in.

    One look instead of :func:`stamps` and :func:`floats`, which take a fifteenth of the time of a sample.
    """
    return (
        type(time_ns) is type(values) is np.ndarray
        and time_ns.dtype is _INT
        and values.dtype is _FLOAT
        and time_ns.ndim == 1
        and values.shape == (len(time_ns), columns)
        and time_ns.flags.carray
        and values.flags.carray
    )


def by_rotor(name: str, values: Any, rotors: int) -> Array:
    """Numbers (..., rotors) as float64, finite or not."""
    array = _as(_FLOAT, "iuf", "numbers", name, values)
    if array.shape[-1:] != (rotors,):
        raise ArgumentError(f"{name}: expected shape (..., {rotors}), found {array.shape}")
    return array


def stamps(name: str, values: Any, *, rows: int | None = None, of: str = "") -> npt.NDArray[np.int64]:
    """Stamps (N,) as int64 nanoseconds, as of :func:`floats`; no floats, which cannot hold those of today."""
    array = _as(_INT, "iu", "whole nanoseconds, int64", name, values)
    _require_shape(name, array, (), rows, of)
    return array


def flags(name: str, values: Any, *, rows: int | None = None, of: str = "") -> npt.NDArray[np.bool_]:
    """True or false (N,); the arguments as of :func:`floats`."""
    array = _as(_BOOL, "b", "true or false", name, values)
    _require_shape(name, array, (), rows, of)
    return array


def records(
    name: str,
    values: Any,
    dtype: np.dtype[np.void],
    *,
    rows: int | None = None,
    of: str = "",
    finite: bool = True,
) -> Records:
    """Records (N,) of a dtype; the arguments as of :func:`floats`, `finite` for fields of float64 alone."""
    if not (type(values) is np.ndarray and values.dtype is dtype and values.flags.carray):
        if not isinstance(values, np.ndarray) or _layout(values.dtype) != _layout(dtype):
            fields = ", ".join(dtype.names or ())
            raise ArgumentError(f"{name}: expected records of {fields}, found {description(values)}")
        values = np.ascontiguousarray(values.astype(dtype))
    _require_shape(name, values, (), rows, of)
    array: Records = values
    for field in (dtype.names or ()) if finite else ():
        if not np.isfinite(array[field]).all():
            raise _not_finite(name, np.isfinite(array[field]))
    return array


def number(name: str, value: Any, *, above: float = -math.inf) -> float:
    """A finite number above a bound; true and false are none."""
    if isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool):
        checked = float(value)
        if math.isfinite(checked) and checked > above:
            return checked
    bound = {-math.inf: "a finite number", 0.0: "a positive number"}.get(above, f"a number above {above:g}")
    raise ArgumentError(f"{name}: expected {bound}, found {description(value)}")


def whole(name: str, value: Any, lowest: int, highest: int) -> int:
    """A whole number in a range, bounds included; true and false are none."""
    if isinstance(value, (int, np.integer)) and not isinstance(value, bool) and lowest <= value <= highest:
        return int(value)
    raise ArgumentError(
        f"{name}: expected a whole number from {lowest} to {highest}, found {description(value)}"
    )


def instance(name: str, value: Any, kind: type[Any], hint: str = "") -> Any:
    """A value of a class; the hint says how to get one."""
    if not isinstance(value, kind):
        raise _another(name, kind.__name__, value, hint)
    return value


def several(name: str, values: Any, kind: type[_Kind], hint: str = "") -> list[_Kind]:
    """Values of a class from any iterable; one alone counts as a list of it."""
    if isinstance(values, kind):
        return [values]
    if isinstance(values, (str, np.ndarray)):
        raise _another(name, f"a list of {kind.__name__}", values, hint)
    entries = _entries(name, f"a list of {kind.__name__}", values, hint)
    return [instance(f"{name}, entry {place}", value, kind, hint) for place, value in enumerate(entries, 1)]


def path(name: str, value: Any) -> Path:
    """The path of a file or folder, from text or a Path."""
    if not isinstance(value, (str, Path)) or str(value) == "" or "\0" in str(value):
        raise _another(name, "a path", value)
    return Path(value)


def paths(name: str, values: Any) -> list[Path]:
    """Paths from any iterable; one alone counts as a list of it."""
    if isinstance(values, (str, Path)):
        return [path(name, values)]
    entries = _entries(name, "paths", values)
    return [path(f"{name}, entry {place}", value) for place, value in enumerate(entries, 1)]


def description(value: Any) -> str:
    """What a value is, in a few words."""
    if isinstance(value, np.ndarray):
        return f"an array {value.shape} of {value.dtype if value.dtype.names is None else 'records'}"
    if value is None:
        return "None"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    text = one_line(ValueError(repr(value))) if isinstance(value, (str, bytes, int, float)) else ""
    text = f" {text if len(text) <= _SHOWN_MAX else text[:_SHOWN_MAX] + '…'}" if text else ""
    return f"{type(value).__name__}{text}"


def _as(dtype: np.dtype[Any], kinds: str, words: str, name: str, values: Any) -> npt.NDArray[Any]:
    if type(values) is np.ndarray and values.dtype is dtype and values.flags.carray:
        return values
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        values = np.ma.filled(values.astype(float), np.nan)
    try:
        array = np.asarray(values)
    except Exception:  # whatever an object raises that pretends to be an array
        raise ArgumentError(f"{name}: expected {words}, found {description(values)}") from None
    if array.dtype.kind not in kinds and array.size:
        hint = ""
        if dtype is _INT and array.dtype.kind == "f" and not np.any(array >= 1e11):  # beyond stamps in s
            hint = "; of seconds, np.rint(1e9 * seconds).astype(np.int64) makes them"
        shown = description(array) if array.dtype.kind != "O" or array.ndim else description(values)
        raise ArgumentError(f"{name}: expected {words}, found {shown}{hint}")
    if array.dtype.kind == "u" and dtype is _INT and array.size and int(array.max()) > np.iinfo(_INT).max:
        raise ArgumentError(f"{name}: expected {words}, found {int(array.max())}")
    with np.errstate(over="ignore"):  # beyond float64 is not finite
        return np.require(array.astype(dtype, copy=False), requirements=REQUIREMENTS)


def _require_shape(
    name: str, array: npt.NDArray[Any], columns: tuple[int, ...], rows: int | None, of: str
) -> None:
    shape = array.shape
    fits = len(shape) == 1 + len(columns) and all(
        width in (ANY, length) for width, length in zip(columns, shape[1:], strict=True)
    )
    if fits and (rows is None or shape[0] == rows):
        return
    count = "N" if rows is None else rows
    expected = ", ".join(str(width) if width != ANY else "K" for width in (count, *columns)) + (
        "" if columns else ","
    )
    why = f" for {of} ({rows},)" if of else ""
    raise ArgumentError(f"{name}: expected shape ({expected}){why}, found {array.shape}")


def _not_finite(name: str, finite: npt.NDArray[np.bool_]) -> ArgumentError:
    by_row = finite.reshape(len(finite), -1).all(axis=1)
    return ArgumentError(f"{name}: expected finite numbers, found others first in row {np.argmin(by_row)}")


def _entries(name: str, expected: str, values: Any, hint: str = "") -> Iterator[Any]:
    if not isinstance(values, (bytes, Mapping)):
        with suppress(TypeError):  # a tensor of one number says only here that it has no entries
            return iter(values)
    raise _another(name, expected, values, hint)


def _another(name: str, expected: str, value: Any, hint: str = "") -> ArgumentError:
    return ArgumentError(f"{name}: expected {expected}, found {description(value)}{hint and f'; {hint}'}")


def _layout(dtype: np.dtype[Any]) -> list[tuple[str, str, tuple[int, ...]]] | None:
    """Names, kinds and shapes of the fields of records; None of what are none."""
    if dtype.names is None:
        return None
    return [(name, dtype[name].base.kind, dtype[name].shape) for name in dtype.names]
