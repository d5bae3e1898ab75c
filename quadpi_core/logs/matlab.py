# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Matrices of real numbers out of MATLAB files of level 5 (`save -v6` and `-v7`), as scipy reads them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.logs.sandbox import read_apart

_HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
# By the kinds of numpy's types.
_KINDS = {"O": "cell array", "V": "struct", "U": "text", "c": "complex matrix"}


class Variable(NamedTuple):
    """A variable: its name, what MATLAB calls its kind, and its numbers where it is a real matrix.

    Fields of a struct are variables `STRUCT.FIELD`.
    """

    name: str
    kind: str
    values: npt.NDArray[Any] | None


def read_matlab(path: Path) -> list[Variable]:
    """The variables of a file.

    Raises:
        LogError: if it is of another version, cut off or damaged, or unpacks to too much.
    """
    # Here, so that the other process need not.
    import scipy.io  # noqa: F401

    with path.open("rb") as stream:
        head = stream.read(10)
    if head.startswith(_HDF5_MAGIC) or head == b"MATLAB 7.3":
        raise LogError("a MATLAB 7.3 file (HDF5): save it with `-v7`")
    return list(read_apart(path.stat().st_size, _variables, path))


def _variables(path: Path) -> Iterator[Variable]:
    from scipy.io import loadmat

    for name, value in loadmat(path).items():
        if not name.startswith("__"):
            yield from _flat(name, value)


def _flat(name: str, value: Any) -> Iterator[Variable]:
    """A variable, or those of its fields where it is a struct."""
    if not isinstance(value, np.ndarray):
        yield Variable(name, "sparse matrix", None)
    elif value.dtype.names and value.shape == (1, 1) and type(value) is np.ndarray:
        for field in value.dtype.names:
            yield from _flat(f"{name}.{field}", value[0, 0][field])
    elif type(value) is not np.ndarray:
        yield Variable(name, "object", None)
    elif value.dtype.kind in _KINDS:
        yield Variable(name, _KINDS[value.dtype.kind], None)
    elif value.ndim != 2:
        yield Variable(name, f"array of {value.ndim} dimensions", None)
    else:
        yield Variable(name, "matrix", value.astype("u1") if value.dtype.kind == "b" else value)
