# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import pytest

from quadpi_core.evaluation.evaluation_result import ComparedEvaluation, Comparison, PublishedMetrics
from quadpi_core.flight import AXES
from quadpi_core.paper.published import published_tables
from quadpi_core.paper.validation_result import (
    AxisValidation,
    ModelValidation,
    NoiseLevels,
    TrainingCoverage,
    Validation,
    Variation,
)
from quadpi_core.report import markdown
from quadpi_core.report.comparison_page import rows
from quadpi_core.report.terminal_tables import final_terms


def cells(text):
    """Rows of a Markdown table, without its rule; every row has as many cells as the first."""
    lines = [
        [cell.strip() for cell in line.replace("\\|", "¦")[1:-1].split("|")] for line in text.splitlines()
    ]
    assert len({len(line) for line in lines}) == 1
    assert all(set(rule) <= set(":-") for rule in lines[1])
    return [lines[0], *lines[2:]]


@pytest.fixture
def comparison(case):
    """Two models of one method and one of another, which holds three axes only."""
    whole = vars(case.evaluation)
    forces = {
        name: replace(part, axes={axis: part.axes[axis] for axis in AXES[:3]})
        for name, part in case.evaluation.groups.items()
    }
    models = {
        "poly-paper": ComparedEvaluation(**whole, settings="paper", cutoff_hz=100.0),
        "poly": ComparedEvaluation(**whole, settings="default", cutoff_hz=30.0),
        "net": ComparedEvaluation(
            **whole | {"groups": forces, "method": "bootstrap"}, settings="default", cutoff_hz=30.0
        ),
    }
    groups = {name: part.flights for name, part in case.evaluation.groups.items()}
    known = {group: PublishedMetrics(0.9819, 0.7) for group in groups}
    return Comparison("0", "v", 0.95, False, groups, {"polynomial": {"Fx": known}}, models)


def test_published_numbers_follow_the_models_of_their_method(comparison):
    order = [(row.axis, row.model) for row in rows(comparison)]
    assert order[:5] == [
        ("Fx", "poly-paper"),
        ("Fx", "poly"),
        ("Fx", None),
        ("Fx", "net"),
        ("Fy", "poly-paper"),
    ]
    assert sum(model is None for _, model in order) == 1
    assert [axis for axis, model in order if model == "net"] == list(AXES[:3])

    heading, *body = cells(markdown.comparison(comparison))
    assert heading[2:] == ["PICP % known", "PICP % new & fast", "MPIW known", "MPIW new & fast"]
    assert len(body) == len(order)
    assert body[2][1:] == ["*published*", "*98.19*", "*98.19*", "*0.70*", "*0.70*"]
    assert body[0][0] == "Fx [N]"
    assert all(row[3].startswith("▼") != (row[1] == "*published*") for row in body)


def test_terms_stand_in_the_order_of_selection(case):
    again = [
        *case.model.selection["Fx"],
        {"term": "|v|*w", "coefficient": 2.0, "r2": 0.95, "fixed": False},
        {"term": "mu_x * omega_avg", "coefficient": 1.5, "r2": 0.96, "fixed": False},
    ]
    # A term that was taken out and came back stands where it came back; one that is left out, nowhere.
    assert [term.name for term in final_terms(again)] == ["1", "|v|*w", "mu_x * omega_avg"]
    selection = case.model.selection | {"Fx": again}
    heading, *body = cells(markdown.structures(selection, ["Fx", "Mz"]))
    assert heading == ["Fx", "coefficient", "R²", "Mz", "coefficient", "R²"]
    assert body[0] == ["*`1`*", "-2.000e-01", "–"] * 2
    assert body[1][:3] == ["`¦v¦*w`", "2.000e+00", "0.9500"]
    assert len(body) == 3


def test_validation_has_both_settings_above_the_papers_numbers():
    def result(settings, picp):
        variation = Variation(picp, None, 1.0, 1.0, 0.0345, 1.0)
        axis = AxisValidation(TrainingCoverage(picp, 1.0, 1.0, 0.0345), variation, variation, variation)
        models = {"polynomial": ModelValidation("m", "polynomial", settings, dict.fromkeys(AXES, axis), {})}
        noise = NoiseLevels(*[0.1] * 5)
        return Validation("0", "v", 0.95, 0, 1, noise, 30.0, {}, models, published_tables())

    heading, *body = cells(markdown.validation([result("paper", 0.9437), result("default", 1.0)], AXES[2:4]))
    assert len(heading) == 10
    assert [row[2] for row in body] == ["paper", "default", "*published*"] * 2
    # Training and combined variation stand for reference: they are not judged.
    assert body[0][3:] == ["94.37", "▼ 94.37", "▼ 94.37", "94.37", "3.45", "3.45", "3.45"]
    assert body[2][3:] == ["*96.68*", "*100.00*", "*99.94*", "", "*8.13*", "*27.32*", "*21.78*"]


def test_width_is_told_over_that_of_an_ideal_interval(comparison):
    metrics = comparison.models["poly"].groups["known"].axes["Fx"]
    assert markdown.ideal_width(replace(metrics, rmse=2.0), 0.95) == pytest.approx(
        2.0 * 1.95996 * 2.0, rel=1e-5
    )
    models = {
        name: replace(model, groups={"all": model.groups["known"]})
        for name, model in comparison.models.items()
    }
    one = replace(comparison, groups={"all": ["slow"]}, models=models)
    results = {"3 m/s": {"fixed": one, "adaptive": one}, "8 m/s": {"fixed": one, "adaptive": one}}
    ratio = metrics.mpiw / (2.0 * 1.95996 * metrics.rmse)
    covered = f"{100 * metrics.picp:.1f}"
    heading, *body = cells(markdown.left_out(results))
    assert heading == ["flight", "model", "intervals", *AXES]
    assert body[0][:4] == ["3 m/s", "poly-paper", "fixed", f"{covered} · {ratio:.2f}"]
    assert [row[0] for row in body if row[0]] == ["3 m/s", "8 m/s"]
    assert body[5][5:] == [body[4][5], "", "", ""]
    assert cells(markdown.left_out_summary(results))[1][2] == f"{covered} / {covered} · {ratio:.2f}"
