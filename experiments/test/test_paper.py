# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The paper's experiments, on flights of a few seconds, and the tables of what they give."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from paper import model_cache, published
from paper.numbers import (
    GROUPS,
    METHODS,
    CoverageAndWidth,
    TunnelCoverage,
    tunnel_numbers,
    validation_numbers,
)
from paper.published import PublishedValidation, published_case, tunnel_comparison, validate, wind_tunnel
from paper.result_tables import tunnel_table, validation_table

from quadpi_core.evaluation.evaluate import compare
from quadpi_core.flight import AXES
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kind_registry import kind_of
from quadpi_core.report.table import markdown_table
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import contaminate
from quadpi_core.validation.validation_result import (
    AxisValidation,
    ModelValidation,
    NoiseLevels,
    Validation,
    Variation,
)

SCENARIO = """
description: two short flights
vehicle: bebop2
seed: 3
duration_s: 3
flights:
  ahead: {motion: {x: [{sine: {amplitude_m: 0.6, frequency_hz: 0.7, start_s: 0}}]}}
  up: {motion: {height: [{sine: {amplitude_m: 0.3, frequency_hz: 0.8, start_s: 0}}]}}
"""
POOL = 'Fx: {fixed: [mu_x], candidates: ["P^2(mu_x, mu_z)"]}\n'
POLYNOMIAL = ("polynomial",)


@pytest.fixture
def identified(monkeypatch, tmp_path):
    """Methods that were identified and not read, of the paper's validation made small."""
    scenario, pool = tmp_path / "short.yaml", tmp_path / "pool.yaml"
    scenario.write_text(SCENARIO)
    pool.write_text(POOL)
    for name, value in (("TRAINING", scenario), ("VALIDATION", scenario), ("CANDIDATES", pool)):
        monkeypatch.setattr(published, name, str(value))
    methods, identify = [], model_cache.identify

    def record(*arguments):
        methods.append(kind_of(arguments[3]).name)
        return identify(*arguments)

    monkeypatch.setattr(model_cache, "identify", record)
    return methods


def cells(table):
    """Rows as drawn in Markdown, without the rule."""
    lines = [[cell.strip() for cell in row[1:-1].split("|")] for row in markdown_table(table).splitlines()]
    return [lines[0], *lines[2:]]


def test_tables_of_the_paper():
    tables = validation_numbers()
    assert set(tables) == set(METHODS)
    found = [cell for axes in tables.values() for row in axes.values() for cell in vars(row).values()]
    assert all(set(axes) == set(AXES) for axes in tables.values())
    assert len(found) == 3 * 6 * 3
    # "All estimation techniques comfortably encompass at least 95 %".
    assert all(0.95 <= cell.picp <= 1.0 for cell in found)
    widest = max(found, key=lambda cell: cell.nmpiw)
    assert widest is tables["polynomial"]["Fz"].model_variation
    assert widest == CoverageAndWidth(1.0, 0.2732)


def test_training_and_realisations_have_different_noise(identified, tmp_path):
    own = published_case(tmp_path / "models", methods=POLYNOMIAL, seed=2)
    assert identified == ["polynomial"]
    own.case.check()
    assert [flight.name for flight in own.training] == [flight.name for flight in own.case.flights]
    for flight, noisy in zip(own.case.flights, own.training, strict=True):
        samples = own.case.samples(flight)
        training = (noisy.wrench - samples.wrench)[:, :3].ravel()
        assert training.std() == pytest.approx(0.03 * own.case.vehicle.mass_kg, rel=0.05)
        first = own.case.samples(contaminate(flight, own.case.noise, published.noise_seed(2, flight.name, 0)))
        assert abs(np.corrcoef(training, (first.wrench - samples.wrench)[:, :3].ravel())[0, 1]) < 0.05


def test_models_are_kept_and_taken_from_the_same_data_only(identified, tmp_path):
    folder = tmp_path / "models"
    case = partial(published_case, folder, methods=POLYNOMIAL)
    first = case().case.models["polynomial"]
    again = case().case.models["polynomial"]
    assert identified == ["polynomial"]
    assert again.identity == first.identity == AerodynamicModel.load(folder / "polynomial").identity
    np.testing.assert_array_equal(again.fitted.axes["Fx"].coefficients, first.fitted.axes["Fx"].coefficients)

    case(seed=1)
    case(seed=1, settings="default")
    case(seed=1, settings="default", confidence=0.9)
    assert len(identified) == 4
    origin = folder / "polynomial.origin.json"
    origin.write_text(json.dumps(json.loads(origin.read_text()) | {"model": "another@000000000000"}))
    case(seed=1, settings="default", confidence=0.9)
    assert len(identified) == 5


def test_models_are_identified_again_by_other_code(identified, tmp_path, monkeypatch):
    case = partial(published_case, tmp_path / "models", methods=POLYNOMIAL)
    case()
    monkeypatch.setattr(model_cache, "code_fingerprint", lambda: "other")
    case()
    assert len(identified) == 2


