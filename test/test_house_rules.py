# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The checks of the house rules find what they are for."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def rules(tmp_path: Path) -> ModuleType:
    """The program, looking at an empty copy of the project."""
    specification = importlib.util.spec_from_file_location("house_rules", ROOT / "tools" / "house_rules.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    module.ROOT = tmp_path
    for name in ("a", "b"):
        (tmp_path / "quadpi_core" / name).mkdir(parents=True)
        (tmp_path / "quadpi_core" / name / "__init__.py").touch()
    return module


def kernel(parameters: int) -> str:
    names = ", ".join(f"p{number}" for number in range(parameters))
    return f"@njit(cache=True)\ndef step({names}):\n    pass\n"


def test_two_files_of_one_name(rules: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (rules.ROOT / "quadpi_core" / name / "filter.py").touch()
    assert rules.main() == 1
    assert "filter.py: quadpi_core/a/filter.py, quadpi_core/b/filter.py" in capsys.readouterr().out


@pytest.mark.parametrize(("parameters", "status"), [(8, 0), (9, 1)])
def test_kernels_of_many_parameters(
    rules: ModuleType, capsys: pytest.CaptureFixture[str], parameters: int, status: int
) -> None:
    (rules.ROOT / "quadpi_core" / "a" / "kernel.py").write_text(kernel(parameters))
    assert rules.main() == status
    assert ("kernel.py:2: step takes 9" in capsys.readouterr().out) == bool(status)
