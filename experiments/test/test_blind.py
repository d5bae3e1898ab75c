# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The short form of `make discovery`, from flights to figures."""

from __future__ import annotations

import json
import sys

import discovery
import pytest
from blind.cases import NULL, OUT, PAIR, POOR, SINGLE


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
    # Full size and plain to see: each is named, and nothing else.
    verdicts = {NULL: "none", OUT: "unknown"}
    assert {case["kind"] for case in cases} == {NULL, SINGLE, OUT, PAIR, POOR}
    for case in cases:
        named = {effect["name"] for effect in case["result"]["effects"]}
        assert case["result"]["verdict"] == verdicts.get(case["kind"], "effects"), case
        assert named == (set() if case["kind"] in verdicts else set(case["hidden"])), case
        assert case["left"] is None or case["left"] < 0.01
    # A weak rotor, a rotor's inertia and thrust mean the same to the library; one interval of 95 % may miss.
    estimates = [own for case in cases for own in case["estimates"].values()]
    assert len(estimates) == 4
    assert sum(low <= true <= high for true, low, high in estimates) >= 3
    # What is added is judged on flights that were not searched.
    singles = [case for case in cases if case["kind"] == SINGLE]
    assert len(singles) == 2
    for case in singles:
        before, after = case["rollouts"]["attitude_deg"]
        assert after < before
    assert "nulls: false alarms" in printed
    assert discovery.PAGE.read_bytes() == page
    # What was searched is kept: a second run has nothing to do.
    discovery.main()
    assert f"{len(cases)} cases, 0 to search" in capsys.readouterr().out
