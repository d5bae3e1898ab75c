# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi replay`: the JSON keys for one flight and for several, whose bags are those of each alone."""

from __future__ import annotations

REPLAY = {
    "samples_in",
    "predictions_out",
    "dropped",
    "alarm_fraction",
    "alarm_first_s",
    "warning_first_s",
    "events",
    "not_judged_fraction",
    "not_judged_reasons",
}


def test_replay(read_json, quadpi, model, bags, tmp_path):
    output = tmp_path / "out.mcap"
    assert quadpi("replay", model, bags[0], "-o", output, "--json", tmp_path / "replay.json").status == 0
    assert set(read_json(tmp_path / "replay.json")) == REPLAY


def test_replay_of_several(read_json, quadpi, model, bags, tmp_path):
    out, data = tmp_path / "out", tmp_path / "replay.json"
    replayed = quadpi("replay", model, *bags, "-o", out, "--json", data)
    assert (replayed.status, replayed.errors) == (0, "")
    flights = read_json(data)["flights"]
    assert read_json(data) == {"flights": flights, "left_out": []}
    assert all(bag.stem in replayed.output for bag in bags)
    assert list(flights) == ["flight0", "flight1", "flight2"]
    assert sorted(path.name for path in out.iterdir()) == [bag.name for bag in bags]
    alone = tmp_path / "alone.mcap"
    assert quadpi("replay", model, bags[1], "-o", alone, "--json", data).status == 0
    assert read_json(data) == flights["flight1"]
    assert alone.read_bytes() == (out / "flight1.mcap").read_bytes()
