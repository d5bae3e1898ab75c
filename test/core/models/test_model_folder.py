# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A kind may keep further files in a model folder; they count as those of every model."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from quadpi_core.errors import ModelError, OutputError
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kinds import polynomial
from quadpi_core.models.model_kind import FittedAxis, StoredAxes

GOLDEN_MODEL = Path(__file__).parents[2] / "golden" / "model"
TABLE = "parameters.csv"


class WithTable(polynomial.Polynomial):
    """A kind with a table for people."""

    def store(self, fitted: Mapping[str, FittedAxis]) -> StoredAxes:
        return replace(super().store(fitted), files={TABLE: b"axis,terms\nFx,3\n"})

    def read(self, stored: StoredAxes) -> dict[str, FittedAxis]:
        assert stored.files == {TABLE: b"axis,terms\nFx,3\n"}
        return super().read(stored)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    model = AerodynamicModel.load(GOLDEN_MODEL)
    monkeypatch.setattr(polynomial, "KIND", WithTable())
    model.save(tmp_path / "model")
    return tmp_path / "model"


def test_is_read_and_replaced_with_the_model(folder: Path) -> None:
    model = AerodynamicModel.load(folder)
    assert (folder / TABLE).is_file()
    model.save(folder)
    assert AerodynamicModel.load(folder).identity == model.identity


def test_altered_or_missing_is_refused(folder: Path) -> None:
    (folder / TABLE).write_text("axis,terms\nFx,4\n")
    with pytest.raises(ModelError, match=rf"{TABLE}: its hash is not the one in model.json"):
        AerodynamicModel.load(folder)
    (folder / TABLE).unlink()
    with pytest.raises(ModelError, match=rf"{TABLE}: missing"):
        AerodynamicModel.load(folder)


def test_what_the_model_does_not_declare_is_still_foreign(folder: Path) -> None:
    model = AerodynamicModel.load(folder)
    (folder / "notes.txt").write_text("mine")
    with pytest.raises(ModelError, match=r"holds notes\.txt"):
        AerodynamicModel.load(folder)
    (folder / "notes.txt").rename(folder / "parameters.old")
    with pytest.raises(OutputError, match=r"holds parameters\.old"):
        model.save(folder)


def test_a_name_that_leads_out_of_the_folder_is_not_read(folder: Path) -> None:
    described = json.loads((folder / "model.json").read_text())
    described["files_sha256"] = {"../secret": "00"}
    (folder / "model.json").write_text(json.dumps(described))
    (folder / TABLE).unlink()
    (folder.parent / "secret").write_text("kept")
    with pytest.raises(ModelError, match=r"\.\./secret: missing"):
        AerodynamicModel.load(folder)
