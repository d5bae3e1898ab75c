# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from io import StringIO

import pytest
from rich.console import Console

from quadpi_core.report.style import number, percent
from quadpi_core.report.terminal_tables import evaluation_table, selection_table


def rendered(table, width=200):
    console = Console(width=width, file=StringIO())
    console.print(table)
    return console.file.getvalue()


def test_evaluation_table_marks_short_coverage(case):
    known, fast = rendered(evaluation_table(case.evaluation)).split("new & fast")
    axes = [line for line in fast.splitlines() if line.strip().startswith(("F", "M"))]
    assert "▼" not in known
    assert len(axes) == 6
    assert all("▼" in line for line in axes)


def test_evaluation_table_fits_a_narrow_terminal(case):
    wide = {"picp": 0.9999, "picp_ci": [0.8, 0.949], "mpiw": 1e-5, "nmpiw": 1.6, "rmse": 1e-5}
    wide |= {"r2": -38.794, "n_eff": 12345.0}
    groups = {
        name: replace(part, axes={axis: replace(metrics, **wide) for axis, metrics in part.axes.items()})
        for name, part in case.evaluation.groups.items()
    }
    evaluation = replace(case.evaluation, groups=groups)
    assert "…" not in rendered(evaluation_table(evaluation), width=80)


def test_selection_table_shows_what_the_model_holds(case):
    text = rendered(selection_table(case.model.selection["Fx"], "Fx"))
    (kept,) = [line.split() for line in text.splitlines() if "mu_x" in line]
    assert kept == ["mu_x", "*", "omega_avg", "1.5000e+00", "0.9000", "0.100"]
    (out,) = [line.split() for line in text.splitlines() if line.strip().startswith("p ")]
    assert out[1] == "–"


@pytest.mark.parametrize(
    ("fraction", "text"),
    [(0.95, "95.0 %"), (1.0, "100.0 %"), (0.99991, "> 99.9 %"), (0.0, "0.0 %"), (1e-5, "< 0.1 %")],
)
def test_percent_never_rounds_to_certainty(fraction, text):
    assert percent(fraction) == text


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.4, "0.400"), (469.2, "469"), (999.7, "1000"), (38779, "38779"), (1.2e-5, "1.20e-05"), (None, "–")],
)
def test_numbers_have_three_digits(value, text):
    assert number(value) == text
