# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records the calls of the compiled core, for core/driver/repeat_calls.cpp to repeat on another processor."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import pytest

from quadpi_core.core import compiled

# What a replay calls for each block of samples.
FUNCTIONS = (
    "catch_up",
    "evaluate",
    "hold",
    "record",
    "run",
    "step_monitor",
    "take_stretch",
)


@contextmanager
def recorded_calls(path: Path) -> Iterator[dict[str, int]]:
    """Write every call of FUNCTIONS to a file; gives the checksum of what each left in its arguments."""
    sums: dict[str, int] = {}
    with path.open("wb") as file, pytest.MonkeyPatch.context() as patch:

        def recorded(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
            def call(*arguments: Any) -> Any:
                flat = list(_flat(arguments))
                file.write(_counted(name.encode()) + struct.pack("<q", len(flat)))
                for argument in flat:
                    file.write(_counted(_bytes(argument)))
                returned = function(*arguments)
                for argument in flat:
                    sums[name] = crc32(_bytes(argument), sums.get(name, 0))
                return returned

            return call

        for name in FUNCTIONS:
            patch.setattr(compiled, name, recorded(name, getattr(compiled, name)))
        yield sums


def _flat(arguments: tuple[Any, ...]) -> Iterator[Any]:
    """The arguments, the fields of those that are tuples, and what objects of the core hold."""
    for argument in arguments:
        if isinstance(argument, tuple):
            yield from _flat(argument)
        elif isinstance(argument, compiled.Model):
            yield type(argument).__name__.encode()
            yield from _flat(argument.arrays)
        elif isinstance(argument, compiled.Monitor | compiled.Pairing):
            yield from _flat(argument.arrays)
        else:
            yield argument


def _bytes(argument: Any) -> bytes:
    if isinstance(argument, bytes):
        return argument
    if isinstance(argument, np.ndarray):
        return argument.tobytes()
    return struct.pack("<d" if isinstance(argument, float) else "<q", argument)


def _counted(content: bytes) -> bytes:
    return struct.pack("<q", len(content)) + content
