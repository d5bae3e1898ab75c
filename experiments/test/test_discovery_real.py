# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Searches on real flights: the commands that run, what a second round starts from, and the page's tables."""

from __future__ import annotations

import json
from pathlib import Path

import discovery_real
import pytest
from discovery_real import CASES, PAGE, Case, Logs, rounds, section, summary

from quadpi_core.flight import AXES

ERROR = {"before": 2.0, "after": 1.0, "floor": 0.5}


def result(*, added: bool) -> dict:
    candidate = {
        "name": "rotor_drag",
        "label": "rotor_drag",
        "named": True,
        "evidence_nat": 50.0,
        "needed_nat": 5.0,
        "closes": {"Fx": 0.93, "Fy": 0.001},
        "cancels": ["Mx"],
        "reason": "gains 50.0 nat, 5.0 needed",
    }
    refused = {
        **candidate,
        "label": "wind",
        "named": False,
        "reason": "size of wind 0.04, more than 0.13 needed",
    }
    parameter = {"value": 0.1, "lower": 0.05, "upper": 0.15, "unit": "N s/m"}
    return {
        "flights": {"a": {"duration_s": 7.0}, "b": {"duration_s": 8.0}},
        "verdict": "effects" if added else "unknown",
        "doubts": [] if added else ["roll-outs of flights left out get worse with it"],
        "effects": [{"name": "rotor_drag", "parameters": {"drag_n_s_m": parameter}}],
        "candidates": [candidate, refused],
        "gap": {**dict.fromkeys(AXES, ERROR), "reduction": 0.6},
        "rollout": {"horizon_s": 0.5, "starts": 9, "attitude_deg": ERROR},
        "coverage": {"Fx": {"before": 0.3, "after": 0.95}},
        "files": ["quad.yaml", "effects.md"] if added else [],
    }


@pytest.fixture
def case(tmp_path, monkeypatch):
    """A case whose logs are there, and the commands that it runs; the first search alone adds something."""
    monkeypatch.setenv("QUADPI_DATA", str(tmp_path / "data"))
    (tmp_path / "data" / "set").mkdir(parents=True)
    for name in ("one", "two"):
        (tmp_path / "data" / "set" / name).touch()
    ran: list[tuple[str, ...]] = []

    def quadpi(*arguments: str) -> None:
        ran.append(arguments)
        folder = Path(arguments[arguments.index("-o") + 1])
        folder.mkdir(parents=True)
        added = arguments[0] == "discrepancy" and folder.name.endswith("-1")
        (folder / "discrepancy.json").write_text(json.dumps(result(added=added)))

    monkeypatch.setattr(discovery_real, "quadpi", quadpi)
    return Case("c", "quad", Logs("set", ("one",)), Logs("set", ("two",))), ran


def test_a_second_round_starts_from_what_the_first_added(case, tmp_path):
    the_case, ran = case
    work = tmp_path / "work"
    found = rounds(the_case, work)
    assert [one["verdict"] for one in found] == ["effects", "unknown"]
    assert [arguments[0] for arguments in ran] == ["identify", "discrepancy", "discrepancy"]
    assert ran[1][1] == str(work / "models" / "set")
    assert ran[2][1] == str(work / "c-1" / "quad.yaml")
    assert rounds(the_case, work) == found
    assert len(ran) == 3


def test_flights_that_are_not_there_are_named(case, tmp_path):
    the_case, _ = case
    (tmp_path / "data" / "set" / "two").unlink()
    with pytest.raises(SystemExit, match="two: set QUADPI_DATA"):
        rounds(the_case, tmp_path / "work")


def test_tables_tell_what_was_added_and_why_not(case):
    the_case, _ = case
    found = [result(added=True), result(added=False)]
    text = section(the_case, found)
    assert "Round 1: verdict `effects`; added." in text
    assert "nothing is added. Because roll-outs of flights left out get worse with it." in text
    assert "drag_n_s_m 0.1 (0.05 … 0.15)" in text
    assert "refused: size of wind 0.04" in text
    assert "Fx 93" in text
    assert "Fy 0" not in text
    assert "95.0 %" in text
    rows = summary({"c": found}).splitlines()[2:]
    assert [row.split("|")[-2].strip() for row in rows] == ["yes", "no"]
    assert all("2 → 1" in row for row in rows)


def test_every_case_searches_flights_that_its_model_has_not_seen_and_is_on_the_page():
    page = PAGE.read_text(encoding="utf-8")
    for own in CASES:
        same = own.identified.folder == own.searched.folder
        assert not (same and set(own.identified.names) & set(own.searched.names))
        assert f"<!-- table: {own.name} -->" in page
    assert "<!-- table: summary -->" in page
