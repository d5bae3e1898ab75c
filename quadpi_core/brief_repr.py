# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How records that hold long arrays show themselves, as in a notebook or debugger: in one line."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import fields
from typing import Any

import numpy as np

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
