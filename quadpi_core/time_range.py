# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A part of a flight by time, as `--from` and `--to` ask for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from quadpi_core.errors import QuadpiError

_LONGEST_NS = 2**62


@dataclass(frozen=True)
class TimeRange:
    """From when to when, in seconds since the first IMU sample; both ends belong to it.

    Raises:
        QuadpiError: for a range that is empty, inverted or holds no number.
    """

    from_s: float = 0.0
    to_s: float = math.inf

    def __post_init__(self) -> None:
        if not 0.0 <= self.from_s < self.to_s:
            raise QuadpiError(
                f"--from {self.from_s:g} --to {self.to_s:g}: no range of seconds since the first IMU sample"
            )

    @property
    def is_whole(self) -> bool:
        """Whether it leaves nothing out."""
        return self == WHOLE

    def stamps(self, start_ns: int) -> tuple[int, int]:
        """First and last stamp [ns] of a flight whose first IMU sample has the stamp `start_ns`."""
        first, last = (
            start_ns + (round(1e9 * seconds) if seconds < 1e-9 * _LONGEST_NS else _LONGEST_NS)
            for seconds in (self.from_s, self.to_s)
        )
        return (-_LONGEST_NS if self.from_s == 0.0 else first), last

    def __str__(self) -> str:
        end = "its end" if math.isinf(self.to_s) else f"{self.to_s:g} s"
        return f"from {self.from_s:g} s to {end}"


WHOLE = TimeRange()
