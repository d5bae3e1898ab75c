# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's wind tunnel, on flights of a few seconds and with polynomials alone."""

from __future__ import annotations

import json
from functools import partial

import pytest
from pydantic import TypeAdapter

from quadpi_core.evaluation.compare import compare
from quadpi_core.evaluation.evaluation_result import Comparison, PublishedMetrics
from quadpi_core.paper import model_cache, windtunnel
from quadpi_core.paper.published import METHODS
from quadpi_core.paper.windtunnel import GROUPS, published_table, wind_tunnel
from quadpi_core.simulation.scenario import load_scenario

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
POOL = 'Fx: {fixed: [u], candidates: ["P^2(u, omega_avg)"]}\n'


@pytest.fixture
def identified(monkeypatch, tmp_path):
    """Settings that were identified and not read, of the wind tunnel made small."""
    scenario, pool = tmp_path / "short.yaml", tmp_path / "pool.yaml"
    scenario.write_text(SHORT)
    pool.write_text(POOL)
    monkeypatch.setattr(windtunnel, "SCENARIO", str(scenario))
    monkeypatch.setattr(windtunnel, "CANDIDATES", str(pool))
    settings, identify = [], model_cache.identify

    def record(flights, *arguments, **options):
        settings.append((options["settings"], [flight.name for flight in flights]))
        return identify(flights, *arguments, **options)

    monkeypatch.setattr(model_cache, "identify", record)
    return settings


def test_table_of_the_paper():
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
    plans = load_scenario(windtunnel.SCENARIO).flights
    winds = sorted(wind for members in GROUPS.values() for wind in members)
    assert sorted({plan.head_wind_m_s for plan in plans}) == winds


def test_models_learn_from_the_first_group_alone_and_are_kept(identified, tmp_path):
    folder = tmp_path / "kept"
    fly = partial(wind_tunnel, methods=("polynomial",), folder=folder)
    first = fly()
    learned = ["swing_00", "swing_05", "swing_10"]
    assert identified == [("paper", learned), ("default", learned)]
    assert first.groups == {
        "identification": learned,
        "interpolation": ["swing_08"],
        "extrapolation": ["swing_14"],
    }
    assert list(first.models) == ["polynomial-paper", "polynomial-default"]
    assert {model.cutoff_hz for model in first.models.values()} == set(first.flights) == {100.0, 30.0}

    again = fly()
    assert len(identified) == 2
    assert compare(again)[1] == compare(first)[1]
    assert fly(confidence=0.9).models["polynomial-paper"].confidence == 0.9
    assert len(identified) == 4


def test_without_models_the_command_line_makes_the_papers_table(quadpi, identified, monkeypatch, tmp_path):
    monkeypatch.setattr(
        wind_tunnel, "__kwdefaults__", wind_tunnel.__kwdefaults__ | {"methods": ("polynomial",)}
    )
    data = tmp_path / "data.json"
    ran = quadpi("evaluate", "--json", data, "--html", tmp_path / "page.html")
    assert (ran.status, ran.errors) == (0, "")
    assert len(identified) == 2
    result = json.loads(data.read_text())
    assert list(result["groups"]) == list(GROUPS)
    assert TypeAdapter(Comparison).validate_python(result).published == published_table()
    assert "89.19" in ran.output
    assert "89.19" in (tmp_path / "page.html").read_text()
