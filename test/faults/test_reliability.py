# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The list of faults, README.md, and the tests of faults are the same list."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (Path(__file__).parent / "README.md").read_text()
# Every test of these is a fault with a row; of other files the page names some.
FAULTS = (
    "test/faults/test_sensors.py",
    "test/faults/test_motion_capture.py",
    "test/faults/test_stamps.py",
    "test/ros/test_live_faults.py",
)


def rows() -> list[list[str]]:
    """Cells of every row of the tables."""
    lines = re.findall(r"^\| (.*) \|$", PAGE, flags=re.MULTILINE)
    return [cells for line in lines if (cells := line.split(" | "))[0] not in ("fault", "---")]


def named_in(cell: str) -> list[tuple[str, str]]:
    """File and name of each test that a cell names, which holds nothing else."""
    matches = [re.fullmatch(r"`(test/\S+\.py)::(test_\w+)`", part) for part in cell.split(", ")]
    assert all(matches), cell
    return [(match[1], match[2]) for match in matches if match]


def names_in(path: str) -> set[str]:
    tree = ast.parse((ROOT / path).read_text())
    names = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
    return {name for name in names if name.startswith("test_")}


@pytest.mark.parametrize("cells", rows(), ids=lambda cells: cells[0])
def test_every_row_names_a_test(cells):
    fault, says, _, test = cells
    for path, name in named_in(test):
        assert name in names_in(path)
    assert fault
    assert says


@pytest.mark.parametrize("path", FAULTS)
def test_every_test_has_a_row(path):
    named = {name for cells in rows() for file, name in named_in(cells[3]) if file == path}
    assert named == names_in(path)
