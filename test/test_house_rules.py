# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The checks of the house rules find what they are for."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture
def rules(tool: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program, looking at an empty copy of the project."""
    monkeypatch.setattr(tool, "ROOT", tmp_path)
    for name in ("a", "b"):
        (tmp_path / "quadpi_core" / name).mkdir(parents=True)
        (tmp_path / "quadpi_core" / name / "__init__.py").touch()
        (tmp_path / "test" / "core" / name).mkdir(parents=True)
        (tmp_path / "test" / "core" / name / "test_filter.py").touch()
    (tmp_path / "CONTRIBUTING.md").write_text(
        "| `a` | 4 | 3 | 2 |\n| `b` | 4 | 3 | 2 |\n| `core` | 20 | 1 | 2 |\n| numpy | arrays |\n"
    )
    (tmp_path / "pyproject.toml").write_text('dependencies = [\n    "numpy>=1.26",\n]\n')
    return tool


def kernel(parameters: int) -> str:
    names = ",\n".join(f"const std::map<int, int>& p{number}" for number in range(parameters))
    return f"inline std::array<double, 3> step({names}) {{\n}}\n"


def test_two_files_of_one_name(rules: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (rules.ROOT / "quadpi_core" / name / "filter.py").touch()
    assert rules.main() == 1
    assert "filter.py: quadpi_core/a/filter.py, quadpi_core/b/filter.py" in capsys.readouterr().out


@pytest.mark.parametrize(("parameters", "status"), [(8, 0), (9, 1)])
def test_kernels_of_many_parameters(
    rules: ModuleType, capsys: pytest.CaptureFixture[str], parameters: int, status: int
) -> None:
    (rules.ROOT / "core").mkdir()
    (rules.ROOT / "core" / "kernel.hpp").write_text(kernel(parameters))
    assert rules.main() == status
    assert ("core/kernel.hpp: step takes 9" in capsys.readouterr().out) == bool(status)


@pytest.mark.parametrize(("call", "status"), [("std::exp", 1), ("atan2", 1), ("std::sqrt", 0), ("// exp", 0)])
def test_elementary_functions_of_the_c_library(
    rules: ModuleType, capsys: pytest.CaptureFixture[str], call: str, status: int
) -> None:
    (rules.ROOT / "core").mkdir()
    (rules.ROOT / "core" / "kernel.hpp").write_text(f"double f(double x) {{ return {call}(x); }}\n")
    assert rules.main() == status
    name = call.removeprefix("std::")
    assert (f"core/kernel.hpp:1: {name}\n" in capsys.readouterr().out) == bool(status)


def test_a_room_without_tests(rules: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    (rules.ROOT / "test" / "core" / "b" / "test_filter.py").unlink()
    assert rules.main() == 1
    assert "rooms without tests in their folder: 1\n  b\n" in capsys.readouterr().out


@pytest.mark.parametrize(("words", "status"), [(25_000, 0), (25_001, 1)])
def test_documents_that_are_too_long(
    rules: ModuleType, capsys: pytest.CaptureFixture[str], words: int, status: int
) -> None:
    (rules.ROOT / "docs").mkdir()
    (rules.ROOT / "docs" / "page.md").write_text("word " * words)
    assert rules.main() == status
    assert ("  docs: 25001\n" in capsys.readouterr().out) == bool(status)


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"filter": 4, "kernel": 0}, ""),
        ({"filter": 5}, "a: 5 lines, 4 allowed"),
        ({"filter": 0, "kernel": 0, "more": 0}, "a: 4 files, 3 allowed"),
    ],
)
def test_a_room_that_passes_its_budget(
    rules: ModuleType, capsys: pytest.CaptureFixture[str], files: dict[str, int], message: str
) -> None:
    for name, lines in files.items():
        (rules.ROOT / "quadpi_core" / "a" / f"{name}.py").write_text("\n" * lines)
    assert rules.main() == bool(message)
    printed = capsys.readouterr().out
    assert f"budgets of rooms exceeded: {bool(message):d}\n" in printed
    assert message in printed


def test_a_room_without_a_budget(rules: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    (rules.ROOT / "quadpi_core" / "__init__.py").touch()
    assert rules.main() == 1
    assert "  quadpi_core: has no budget\n" in capsys.readouterr().out


@pytest.mark.parametrize("package", ["scipy", "numpy"])
def test_a_required_package_has_a_line(
    rules: ModuleType, capsys: pytest.CaptureFixture[str], package: str
) -> None:
    (rules.ROOT / "pyproject.toml").write_text(f'dependencies = [\n    "{package}>=1",\n]\n')
    assert rules.main() == (package == "scipy")
    assert ("  numpy\n  scipy\n" in capsys.readouterr().out) == (package == "scipy")
