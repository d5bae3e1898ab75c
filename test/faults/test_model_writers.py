# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Several processes that write one model folder: who reads it gets one model or the other, whole."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.aerodynamic import AerodynamicModel

from .conftest import GOLDEN_MODEL

WRITES = 60


def test_readers_see_one_or_the_other(tmp_path):
    folder = tmp_path / "model"
    good = AerodynamicModel.load(GOLDEN_MODEL)
    variants = [replace(good, cutoff_hz=cutoff) for cutoff in (20.0, 30.0)]
    identities = {variant.save(folder).identity for variant in variants}

    def write(variant):
        for _ in range(WRITES):
            variant.save(folder)

    seen = set()
    with ThreadPoolExecutor(2) as pool:
        writers = [pool.submit(write, variant) for variant in variants]
        while not all(writer.done() for writer in writers):
            seen.add(AerodynamicModel.load(folder).identity)
        for writer in writers:
            writer.result()
    assert seen == identities
    assert [path.name for path in tmp_path.iterdir()] == ["model"]


def test_the_first_of_two_writers_makes_the_folder(tmp_path):
    folder = tmp_path / "model"
    good = AerodynamicModel.load(GOLDEN_MODEL)
    for _ in range(20):
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(lambda _: good.save(folder), range(2)))
        assert AerodynamicModel.load(folder).axes == good.axes
        shutil.rmtree(folder)


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"model\.json: cannot be read: No such file"):
        AerodynamicModel.load(tmp_path / "model")


def test_a_folder_that_is_moved_away_for_a_moment_is_waited_for(tmp_path, monkeypatch):
    folder = tmp_path / "model"
    identity = AerodynamicModel.load(GOLDEN_MODEL).save(folder).identity
    folder.rename(tmp_path / "elsewhere")
    monkeypatch.setattr(
        "quadpi_core.models.model_folder.time.sleep", lambda _: (tmp_path / "elsewhere").rename(folder)
    )
    assert AerodynamicModel.load(folder).identity == identity
