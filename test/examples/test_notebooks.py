# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The notebooks run from their first cell to their last, and show what they are about."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from matplotlib import pyplot

EXAMPLES = Path(__file__).parents[2] / "examples"
NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
# Types of what the cells show, in their order; figures are counted.
SHOWS = {
    "identify_and_judge": (
        ["Flights", "DataFrame", "WrenchModel", "CoverageTable", "DataFrame", "WrenchModel"],
        2,
    ),
    "missing_effect": (["Flights", "Discrepancy", "DataFrame", "DataFrame"], 1),
    "own_regressor": (["Flights", "ndarray", "DataFrame", "float"], 1),
}


def code(notebook: Path) -> list[str]:
    """The code of its cells."""
    cells = json.loads(notebook.read_text())["cells"]
    return ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]


def shown(notebook: Path) -> list[Any]:
    """Run all cells in one namespace, and take what each ends with, as Jupyter shows it."""
    names: dict[str, Any] = {"__name__": "__main__"}
    found = []
    for number, text in enumerate(code(notebook), 1):
        tree, where = ast.parse(text), f"{notebook.name}, code cell {number}"
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, where, "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), where, "eval"), names)
            if value is not None and not text.rstrip().endswith(";"):
                found.append(value)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.stem)
def test_it_runs(notebook, tmp_path, monkeypatch):
    mpl.use("agg")
    monkeypatch.chdir(tmp_path)
    kinds, figures = SHOWS[notebook.stem]
    pyplot.close("all")  # of other tests
    try:
        results = shown(notebook)
        assert len(pyplot.get_fignums()) == figures
    finally:
        pyplot.close("all")
    assert [type(one).__name__ for one in results] == kinds
    for one in results:
        if type(one).__module__.startswith("quadpi_core"):
            assert "<table>" in one._repr_html_()


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda notebook: notebook.stem)
def test_it_is_kept_without_outputs(notebook):
    book = json.loads(notebook.read_text())
    assert book["nbformat"] == 4
    for cell in book["cells"]:
        assert cell["cell_type"] == "markdown" or (cell["outputs"], cell["execution_count"]) == ([], None)
    assert notebook.stat().st_size < 10_000
