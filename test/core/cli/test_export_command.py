# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi export`: a vehicle file of a model, which `simulate` flies as the folder."""

from __future__ import annotations

from pathlib import Path

GOLDEN = Path(__file__).parents[2] / "golden" / "model"
SHORT = """
description: one swing
vehicle: bebop2
seed: 1
flights:
  swing:
    duration_s: 10.0
    motion:
      x: [{sine: {amplitude_m: 1.0, frequency_hz: 0.3, start_s: 0.5, duration_s: 9.0, fade_s: 3.0}}]
"""


def test_simulate_and_discrepancy_take_folder_and_file(physical_folder, quadpi, read_json, tmp_path):
    file, scenario, result = tmp_path / "bebop2.yaml", tmp_path / "short.yaml", tmp_path / "flown.json"
    scenario.write_text(SHORT)
    exported = quadpi("export", physical_folder, "--format", "vehicle", "-o", file)
    assert (exported.status, exported.errors) == (0, "")
    assert f"flies as {physical_folder}" in exported.output.replace("\n", "")
    flown = []
    for vehicle in (physical_folder, file):
        ran = quadpi(
            *("simulate", scenario, "--vehicle", vehicle, "--noise", physical_folder),
            *("-o", tmp_path / "bags", "--json", result),
        )
        assert (ran.status, ran.errors) == (0, "")
        (flight,) = read_json(result)["flights"]
        assert flight["vehicle"] == "bebop2"
        assert flight["beyond_identified"] is None
        flown.append(flight["tracking_rms_m"])
    assert flown[0] == flown[1]


def test_what_cannot_be_exported(refused, tmp_path, physical_folder):
    refused("cannot be simulated", "export", GOLDEN, "-o", tmp_path / "own.yaml")
    refused("ends in .yaml", "export", physical_folder, "-o", tmp_path / "own.urdf")
    refused("cannot be simulated", "simulate", "bundled", "--vehicle", GOLDEN, "-o", tmp_path / "bags")
