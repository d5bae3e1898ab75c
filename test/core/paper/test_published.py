# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's own validation, on flights of a few seconds."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
from pydantic import TypeAdapter

from quadpi_core.evaluation.evaluate import compare
from quadpi_core.evaluation.evaluation_result import Comparison, PublishedMetrics
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kind_registry import kind_of
from quadpi_core.paper import model_cache, published
from quadpi_core.paper.published import (
    GROUPS,
    METHODS,
    published_case,
    published_table,
    published_tables,
    wind_tunnel,
)
from quadpi_core.paper.validation_result import PublishedCoverage
from quadpi_core.simulation.scenario import load_scenario

POOL = 'Fx: {fixed: [mu_x], candidates: ["P^2(mu_x, mu_z)"]}\n'


@pytest.fixture
def identified(monkeypatch, scenario, tmp_path):
    """Methods that were identified and not read, of the paper's validation made small."""
    pool = tmp_path / "pool.yaml"
    pool.write_text(POOL)
    for name, value in (("TRAINING", scenario), ("VALIDATION", scenario), ("CANDIDATES", pool)):
        monkeypatch.setattr(published, name, str(value))
    methods, identify = [], model_cache.identify

    def record(*arguments):
        methods.append(kind_of(arguments[3]).name)
        return identify(*arguments)

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


SHORT = """
description: seconds in each wind
vehicle: hdbeetle
seed: 5
duration_s: 3
flights:
  swing_00:
    head_wind_m_s: 0
    motion: &swing {x: [{sine: {amplitude_m: 0.3, frequency_hz: 0.7, start_s: 0}}]}
  swing_05: {head_wind_m_s: 5, motion: *swing}
  swing_06: {head_wind_m_s: 6, motion: *swing}
  swing_08: {head_wind_m_s: 8, motion: *swing}
  swing_10: {head_wind_m_s: 10, motion: *swing}
  swing_14: {head_wind_m_s: 14, motion: *swing}
"""
TUNNEL_POOL = 'Fx: {fixed: [u], candidates: ["P^2(u, omega_avg)"]}\n'


@pytest.fixture
def flown(monkeypatch, tmp_path):
    """Settings that were identified and not read, of the wind tunnel made small."""
    scenario, pool = tmp_path / "short.yaml", tmp_path / "pool.yaml"
    scenario.write_text(SHORT)
    pool.write_text(TUNNEL_POOL)
    monkeypatch.setattr(published, "TUNNEL", str(scenario))
    monkeypatch.setattr(published, "TUNNEL_CANDIDATES", str(pool))
    settings, identify = [], model_cache.identify

    def record(flights, *arguments, **options):
        settings.append((arguments[2].settings, [flight.name for flight in flights]))
        return identify(flights, *arguments, **options)

    monkeypatch.setattr(model_cache, "identify", record)
    return settings


def test_table_of_the_wind_tunnel():
    table = published_table()
    assert set(table) == set(METHODS)
    assert all(set(axes) == {"Fx", "Fz", "My"} for axes in table.values())
    # "Most pronounced for models of Fz, and especially so for the ANN models."
    cells = {(m, a): groups["extrapolation"].picp for m, axes in table.items() for a, groups in axes.items()}
    assert min(cells, key=lambda cell: cells[cell]) == ("quality-driven", "Fz")
    assert table["bootstrap"]["Fz"]["extrapolation"] == PublishedMetrics(0.3921, 1.06)
    # "The polynomial PI widths remain constant regardless of interpolation or extrapolation."
    for groups in table["polynomial"].values():
        assert len({part.mpiw for part in groups.values()}) == 1


def test_the_scenario_has_the_winds_of_the_paper():
    plans = load_scenario(published.TUNNEL).flights
    winds = sorted(wind for members in GROUPS.values() for wind in members)
    assert sorted({plan.head_wind_m_s for plan in plans}) == winds


def test_models_learn_from_the_first_group_alone_and_are_kept(flown, tmp_path):
    folder = tmp_path / "kept"
    fly = partial(wind_tunnel, methods=("polynomial",), folder=folder)
    first = fly()
    learned = ["swing_00", "swing_05", "swing_10"]
    assert flown == [("paper", learned), ("default", learned)]
    assert first.groups == {
        "identification": learned,
        "interpolation": ["swing_08"],
        "extrapolation": ["swing_14"],
    }
    assert list(first.models) == ["polynomial-paper", "polynomial-default"]
    assert {model.cutoff_hz for model in first.models.values()} == set(first.flights) == {100.0, 30.0}

    again = fly()
    assert len(flown) == 2
    assert compare(again)[1] == compare(first)[1]
    assert fly(confidence=0.9).models["polynomial-paper"].confidence == 0.9
    assert len(flown) == 4


def test_without_models_the_command_line_makes_the_papers_table(quadpi, flown, monkeypatch, tmp_path):
    monkeypatch.setattr(
        wind_tunnel, "__kwdefaults__", wind_tunnel.__kwdefaults__ | {"methods": ("polynomial",)}
    )
    data = tmp_path / "data.json"
    ran = quadpi("evaluate", "--json", data, "--html", tmp_path / "page.html")
    assert (ran.status, ran.errors) == (0, "")
    assert len(flown) == 2
    result = json.loads(data.read_text())
    assert list(result["groups"]) == list(GROUPS)
    assert TypeAdapter(Comparison).validate_python(result).published == published_table()
    assert "89.19" in ran.output
    assert "89.19" in (tmp_path / "page.html").read_text()
