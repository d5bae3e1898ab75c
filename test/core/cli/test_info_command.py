# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi info`: the JSON keys of a recording, of results and of a model."""

from __future__ import annotations

from quadpi_core.inputs import INPUT_NAMES

RECORDING = {"kind", "name", "vehicle", "source", "topics", "envelope", "findings"}
MODEL = {
    "alarm",
    "change",
    "kind",
    "name",
    "identity",
    "vehicle",
    "settings",
    "cutoff_hz",
    "confidence",
    "axes",
    "flights",
    "envelope",
    "facts",
}


def test_info_of_a_bag(read_json, quadpi, bags, tmp_path):
    assert quadpi("info", bags[0], "--json", tmp_path / "info.json").status == 0
    info = read_json(tmp_path / "info.json")
    assert (set(info), info["kind"], info["vehicle"]) == (RECORDING, "recording", "neurobem")
    assert {topic["topic"] for topic in info["topics"]} == {"imu", "rotor_speeds", "mocap/pose"}
    assert info["findings"] == []


def test_info_of_a_replay(read_json, quadpi, model, bags, tmp_path):
    assert quadpi("replay", model, bags[0], "-o", tmp_path / "out.mcap").status == 0
    shown = quadpi("info", tmp_path / "out.mcap", "--json", tmp_path / "info.json")
    assert (shown.status, shown.errors) == (0, "")
    info = read_json(tmp_path / "info.json")
    assert set(info) == RECORDING
    counts = {topic["topic"]: topic["count"] for topic in info["topics"]}
    assert list(counts) == ["/extrapolation_alarm", "/odometry", "/prediction"]
    assert counts["/prediction"] > 0
    assert "no topic imu" in info["findings"][0]


def test_info_of_a_model(read_json, quadpi, model, tmp_path):
    assert quadpi("info", model, "--json", tmp_path / "info.json").status == 0
    info = read_json(tmp_path / "info.json")
    assert (set(info), info["kind"], info["settings"]) == (MODEL, "model", "default")
    assert list(info["envelope"]) == list(INPUT_NAMES)
    assert info["axes"]["Fx"][:2] == ["bias", "u"]
