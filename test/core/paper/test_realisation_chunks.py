# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Realisations in chunks: the same on any workers, and taken up again where a run ended."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.paper import realisation_chunks
from quadpi_core.paper.realisation_chunks import run_realisations
from quadpi_core.paper.realisations import realise

COUNT = 7


@pytest.fixture(autouse=True)
def short_chunks(monkeypatch):
    monkeypatch.setattr(realisation_chunks, "CHUNK", 3)


@pytest.fixture
def counted(monkeypatch):
    """The chunks that were counted and not read."""
    spans = []

    def count(case, span):
        spans.append(span)
        return realise(case, span)

    monkeypatch.setattr(realisation_chunks, "realise", count)
    return spans


def test_chunks_join_to_the_whole(case, same, tmp_path):
    whole = realise(case, range(COUNT))
    assert same(run_realisations(case, COUNT, workers=1), whole)
    assert same(run_realisations(case, COUNT, workers=1, folder=tmp_path), whole)
    assert same(run_realisations(case, COUNT, workers=1, folder=tmp_path), whole)


def test_finished_chunks_are_not_counted_again(case, tmp_path, counted):
    run_realisations(case, 6, workers=1, folder=tmp_path)
    assert counted == [range(3), range(3, 6)]
    run_realisations(case, COUNT, workers=1, folder=tmp_path)
    assert counted[2:] == [range(6, 7)]


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 cut", b"nothing of ours"], ids=["empty", "cut short", "foreign"]
)
def test_damaged_chunk_is_counted_again(case, same, tmp_path, counted, content):
    whole = run_realisations(case, 6, workers=1, folder=tmp_path)
    damaged = sorted(tmp_path.rglob("*.npz"))[1]
    damaged.write_bytes(content)
    assert same(run_realisations(case, 6, workers=1, folder=tmp_path), whole)
    assert counted[2:] == [range(3, 6)]


def test_cut_chunk_is_counted_again(case, same, tmp_path, counted):
    whole = run_realisations(case, 6, workers=1, folder=tmp_path)
    cut = min(tmp_path.rglob("*.npz"))
    cut.write_bytes(cut.read_bytes()[:-200])
    assert same(run_realisations(case, 6, workers=1, folder=tmp_path), whole)
    assert counted[2:] == [range(3)]


def test_chunk_with_objects_is_not_unpickled(case, tmp_path, counted):
    run_realisations(case, 3, workers=1, folder=tmp_path)
    path = min(tmp_path.rglob("*.npz"))
    with np.load(path) as file:
        arrays = dict(file)
    arrays["model"] = np.array([{"an": "object"}], dtype=object)
    np.savez(path, **arrays)
    run_realisations(case, 3, workers=1, folder=tmp_path)
    assert counted == [range(3), range(3)]


def test_chunks_of_another_case_are_left_alone(case, model, tmp_path, counted):
    narrower = replace(model.fitted["Fx"], rule=replace(model.fitted["Fx"].rule, std=1e-3))
    others = [
        replace(case, seed=8),
        replace(case, confidence=0.9),
        replace(case, noise=replace(case.noise, rates=0.02)),
        replace(case, flights=case.flights[:1]),
        replace(case, flights=(replace(case.flights[0], wind=case.flights[0].wind + 0.1), case.flights[1])),
        replace(case, models={"fitted": replace(model, fitted={**model.fitted, "Fx": narrower})}),
        replace(case, models={"named": model}),
    ]
    run_realisations(case, 3, workers=1, folder=tmp_path)
    for other in others:
        run_realisations(other, 3, workers=1, folder=tmp_path)
    assert len(counted) == len(list(tmp_path.iterdir())) == 1 + len(others)


def test_interrupted_run_is_taken_up(case, same, tmp_path, counted):
    def interrupt(finished):
        if finished == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_realisations(case, COUNT, workers=1, folder=tmp_path, progress=interrupt)
    seen = []
    resumed = run_realisations(case, COUNT, workers=1, folder=tmp_path, progress=seen.append)
    assert counted == [range(3), range(3, 6), range(6, 7)]
    assert seen == [3, 6, 7]
    assert same(resumed, realise(case, range(COUNT)))


@pytest.mark.slow
def test_workers_and_a_cluster_count_the_same(case, same, tmp_path, cluster):
    whole = realise(case, range(COUNT))
    assert case.references  # computed here; each worker computes its own
    assert same(run_realisations(case, COUNT, workers=2), whole)
    assert same(run_realisations(case, COUNT, scheduler=cluster, folder=tmp_path), whole)
    assert len(list(tmp_path.rglob("*.npz"))) == 3
