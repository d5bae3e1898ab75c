# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's own validation, on flights of a few seconds."""

from __future__ import annotations

import json

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.models import AerodynamicModel
from quadpi_core.paper import model_cache, published
from quadpi_core.paper.published import METHODS, published_case, published_tables
from quadpi_core.paper.validation_result import PublishedCoverage

POOL = 'Fx: {fixed: [mu_x], candidates: ["P^2(mu_x, mu_z)"]}\n'


@pytest.fixture
def identified(monkeypatch, scenario, tmp_path):
    """Methods that were identified and not read, of the paper's validation made small."""
    pool = tmp_path / "pool.yaml"
    pool.write_text(POOL)
    for name, value in (("TRAINING", scenario), ("VALIDATION", scenario), ("CANDIDATES", pool)):
        monkeypatch.setattr(published, name, str(value))
    methods, identify = [], model_cache.identify

    def record(*arguments, method, **options):
        methods.append(method)
        return identify(*arguments, method=method, **options)

    monkeypatch.setattr(model_cache, "identify", record)
    return methods


def test_tables_of_the_paper():
    tables = published_tables()
    assert set(tables) == set(METHODS)
    cells = [cell for axes in tables.values() for row in axes.values() for cell in vars(row).values()]
    assert all(set(axes) == set(AXES) for axes in tables.values())
    assert len(cells) == 3 * 6 * 3
    # "All estimation techniques comfortably encompass at least 95 %".
    assert all(0.95 <= cell.picp <= 1.0 for cell in cells)
    widest = max(cells, key=lambda cell: cell.nmpiw)
    assert widest is tables["polynomial"]["Fz"].model_variation
    assert widest == PublishedCoverage(1.0, 0.2732)


def test_training_and_realisations_have_different_noise(identified):
    own = published_case(methods=("polynomial",), seed=2)
    assert identified == ["polynomial"]
    own.case.check()
    assert [flight.name for flight in own.training] == [flight.name for flight in own.case.flights]
    for flight, noisy in zip(own.case.flights, own.training, strict=True):
        samples = own.case.samples(flight)
        training = (noisy.wrench - samples.wrench)[:, :3].ravel()
        assert training.std() == pytest.approx(0.03 * own.case.vehicle.mass_kg, rel=0.05)
        first = own.case.samples(
            published.contaminate(flight, own.case.noise, published.noise_seed(2, flight.name, 0))
        )
        assert abs(np.corrcoef(training, (first.wrench - samples.wrench)[:, :3].ravel())[0, 1]) < 0.05


def test_models_are_kept_and_taken_from_the_same_data_only(identified, tmp_path):
    folder = tmp_path / "models"
    first = published_case(methods=("polynomial",), folder=folder).case.models["polynomial"]
    again = published_case(methods=("polynomial",), folder=folder).case.models["polynomial"]
    assert identified == ["polynomial"]
    assert again.identity == first.identity == AerodynamicModel.load(folder / "polynomial").identity
    np.testing.assert_array_equal(again.fitted["Fx"].coefficients, first.fitted["Fx"].coefficients)

    published_case(methods=("polynomial",), folder=folder, seed=1)
    published_case(methods=("polynomial",), folder=folder, seed=1, settings="default")
    published_case(methods=("polynomial",), folder=folder, seed=1, settings="default", confidence=0.9)
    assert len(identified) == 4
    origin = folder / "polynomial.origin.json"
    origin.write_text(json.dumps(json.loads(origin.read_text()) | {"model": "another@000000000000"}))
    published_case(methods=("polynomial",), folder=folder, seed=1, settings="default", confidence=0.9)
    assert len(identified) == 5
