# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reading of untrusted files: limits on their size, and JSON with finite numbers and no duplicate keys."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any, NoReturn

# What a small log may unpack to; quadpi_core.logs.sandbox holds logs against it.
LIMIT_VARIABLE = "QUADPI_UNPACKED_MIB"
# Far more than a small log needs; arrays made of it still fit into the memory of a small computer.
LIMIT_DEFAULT_MIB = 256
# Configuration and models are written by hand or by `identify`: a few kB, and a few MB.
CONFIG_BYTES_MAX = 256 * 1024
JSON_BYTES_MAX = 64 * 1024 * 1024
# Squares and cubes of such numbers stay finite.
_LARGEST = 1e100


def read_bounded(path: Path, most: int) -> bytes:
    """The content of a regular file.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is larger than `most` bytes, or a device or pipe, which may never end.
    """
    if path.exists() and not path.is_file():
        raise ValueError("not a file")
    with path.open("rb") as file:
        # Python allocates as much as `read` is asked for, however small the file.
        size = os.fstat(file.fileno()).st_size
        data = file.read(size + 1) if size <= most else b""
    if max(len(data), size) > most:
        raise ValueError(f"larger than the {most // 1024} KiB that such a file may have")
    return data


def parse_json(text: str | bytes) -> Any:
    """The content of a JSON text without duplicate keys, whose numbers are finite.

    Raises:
        ValueError: saying what is wrong with the text, such as nesting too deep for Python.
    """
    try:
        return json.loads(
            text,
            parse_constant=_refuse_constant,
            parse_float=_finite,
            parse_int=_whole,
            object_pairs_hook=_object,
        )
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"holds the number {text}")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value) or abs(value) > _LARGEST:
        raise ValueError(f"holds the number {text[:40]}, beyond {_LARGEST:g}")
    return value


def _whole(text: str) -> int:
    if len(text) > math.log10(_LARGEST):
        raise ValueError(f"holds the number {text[:40]}…, beyond {_LARGEST:g}")
    return int(text)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in found if keys.count(key) > 1)
        raise ValueError(f"duplicate key `{twice[:80]}`")
    return found