def test_a_validation_is_taken_up_and_judges_training_on_its_own_noise(identified, tmp_path):
    first = validate("paper", 2, tmp_path / "kept", POLYNOMIAL)
    (chunk,) = (tmp_path / "kept" / "realisations").rglob("*.npz")
    written = chunk.stat().st_mtime_ns
    assert validate("paper", 2, tmp_path / "kept", POLYNOMIAL) == first
    assert chunk.stat().st_mtime_ns == written
    assert identified == ["polynomial"]
    own = published_case(tmp_path / "kept" / "models", methods=POLYNOMIAL)
    seen, measured = first.training["polynomial"], np.concatenate([f.wrench[:, 0] for f in own.training])
    assert set(seen) == {"Fx"}
    assert 0.9 < seen["Fx"].picp < 1.0
    # Its interval is as wide on the validation flights, which are the same ones here.
    width = first.result.models["polynomial"].axes["Fx"].measurement_variation.mpiw
    assert seen["Fx"].nmpiw == pytest.approx(width / np.ptp(measured), rel=0.01)

    _, *body = cells(validation_table({"paper": first}, AXES[:3]))
    assert len(body) == 2
    assert body[0][:3] == ["Fx", "polynomial", "paper"]
    assert float(body[0][3]) == pytest.approx(100.0 * seen["Fx"].picp, abs=0.006)


def test_validation_has_both_settings_above_the_papers_numbers():
    def result(settings, picp):
        variation = Variation(picp, None, 1.0, 1.0, 0.0345, 1.0)
        axis = AxisValidation(variation, variation, replace(variation, nmpiw=1.0))
        models = {"polynomial": ModelValidation("m", "polynomial", settings, dict.fromkeys(AXES, axis), {})}
        validation = Validation("0", "v", 0.95, 0, 1, NoiseLevels(*[0.1] * 5), 30.0, {}, models)
        seen = {"polynomial": dict.fromkeys(AXES, CoverageAndWidth(picp, 0.0123))}
        return PublishedValidation(validation, seen)

    heading, *body = cells(
        validation_table({"paper": result("paper", 0.9437), "default": result("default", 1.0)}, AXES[2:4])
    )
    assert len(heading) == 10
    assert [row[2] for row in body] == ["paper", "default", "*published*"] * 2
    assert [row[:2] for row in body[:3]] == [["Fz", "polynomial"], ["", ""], ["", ""]]
    # Training and combined variation stand for reference: they are not judged.
    assert body[0][3:] == ["94.37", "▼ 94.37", "▼ 94.37", "94.37", "1.23", "3.45", "3.45"]
    assert body[2][3:] == ["*96.68*", "*100.00*", "*99.94*", "", "*8.13*", "*27.32*", "*21.78*"]


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
    table = tunnel_numbers()
    assert set(table) == set(METHODS)
    assert all(set(axes) == {"Fx", "Fz", "My"} for axes in table.values())
    # "Most pronounced for models of Fz, and especially so for the ANN models."
    found = {(m, a): groups["extrapolation"].picp for m, axes in table.items() for a, groups in axes.items()}
    assert min(found, key=lambda cell: found[cell]) == ("quality-driven", "Fz")
    assert table["bootstrap"]["Fz"]["extrapolation"] == TunnelCoverage(0.3921, 1.06)
    # "The polynomial PI widths remain constant regardless of interpolation or extrapolation."
    for groups in table["polynomial"].values():
        assert len({part.mpiw for part in groups.values()}) == 1


def test_the_scenario_has_the_winds_of_the_paper():
    plans = load_scenario(published.TUNNEL).flights
    winds = sorted(wind for members in GROUPS.values() for wind in members)
    assert sorted({plan.head_wind_m_s for plan in plans}) == winds


@pytest.mark.slow
def test_models_learn_from_the_first_group_alone_and_are_kept(flown, tmp_path):
    fly = partial(wind_tunnel, tmp_path / "kept", methods=POLYNOMIAL)
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


@pytest.mark.usefixtures("flown")
def test_the_papers_numbers_follow_the_models_of_their_method(monkeypatch, tmp_path):
    short = partial(wind_tunnel, methods=POLYNOMIAL)
    monkeypatch.setattr(published, "wind_tunnel", short)
    comparison = tunnel_comparison(tmp_path / "kept")
    assert list(comparison.groups) == list(GROUPS)
    # As if two models of another method stood beside them.
    models = comparison.models
    others = {f"net{name}": replace(model, method="bootstrap") for name, model in models.items()}
    heading, *body = cells(tunnel_table(replace(comparison, models=models | others)))
    assert heading[2:5] == [f"PICP % {group}" for group in GROUPS]
    assert [row[1] for row in body] == [*models, "*published*", *others, "*published*"]
    assert body[2][2:] == ["*95.29*", "*96.06*", "*89.19*", "*0.83*", "*0.83*", "*0.83*"]
    assert body[5][2:5] == ["*98.26*", "*97.35*", "*97.15*"]
