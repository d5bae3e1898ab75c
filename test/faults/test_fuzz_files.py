# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Altered model folders of every kind: refused in one line that names the folder, or usable."""

import hashlib
import json
import re
import shutil

import numpy as np
import pytest
from hypothesis import given

from quadpi_core.errors import ModelError
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_folder import ARRAYS_FILE, MODEL_FILE

from .damage import altered, bounded, damaged, refusing

EXAMPLES = 60


@pytest.fixture
def load_model(each_model, tmp_path):
    """load_model(JSON text, arrays): writes both into a folder, and uses the model if it loads."""
    folder = tmp_path / "model"
    folder.mkdir()
    inputs = np.zeros((2, len(INPUT_NAMES)))
    AerodynamicModel.load(each_model).evaluate(inputs)

    def load(text, arrays):
        (folder / MODEL_FILE).write_bytes(text)
        (folder / ARRAYS_FILE).write_bytes(arrays)
        with refusing(folder):
            model = AerodynamicModel.load(folder)
            model.evaluate(inputs)
            assert model.calibration()

    return load


def test_altered_model(each_model, load_model):
    arrays = (each_model / ARRAYS_FILE).read_bytes()
    content = json.loads((each_model / MODEL_FILE).read_text())

    @bounded(EXAMPLES)
    @given(altered(content))
    def check(data):
        load_model(json.dumps(data).encode(), arrays)

    check()


@pytest.mark.parametrize("confidence", [0.0, 1.0, -0.5])
def test_a_confidence_that_has_no_intervals_is_the_fault_of_the_file(each_model, tmp_path, confidence):
    folder = tmp_path / "model"
    shutil.copytree(each_model, folder)
    content = json.loads((folder / MODEL_FILE).read_text())
    (folder / MODEL_FILE).write_text(json.dumps({**content, "confidence": confidence}))
    with pytest.raises(ModelError, match=rf"{re.escape(str(folder))}: .*confidence"):
        AerodynamicModel.load(folder)


def test_damaged_model_file(each_model, load_model):
    arrays = (each_model / ARRAYS_FILE).read_bytes()
    text = (each_model / MODEL_FILE).read_bytes()

    @bounded(EXAMPLES)
    @given(damaged(text))
    def check(data):
        load_model(data, arrays)

    check()


def test_damaged_arrays_with_the_hash_put_right(each_model, load_model):
    arrays = (each_model / ARRAYS_FILE).read_bytes()
    content = json.loads((each_model / MODEL_FILE).read_text())
    header = int.from_bytes(arrays[:8], "little") + 8

    @bounded(EXAMPLES)
    @given(damaged(arrays[:header]).map(lambda head: head + arrays[header:]) | damaged(arrays))
    def check(data):
        right = {**content, "arrays_sha256": hashlib.sha256(data).hexdigest()}
        load_model(json.dumps(right).encode(), data)

    check()
