# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Model folders: whole or not at all, plain data, and refused where anything was altered."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import save

from quadpi_core.errors import ModelError, OutputError, QuadpiError
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.fitted_polynomial import FittedPolynomials
from quadpi_core.models.kinds import polynomial
from quadpi_core.models.model_folder import ARRAYS_FILE, MODEL_FILE, read_safetensors
from quadpi_core.models.model_kind import StoredAxes

GOLDEN_MODEL = Path(__file__).parents[2] / "golden" / "model"
TABLE = "parameters.csv"


class WithTable(FittedPolynomials):
    """Polynomials with a table for people."""

    def store(self) -> StoredAxes:
        return replace(super().store(), files={TABLE: b"axis,terms\nFx,3\n"})

    @classmethod
    def read(cls, stored: StoredAxes) -> WithTable:
        assert stored.files == {TABLE: b"axis,terms\nFx,3\n"}
        return super().read(stored)


@pytest.fixture(scope="module")
def model() -> AerodynamicModel:
    return AerodynamicModel.load(GOLDEN_MODEL)


@pytest.fixture
def folder(model: AerodynamicModel, tmp_path: Path) -> Path:
    model.save(tmp_path / "model")
    return tmp_path / "model"


@pytest.fixture
def with_table(model: AerodynamicModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(polynomial.Polynomial, "fitted_type", WithTable)
    replace(model, fitted=WithTable(model.fitted.axes)).save(tmp_path / "model")
    return tmp_path / "model"


def test_the_format_of_version_0_1_is_read(folder: Path, model: AerodynamicModel) -> None:
    described = folder / MODEL_FILE
    described.write_text(described.read_text().replace('"format": 6', '"format": 5'))
    assert AerodynamicModel.load(folder).fitted.axes.keys() == model.fitted.axes.keys()
    text = described.read_text()
    described.write_text(text.replace('"envelope"', '"ranges"'))
    with pytest.raises(ModelError, match=r"in a folder of an earlier version: identify the model again$"):
        AerodynamicModel.load(folder)
    described.write_text(text.replace('"format": 5', '"format": 4'))
    with pytest.raises(ModelError, match=r"format 4 is not known to this version \(6\)"):
        AerodynamicModel.load(folder)


def test_is_read_and_replaced_with_the_model(with_table: Path) -> None:
    model = AerodynamicModel.load(with_table)
    assert (with_table / TABLE).is_file()
    model.save(with_table)
    assert AerodynamicModel.load(with_table).identity == model.identity


def test_altered_or_missing_is_refused(with_table: Path) -> None:
    (with_table / TABLE).write_text("axis,terms\nFx,4\n")
    with pytest.raises(ModelError, match=rf"{TABLE}: its hash is not the one in model.json"):
        AerodynamicModel.load(with_table)
    (with_table / TABLE).unlink()
    with pytest.raises(ModelError, match=rf"{TABLE}: missing"):
        AerodynamicModel.load(with_table)


def test_what_the_model_does_not_declare_is_still_foreign(with_table: Path) -> None:
    model = AerodynamicModel.load(with_table)
    (with_table / "notes.txt").write_text("mine")
    with pytest.raises(ModelError, match=r"holds notes\.txt"):
        AerodynamicModel.load(with_table)
    (with_table / "notes.txt").rename(with_table / "parameters.old")
    with pytest.raises(OutputError, match=r"holds parameters\.old"):
        model.save(with_table)


def test_a_name_that_leads_out_of_the_folder_is_not_read(with_table: Path) -> None:
    described = json.loads((with_table / "model.json").read_text())
    described["files_sha256"] = {"../secret": "00"}
    (with_table / "model.json").write_text(json.dumps(described))
    (with_table / TABLE).unlink()
    (with_table.parent / "secret").write_text("kept")
    with pytest.raises(ModelError, match=r"\.\./secret: missing"):
        AerodynamicModel.load(with_table)


def test_saving_twice_gives_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    again = AerodynamicModel.load(folder).save(tmp_path / "other" / "model")
    assert again.identity == AerodynamicModel.load(folder).identity
    for name in (MODEL_FILE, ARRAYS_FILE):
        assert (tmp_path / "other" / "model" / name).read_bytes() == (folder / name).read_bytes()


def test_saving_replaces_an_older_model_whole(model: AerodynamicModel, folder: Path) -> None:
    replace(model, fitted=replace(model.fitted, axes={"Mz": model.fitted.axes["Mz"]})).save(folder)
    assert sorted(path.name for path in folder.iterdir()) == [ARRAYS_FILE, MODEL_FILE]
    assert AerodynamicModel.load(folder).axes == ("Mz",)
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


def test_folder_that_holds_more_than_a_model_is_not_replaced(model: AerodynamicModel, folder: Path) -> None:
    (folder / "notes.txt").write_text("of the user")
    with pytest.raises(QuadpiError, match=r"notes\.txt"):
        model.save(folder)
    assert (folder / "notes.txt").read_text() == "of the user"


def test_failed_save_leaves_what_was_there(
    model: AerodynamicModel, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def full_disk(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full_disk)
    for target in (folder, folder.parent / "new"):
        with pytest.raises(QuadpiError, match="No space"):
            model.save(target)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


@pytest.mark.parametrize("position", [0, 100, -1])
def test_altered_arrays_are_refused(folder: Path, position: int) -> None:
    path = folder / ARRAYS_FILE
    content = bytearray(path.read_bytes())
    content[position] ^= 1
    path.write_bytes(content)
    with pytest.raises(ModelError, match=r"arrays\.safetensors: its hash is not the one in model\.json"):
        AerodynamicModel.load(folder)


@pytest.mark.parametrize("text", ["", "{", "[]", "null", "42", '{"weights": 1}', "\x80\x04pickle"])
def test_foreign_description_is_refused(folder: Path, text: str) -> None:
    (folder / MODEL_FILE).write_text(text)
    with pytest.raises(ModelError, match=r"model\.json") as caught:
        AerodynamicModel.load(folder)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("missing", [MODEL_FILE, ARRAYS_FILE])
def test_missing_file_is_named(folder: Path, missing: str) -> None:
    (folder / missing).unlink()
    with pytest.raises(ModelError, match=f"{missing}: cannot be read"):
        AerodynamicModel.load(folder)


def test_pickle_in_place_of_arrays_is_refused(folder: Path) -> None:
    planted = pickle.dumps(print)
    (folder / ARRAYS_FILE).write_bytes(planted)
    content = json.loads((folder / MODEL_FILE).read_text())
    content["arrays_sha256"] = hashlib.sha256(planted).hexdigest()
    (folder / MODEL_FILE).write_text(json.dumps(content))
    with pytest.raises(ModelError, match="not a quadpi model"):
        AerodynamicModel.load(folder)


def test_arrays_are_those_that_safetensors_wrote() -> None:
    written = {
        "empty": np.zeros((0, 3)),
        "scalar": np.array(2.5),
        "counts": np.arange(6, dtype=np.int64).reshape(2, 3),
        "bytes": np.arange(3, dtype=np.uint8),
        "halves": np.array([0.5], dtype=np.float16),
    }
    read = read_safetensors(save(written, {"by": "a test"}))
    assert set(read) == set(written)
    for name, values in written.items():
        np.testing.assert_array_equal(read[name], values)
        assert (read[name].dtype, read[name].shape) == (values.dtype, values.shape)


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:0],
        lambda content: content[:-1],
        lambda content: content + b"0",
        lambda content: b"\xff" * 8 + content[8:],
        lambda content: content.replace(b"[2,3]", b"[3,3]"),
        lambda content: content.replace(b"[2,3]", b"[-2]"),
        lambda content: content.replace(b"F64", b"F65"),
        lambda content: content.replace(b"[0,48]", b"[8,56]"),
        lambda content: content.replace(b'"shape"', b'"shade"'),
        lambda content: content[:0] + (2).to_bytes(8, "little") + b"[]",
    ],
)
def test_arrays_that_do_not_fill_their_file_are_refused(damage: Callable[[bytes], bytes]) -> None:
    content = save({"a": np.ones((2, 3))})
    assert damage(content) != content
    with pytest.raises(ModelError, match=r"^arrays\.safetensors: not a quadpi model, nor safetensors: "):
        read_safetensors(damage(content))
