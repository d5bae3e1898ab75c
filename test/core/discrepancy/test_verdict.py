# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A verdict names the number that it compared, and what with."""

from __future__ import annotations

from quadpi_core.discrepancy.verdict import Verdict
from quadpi_core.thresholds import CONVENTION, Threshold

LOUD = Threshold("loud", 0.1, "of the noise", "a quieter effect closes no gap", CONVENTION)


def test_a_verdict_shows_its_threshold():
    verdict = Verdict.of(LOUD, "loudness", 0.3, True, "loud enough")
    assert verdict == Verdict("loudness", True, 0.3, 0.1, "of the noise", "loud enough")
