# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The bootstrap redoes what changed, no more and no less, and fails in plain words."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).resolve().parents[1] / "tools"


@pytest.fixture
def bootstrap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module on an empty checkout, with steps that only record that they were made."""
    spec = importlib.util.spec_from_file_location("bootstrap", TOOLS / "bootstrap.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "bootstrap", module)
    spec.loader.exec_module(module)
    module.ROOT, module.VENV, module.LOGS = tmp_path, tmp_path / ".venv", tmp_path / "build"
    module.ENVIRONMENT_INPUTS = (tmp_path / "pins",)
    module.VENV.mkdir()
    module.made = []
    for name in ("pins", "first", "second", "tests", "baselines"):
        (tmp_path / name).write_text(name)
    first, second, tests, baselines = (
        module.Step(name, name, (tmp_path / name,), lambda _, name=name: module.made.append(name))
        for name in ("first", "second", "tests", "baselines")
    )
    module.STAGES, module.TEST_STAGE, module.BENCH_STAGE = ((first,), (second,)), (tests,), (baselines,)
    return module


def made_again(bootstrap: ModuleType, *arguments: str) -> list[str]:
    bootstrap.made.clear()
    assert bootstrap.main(arguments) == 0
    return list(bootstrap.made)


def test_second_call_makes_nothing(bootstrap: ModuleType) -> None:
    assert made_again(bootstrap) == ["first", "second"]
    assert made_again(bootstrap) == []


@pytest.mark.parametrize(
    ("changed", "expected"),
    [("first", ["first"]), ("second", ["second"]), ("pins", ["first", "second"])],
)
def test_only_what_follows_from_a_change_is_made_again(
    bootstrap: ModuleType, changed: str, expected: list[str]
) -> None:
    made_again(bootstrap)
    (bootstrap.ROOT / changed).write_text("changed")
    assert made_again(bootstrap) == expected


def test_only_tests_and_benchmarks_pay_for_what_they_need(bootstrap: ModuleType) -> None:
    assert made_again(bootstrap) == ["first", "second"]
    assert made_again(bootstrap, "--test") == ["tests"]
    assert made_again(bootstrap, "--bench") == ["baselines"]
    assert made_again(bootstrap, "--bench") == []
    assert made_again(bootstrap) == []


def test_failed_step_is_made_again(bootstrap: ModuleType, capfd: pytest.CaptureFixture[str]) -> None:
    first, (second,) = bootstrap.STAGES

    def fail(log: Path) -> None:
        bootstrap.run(log, sys.executable, "-c", "raise SystemExit('out of paper')")

    bootstrap.STAGES = (first, (bootstrap.Step("second", "second", second.inputs, fail),))
    assert bootstrap.main() == 1
    error = capfd.readouterr().err
    assert "out of paper" in error
    assert str(bootstrap.LOGS / "second.log") in error

    bootstrap.STAGES = (first, (second,))
    assert made_again(bootstrap) == ["second"]


def test_steps_of_a_stage_are_made_at_the_same_time_and_what_is_made_stays(bootstrap: ModuleType) -> None:
    (first,), (second,) = bootstrap.STAGES
    met = threading.Barrier(2, timeout=60)

    def meet(_: Path) -> None:
        met.wait()

    def meet_and_fail(_: Path) -> None:
        met.wait()
        raise bootstrap.BootstrapError("error: no network")

    makes = meet_and_fail, meet
    bootstrap.STAGES = (
        tuple(replace(step, make=make) for step, make in zip((first, second), makes, strict=True)),
    )
    assert bootstrap.main() == 1
    bootstrap.STAGES = ((first, second),)
    assert made_again(bootstrap) == ["first"]


def test_paths_of_the_wheel_builder_are_replaced(
    bootstrap: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    exported = bootstrap.VENV / "share" / "std_msgs" / "Export.cmake"
    exported.parent.mkdir(parents=True)
    builder = "/opt/python/cp312-cp312"
    builder_numpy = f"{builder}/lib/python3.12/site-packages/numpy/_core/include"
    exported.write_text(f'DIRS "{builder}/include/python3.12;{builder_numpy};/kept"')
    monkeypatch.setattr(bootstrap, "VENV_PYTHON", sys.executable)
    bootstrap.point_wheels_at_this_python()
    python_include, numpy_include, kept = exported.read_text().split('"')[1].split(";")
    assert Path(python_include, "Python.h").is_file()
    assert Path(numpy_include, "numpy", "arrayobject.h").is_file()
    assert kept == "/kept"


def test_unsuitable_python_is_one_line() -> None:
    environment = os.environ | {"PYTHON": "false"}
    result = subprocess.run(
        ["sh", TOOLS / "bootstrap.sh"], env=environment, check=False, capture_output=True, text=True
    )
    assert result.returncode == 1
    assert (
        result.stderr
        == "error: quadpi needs Python 3.10 to 3.13; tried: false (choose one with PYTHON=...)\n"
    )
