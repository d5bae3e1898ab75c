# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The verdict of one test in the search for missing effects, with its numbers and its reason."""

from __future__ import annotations

from dataclasses import dataclass

from quadpi_core.thresholds import Threshold


@dataclass(frozen=True)
class Verdict:
    """Outcome of one test of a candidate, or of the whole result.

    Attributes:
        test: name of the test.
        passed: whether it was passed.
        value: compared value.
        threshold: threshold it was compared with.
        unit: unit of both.
        sentence: the reason, for people.
    """

    test: str
    passed: bool
    value: float
    threshold: float
    unit: str
    sentence: str

    @classmethod
    def of(cls, threshold: Threshold[float], test: str, value: float, passed: bool, sentence: str) -> Verdict:
        """The verdict of a test that compares a value with a threshold."""
        return cls(test, passed, value, threshold.value, threshold.unit, sentence)
