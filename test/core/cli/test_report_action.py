# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What action.yml and Containerfile run: the step of a workflow, and the entry point of a container."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from .test_report_command import raw

ROOT = Path(__file__).parents[3]
INPUTS = {
    "QUADPI_LOGS": "logs",
    "QUADPI_MASS": "mass",
    "QUADPI_FAIL_ON": "fail-on",
    "QUADPI_OUTPUT": "output",
}


@pytest.fixture
def step(tmp_path):
    """step(**inputs) → what the last step of the action did, with the inputs as a workflow gives them."""
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    last = action["runs"]["steps"][-1]
    assert {name: f"${{{{ inputs.{one} }}}}" for name, one in INPUTS.items()} == last["env"]

    def run(**given: str) -> subprocess.CompletedProcess[str]:
        inputs = {name: one.get("default", "") for name, one in action["inputs"].items()} | given
        variables = {name: inputs[one] for name, one in INPUTS.items()}
        variables |= {"GITHUB_ACTION_PATH": str(ROOT), "GITHUB_STEP_SUMMARY": str(tmp_path / "summary.md")}
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        return subprocess.run(
            [last["shell"], "-e", "-c", last["run"]],
            check=False,
            cwd=tmp_path,
            env=os.environ | variables | {"PATH": path},
            capture_output=True,
            text=True,
        )

    return run


def test_the_action_reports_on_all_logs_of_a_pattern(step, tmp_path):
    raw(tmp_path / "log00")
    (tmp_path / "log01").write_bytes((tmp_path / "log00").read_bytes())
    done = step(logs="log0*", mass="0.5")
    assert done.returncode == 3, done.stderr
    assert "left out log01" in done.stderr
    report = json.loads((tmp_path / "quadpi-report" / "report.json").read_text())
    assert report["mass_kg"] == 0.5
    assert (tmp_path / "summary.md").read_text() == f"{report['verdict']}\n"


@pytest.mark.slow
def test_the_action_fails_on_an_alarm_unless_it_is_told_not_to(step, tmp_path):
    raw(tmp_path / "log00", harder=2.0)
    assert step(logs="log00").returncode == 1
    assert step(logs="log00", **{"fail-on": ""}, output="own").returncode == 0
    assert (tmp_path / "own" / "report.html").is_file()
    assert step(logs="no-such-log").returncode == 2


def test_the_container_runs_quadpi_and_has_what_it_copies(tmp_path):
    content = (ROOT / "Containerfile").read_text()
    entry, command = (
        json.loads(re.search(rf"^{word} (.*)$", content, re.M)[1]) for word in ("ENTRYPOINT", "CMD")
    )
    program = Path(sys.executable).with_name(entry[0])
    shown = subprocess.run([program, *entry[1:], *command], capture_output=True, text=True, check=True)
    assert "report" in shown.stdout
    done = subprocess.run(
        [program, *entry[1:], "report", raw(tmp_path / "log00"), "-o", tmp_path / "out"], check=False
    )
    assert done.returncode == 0
    (extras,) = re.findall(r"whl\)\[([a-z,]+)\]", content)
    known = re.findall(r"^([a-z]+) = \[", (ROOT / "pyproject.toml").read_text(), re.M)
    assert set(extras.split(",")) <= set(known)
