# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A mapping of a YAML file, read key by key, its values judged."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

from quadpi_core.config import nearest
from quadpi_core.errors import SimulationError

Vector = tuple[float, float, float]


class Section:
    """Keys and values under `where` (the file, and the keys above), of which `known` are allowed.

    Raises:
        SimulationError: if the data is no mapping or has another key, with the nearest known one; and from
            every method, naming the key, for a value that is missing or impossible.
    """

    def __init__(self, data: Any, where: str, known: Collection[str]) -> None:
        if not isinstance(data, dict):
            raise SimulationError(f"{where}: expected keys and values, found {data!r}")
        for key in data:
            if key not in known:
                raise SimulationError(
                    f"{where}: unknown key `{key}`; known: {', '.join(known)}{nearest(str(key), known)}"
                )
        self.where = where
        self._data: dict[str, Any] = data

    def __contains__(self, key: str) -> bool:
        return key in self._data

    def number(
        self, key: str, default: float | None = None, *, lowest: float = 0.0, highest: float = math.inf
    ) -> float:
        """A finite number within bounds, inclusive; without a default the key is required."""
        value = self._value(key, default)
        if not _is_number(value) or not lowest <= value <= highest:
            raise SimulationError(
                f"{self.where}: `{key}` must be a number{_bounds(lowest, highest)}, found {value!r}"
            )
        return float(value)

    def whole(self, key: str, default: int | None = None, *, lowest: int = 0, highest: int = 2**32) -> int:
        """A whole number within bounds, inclusive; without a default the key is required."""
        value = self._value(key, default)
        if not isinstance(value, int) or isinstance(value, bool) or not lowest <= value <= highest:
            raise SimulationError(
                f"{self.where}: `{key}` must be a whole number{_bounds(lowest, highest)}, found {value!r}"
            )
        return value

    def numbers(self, key: str) -> tuple[float, ...]:
        """Finite numbers, as many as are listed; required."""
        value = self._value(key, None)
        if not isinstance(value, list | tuple) or not all(map(_is_number, value)):
            raise SimulationError(f"{self.where}: `{key}` must be a list of numbers, found {value!r}")
        return tuple(map(float, value))

    def switch(self, key: str) -> bool:
        """True or false; required."""
        value = self._value(key, None)
        if not isinstance(value, bool):
            raise SimulationError(f"{self.where}: `{key}` must be true or false, found {value!r}")
        return value

    def text(self, key: str, default: str | None = None) -> str:
        """Some text; without a default the key is required."""
        value = self._value(key, default)
        if not isinstance(value, str) or not value:
            raise SimulationError(f"{self.where}: `{key}` must be text, found {value!r}")
        return value

    def vector(self, key: str, default: Vector) -> Vector:
        """Three finite numbers."""
        value = self._value(key, default)
        if not isinstance(value, list | tuple) or len(value) != 3 or not all(map(_is_number, value)):
            raise SimulationError(f"{self.where}: `{key}` must be three numbers, found {value!r}")
        x, y, z = map(float, value)
        return x, y, z

    def choice(self, key: str, known: Collection[str]) -> str:
        """One of the known names; required."""
        value = self._value(key, None)
        if not isinstance(value, str) or value not in known:
            raise SimulationError(
                f"{self.where}: `{key}` must be one of {', '.join(known)}, found {value!r}"
                f"{nearest(str(value), known)}"
            )
        return value

    def get(self, key: str, default: Any) -> Any:
        """Whatever stands there."""
        return self._data.get(key, default)

    def _value(self, key: str, default: Any) -> Any:
        value = self._data.get(key, default)
        if value is None:
            raise SimulationError(f"{self.where}: missing key `{key}`")
        return value


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _bounds(lowest: float, highest: float) -> str:
    if math.isinf(highest):
        return "" if math.isinf(lowest) else f" not below {lowest:g}"
    return f" from {lowest:g} to {highest:g}"
