# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The short form of `make discovery`, from flights to figures."""

from __future__ import annotations

import json
import sys

import discovery
import pytest
from blind.cases import NULL, SINGLE


@pytest.mark.slow
def test_short_form(tmp_path, monkeypatch, capsys):
    found, page = tmp_path / "discovery.json", discovery.PAGE.read_bytes()
    arguments = ["--short", "--work", str(tmp_path / "work"), "--json", str(found)]
    # Files that are edited while this runs would send the second run searching again.
    monkeypatch.setattr(discovery, "fingerprint", lambda: "kept")
    monkeypatch.setattr(sys, "argv", ["discovery", *arguments])
    discovery.main()
    printed = capsys.readouterr().out
    cases = json.loads(found.read_text())["cases"]
    assert {case["kind"] for case in cases} == {"null", "single", "outside", "pair", "under-excited"}
    for case in cases:
        assert case["result"]["verdict"] in {"none", "effects", "unknown"}, case["result"]["verdict"]
    # Full size and plain to see: whatever else the flights hold, this much is found.
    named = [
        case["hidden"] == [effect["name"] for effect in case["result"]["effects"]]
        for case in cases
        if case["kind"] == SINGLE
    ]
    assert sum(named) >= 3
    assert any(case["result"]["verdict"] == "none" for case in cases if case["kind"] == NULL)
    # A weak rotor and a rotor's inertia mean the same to the library; one interval of 95 % may miss.
    singles = [case for case in cases if case["kind"] == SINGLE and case["left"] is not None]
    estimates = [own for case in singles for own in case["estimates"].values()]
    assert len(estimates) >= 2
    assert sum(low <= true <= high for true, low, high in estimates) >= len(estimates) - 1
    # What is added is judged on flights that were not searched.
    assert len(singles) >= 3
    for case in singles:
        before, after = case["rollouts"]["attitude_deg"]
        assert after < before
    assert "nulls: false alarms" in printed
    assert discovery.PAGE.read_bytes() == page
    # What was searched is kept: a second run has nothing to do.
    discovery.main()
    assert f"{len(cases)} cases, 0 to search" in capsys.readouterr().out
