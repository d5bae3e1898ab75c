# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every verdict on the reports of speed controllers but one is a reason, in its own words."""

from __future__ import annotations

from quadpi_core.findings import REASONS, Verdict


def test_every_verdict_but_a_sample_has_a_reason_of_its_own() -> None:
    assert set(REASONS) == set(Verdict) - {Verdict.SAMPLE}
    assert len(set(REASONS.values())) == len(REASONS)
