# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Every target of the Makefile is run: here in a short form, by CI, or by a test of what it calls."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MAKEFILE = (ROOT / "Makefile").read_text()
TARGETS = re.findall(r"^([a-z-]+):.*## ", MAKEFILE, flags=re.MULTILINE)

# Of those that write pages or run for long: that their program is there, starts, and takes the options.
SHORT = {
    "alarm": ("ALARM_ARGS=--help", "--no-ensembles"),
    "discovery": ("DISCOVERY_ARGS=--help", "--short"),
    "discovery-independent": ("DISCOVERY_ARGS=--help", "--reserved"),
    "discovery-hidden": ("DISCOVERY_ARGS=--help", "--half"),
    "discovery-real": ("DISCOVERY_ARGS=--help", "--only"),
    "fuzz": ("FUZZ_ARGS=--help", "--minutes"),
    "golden": ("GOLDEN_ARGS=--help", "--model"),
    "intervals": ("INTERVALS_ARGS=--help", "--methods"),
    "models": ("MODELS_ARGS=--help", "--methods"),
    "nanodrone": ("NANODRONE_TEST=--help", "--without"),
    "rollouts": ("ROLLOUTS_ARGS=--help", "--only"),
    "tables": ("TABLES_ARGS=--help", "--only"),
}
# What they do, in a short form of its own; all but discovery-real, which takes minutes on real flights.
SHORT_FORMS = {
    "alarm": "experiments/test/test_alarm_tables.py",
    "bench": "test/test_benchmarks.py",
    "demo": "test/ros/test_demo.py",
    "dist": "test/test_packaging.py",
    "discovery": "experiments/test/test_blind.py",
    "discovery-independent": "experiments/test/test_independent.py",
    "discovery-hidden": "experiments/test/test_hidden.py",
    "fuzz": "test/faults/test_fuzzing.py",
    "golden": "test/golden/test_golden_trace.py",
    "intervals": "experiments/test/test_intervals_raced.py",
    "models": "experiments/test/test_model_methods.py",
    "nanodrone": "experiments/test/test_nanodrone.py",
    "pictures": "test/core/view/test_view_page.py",
    "rollouts": "experiments/test/test_rollout_tables.py",
    "tables": "experiments/test/test_paper_tables.py",
}
HERE = {*SHORT, "bench", "clean", "demo", "dist", "help", "pictures"}


def make(*arguments: str, folder: Path = ROOT) -> str:
    """Run make without a word about the environment, which these tests run in; gives what it prints."""
    command = [
        "make",
        "--no-print-directory",
        "--assume-old=environment",
        "--assume-old=development",
        *arguments,
    ]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with the Makefile and the programs of this checkout, whose bootstrap does nothing."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in ("benchmarks", "experiments", "quadpi_core", "quadpi_ros", "test"):
        (tmp_path / name).symlink_to(ROOT / name)
    shutil.copytree(ROOT / "tools", tmp_path / "tools", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "tools" / "bootstrap.sh").write_text("exit 0\n")
    python = ROOT / ".venv"
    if not python.is_dir():
        pytest.skip(f"{python}: make runs what `make environment` installs there")
    (tmp_path / ".venv").symlink_to(python)
    return tmp_path


def test_every_target_is_run_somewhere() -> None:
    by_ci = set(re.findall(r"^make ([a-z-]+)", (ROOT / ".ci" / "run").read_text(), flags=re.MULTILINE))
    # Both are run before the others.
    assert set(TARGETS) == HERE | by_ci | {"environment", "development"}
    assert SHORT_FORMS.keys() == {*SHORT, "bench", "demo", "dist", "pictures"} - {"discovery-real"}
    assert all((ROOT / place).is_file() for place in SHORT_FORMS.values())
    (phony,) = re.findall(r"^\.PHONY: (.*)$", MAKEFILE, flags=re.MULTILINE)
    assert set(phony.split()) == set(TARGETS)


def test_documents_name_targets_that_exist() -> None:
    patterns = ("README.md", "bags/README.md", "docs/*.md", "experiments/**/*.md")
    pages = [page for pattern in patterns for page in ROOT.glob(pattern)]
    named = {name for page in pages for name in re.findall(r"(?:`| {4})make ([a-z-]+)", page.read_text())}
    assert named
    assert named <= set(TARGETS)


def test_help_lists_every_target() -> None:
    assert re.findall(r"^make ([a-z-]+) ", make("help"), flags=re.MULTILINE) == TARGETS
    assert make() == make("help")


@pytest.mark.slow
@pytest.mark.parametrize("target", SHORT)
def test_short_forms(target: str, checkout: Path) -> None:
    arguments, option = SHORT[target]
    assert option in make(target, arguments, folder=checkout)


@pytest.mark.parametrize(("target", "marker"), [("test", "not slow"), ("test-slow", "slow")])
def test_the_two_suites_are_all_tests(target: str, marker: str) -> None:
    """Those of live nodes included; TEST_ARGS chooses among the tests of the marker."""
    everything = re.findall(r"pytest ([^;>]*)", make("--dry-run", target))
    assert all(arguments.startswith(f'-m "{marker}" --numprocesses') for arguments in everything)
    assert [arguments.split()[-2:] for arguments in everything] == [
        ["loadfile", "test/ros"],
        ["--ignore", "test/ros"],
    ]
    (some,) = re.findall(r"pytest (.*)", make("--dry-run", target, "TEST_ARGS=-k intervals -x"))
    assert some == f'-m "{marker}" -k intervals -x'


@pytest.mark.parametrize("fails", ["", "loadfile test/ros", "--ignore test/ros"])
def test_a_suite_fails_with_either_of_its_halves_and_shows_both(fails: str, tmp_path: Path) -> None:
    shutil.copy(ROOT / "Makefile", tmp_path)
    (tmp_path / "tools").mkdir()
    (tmp_path / "tools" / "bootstrap.sh").write_text("")
    python = tmp_path / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    python.write_text(f'#!/bin/sh\necho "ran $*"\ncase "$*" in *"{fails or "nothing"}") exit 1; esac\n')
    python.chmod(0o755)
    ran = subprocess.run(["make", "test"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.stdout.count("ran -m pytest") == 2
    assert (ran.returncode != 0) == bool(fails)


def test_bench_takes_a_name(checkout: Path) -> None:
    command = ["make", "bench", "ONLY=nothing"]
    result = subprocess.run(command, cwd=checkout, capture_output=True, text=True, check=False)
    assert result.returncode == 2
    assert "no benchmark 'nothing'; known: " in result.stderr


def test_demo_is_the_command(checkout: Path) -> None:
    assert "--rate" in make("demo", "DEMO_ARGS=--help", folder=checkout)


def test_clean_leaves_the_sources(tmp_path: Path) -> None:
    for name in (".venv", "build", "out", "docs"):
        (tmp_path / name).mkdir()
    shutil.copy(ROOT / "Makefile", tmp_path)
    make("clean", folder=tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["Makefile", "docs"]
