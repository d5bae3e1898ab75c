# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi validate`: its numbers are those of its realisations, which a later run resumes."""

from pathlib import Path

import pytest

from quadpi_core.flight import AXES
from quadpi_core.paths import bags_directory

MODEL = Path(__file__).parents[2] / "golden" / "model"
FLIGHT = bags_directory() / "interpolation.mcap"
RESULT = {
    *("quadpi_version", "vehicle", "confidence", "seed", "realisations", "cutoff_hz", "noise"),
    *("flights", "models", "published"),
}


@pytest.fixture
def validated(quadpi, read_json, tmp_path):
    """validated(option, …) → the JSON file."""

    def run(*options):
        result = quadpi("validate", MODEL, FLIGHT, "--json", tmp_path / "data.json", "--workers", 1, *options)
        assert (result.status, result.errors) == (0, "")
        return read_json(tmp_path / "data.json")

    return run


def test_more_realisations_go_on_from_those_that_are_kept(validated, tmp_path):
    few = validated("--realisations", 2, "-o", tmp_path / "kept")
    kept = sorted((tmp_path / "kept").rglob("*.npz"))
    assert kept
    alone = validated("--realisations", 3)
    resumed = validated("--realisations", 3, "-o", tmp_path / "kept")
    assert resumed == alone
    assert set(kept) <= set((tmp_path / "kept").rglob("*.npz"))
    assert (few["realisations"], alone["realisations"]) == (2, 3)
    assert set(few) == RESULT
    (model,) = few["models"].values()
    assert set(model["axes"]) <= set(AXES)
    assert few["published"] is None


def test_seed_confidence_and_page(validated, tmp_path):
    found = validated(
        *("--realisations", 2, "--seed", 5, "--confidence", 0.9, "--html", tmp_path / "page.html")
    )
    assert (found["seed"], found["confidence"], found["vehicle"]) == (5, 0.9, "bebop2")
    assert "interpolation" in (tmp_path / "page.html").read_text()


def test_models_and_bags_are_needed(quadpi, refused):
    for given in ((), ("--realisations", 2)):
        ran = quadpi("validate", *given)
        assert ran.status == 2
        assert "Missing argument 'paths'" in ran.errors
    refused("no bag of a simulated flight given", "validate", MODEL)
    refused("no model folder given: name model folders, then bags", "validate", FLIGHT)
