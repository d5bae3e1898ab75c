# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether prediction intervals hold, decided from a measured coverage and its confidence interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

from quadpi_core.evaluation.evaluation_result import AxisMetrics
from quadpi_core.report.style import percent

# How far below the nominal coverage intervals still hold: 93 % instead of 95 % serves the same decisions.
TOLERANCE = 0.02
# A confidence interval narrower than 10 points tells 95 % coverage from 90 %; a wider one does not.
WIDEST = 0.10


class Holding(Enum):
    """Verdict on intervals from a measured coverage; the value of a member is the verb of the sentence."""

    HOLDS = "hold"
    NOT_SHOWN = "are not shown to hold"
    FAILS = "do not hold"


@dataclass(frozen=True)
class Coverage:
    """A share of measurements inside their interval.

    Attributes:
        subject: name in a sentence, such as that of an axis.
        estimate: the share.
        interval: 95 % confidence interval of the share (low, high); None where it is not known.
    """

    subject: str
    estimate: float
    interval: tuple[float, float] | None

    def holding(self, confidence: float) -> Holding:
        """Verdict on intervals of a nominal coverage.

        They hold if the estimate is at most :data:`TOLERANCE` below the nominal coverage and the confidence
        interval is narrower than :data:`WIDEST`. Else they fail if the whole confidence interval lies below
        the nominal coverage. In all other cases neither is shown.
        """
        if self.interval is None:
            return Holding.NOT_SHOWN
        low, high = self.interval
        if self.estimate >= confidence - TOLERANCE and high - low < WIDEST:
            return Holding.HOLDS
        return Holding.FAILS if high < confidence else Holding.NOT_SHOWN

    def sentence(self) -> str:
        """Subject and numbers, such as "Fx 83.4 %, 95 % confidence interval 61.9 % to 95.5 %"."""
        if self.interval is None:
            return f"{self.subject} {percent(self.estimate)}, its precision unknown"
        low, high = self.interval
        precision = f"95 % confidence interval {percent(low)} to {percent(high)}"
        return f"{self.subject} {percent(self.estimate)}, {precision}"


def axis_coverages(axes: Mapping[str, AxisMetrics]) -> list[Coverage]:
    """The coverage of each axis of a group or flight."""
    return [Coverage(axis, found.picp, (found.picp_ci[0], found.picp_ci[1])) for axis, found in axes.items()]


def joint_verdict(coverages: Sequence[Coverage], confidence: float) -> tuple[Holding, list[Coverage]]:
    """The worst of several verdicts, and the coverages that it applies to, the lowest first."""
    for verdict in (Holding.FAILS, Holding.NOT_SHOWN, Holding.HOLDS):
        found = [coverage for coverage in coverages if coverage.holding(confidence) is verdict]
        if found:
            return verdict, sorted(found, key=lambda coverage: coverage.estimate)
    raise ValueError("no coverage to judge")


def count_verdicts(groups: Mapping[str, Sequence[Coverage]], confidence: float) -> str:
    """A clause that counts, by group, the coverages that hold, are not shown to hold, and do not hold.

    The lowest one of the last two kinds is named with its numbers.
    """
    clauses = []
    for verdict in Holding:
        parts = []
        for group, coverages in groups.items():
            found = [coverage for coverage in coverages if coverage.holding(confidence) is verdict]
            if verdict is Holding.HOLDS:
                parts.append(f"{len(found)} of {len(coverages)} on {group}")
            elif found:
                lowest = min(found, key=lambda coverage: coverage.estimate)
                parts.append(f"{len(found)} on {group} ({lowest.sentence()})")
        if parts:
            clauses.append(f"{verdict.value} in {listing(parts)}")
    return "; ".join(clauses)


def listing(parts: Sequence[str], conjunction: str = "and") -> str:
    """Names as a sentence lists them: "a, b and c"."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {conjunction} {parts[-1]}"
