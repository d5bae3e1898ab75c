# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmarks: each measures a ratio against its baseline, both in the same run.

`python -m benchmarks` runs every module of this package that has `NAMES` (the figures it gives) and
`run()` (which gives one :class:`Result` per figure, or raises :class:`UnavailableError`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from quadpi_core.frames import Array


class UnavailableError(Exception):
    """What a benchmark needs is not there; the message says what."""


def require_ros() -> None:
    """Refuse an environment without ROS 2 and the messages of quadpi."""
    try:
        import quadpi.msg  # noqa: F401
        import rclpy  # noqa: F401
    except ImportError as error:
        raise UnavailableError(f"ROS 2 with the quadpi messages is needed: {error}") from error


@dataclass(frozen=True)
class Result:
    """One figure.

    Attributes:
        value: what was measured, most often a ratio.
        baseline: what it is relative to, with its own measurement.
        goal: value to reach; None where none is set.
        at_most: whether the goal is an upper bound; else it is a lower one.
    """

    name: str
    value: float
    unit: str
    baseline: str
    goal: float | None = None
    at_most: bool = False

    @property
    def holds(self) -> bool | None:
        """Whether the goal is reached; None without one."""
        if self.goal is None:
            return None
        return self.value <= self.goal if self.at_most else self.value >= self.goal


def interleaved_seconds(functions: Sequence[Callable[[], object]], repetitions: int = 5) -> Array:
    """Wall time (repetitions, functions) of each function, taken in turns after one run to warm up.

    Turns spread a disturbance of the machine over all functions: take the median of ratios of one row.
    """
    for function in functions:
        function()
    seconds = np.empty((repetitions, len(functions)))
    for row in seconds:
        for column, function in enumerate(functions):
            start = time.perf_counter()
            function()
            row[column] = time.perf_counter() - start
    return seconds
