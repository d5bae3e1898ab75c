# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The names of `import quadpi_core`: there, typed, documented, and imported when they are first used."""

from __future__ import annotations

import ast
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import quadpi_core

ROOT = Path(__file__).resolve().parents[2]
NAMES = sorted(set(dir(quadpi_core)) - set(vars(quadpi_core)))


def test_each_is_there_and_in_the_documents():
    page = (ROOT / "docs" / "library.md").read_text()
    assert NAMES
    for name in NAMES:
        assert getattr(quadpi_core, name).__name__ == name
        assert re.search(rf"\b{name}\b", page), name


def test_type_checkers_see_the_same_names():
    tree = ast.parse((ROOT / "quadpi_core" / "__init__.py").read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    typed = {
        name.name: getattr(importlib.import_module(str(node.module)), name.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for name in node.names
    }
    assert typed == {name: getattr(quadpi_core, name) for name in NAMES}


def test_another_name_is_refused():
    with pytest.raises(AttributeError, match="has no attribute 'Vehicles'"):
        quadpi_core.Vehicles  # noqa: B018


def test_the_import_brings_nothing_heavy():
    code = "import sys, quadpi_core; print('numpy' in sys.modules, quadpi_core.Vehicle.load('bebop2').name)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "bebop2"]
