# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The how-to pages: their commands run, their links lead somewhere, their JSON keys are the real ones."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from quadpi_core.flight import AXES
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs.bags import write_bag
from quadpi_core.paths import bags_directory, config_directory

ROOT = Path(__file__).parents[2]
PAGES = [page for folder in ("docs", "experiments/results") for page in sorted((ROOT / folder).glob("*.md"))]
# By test_data_set_guide.py, test_log_format_guide.py and test_adapted_bags.py, which make their files; and by
# `make tables`.
RUN_ELSEWHERE = {
    "add-a-data-set.md",
    "add-a-kind-of-model.md",
    "add-a-log-format.md",
    "adapters.md",
    "paper-tables.md",
    "tools.md",
}
ON_REAL_FLIGHTS = {"commands.md", "import-logs.md", "report.md"}
# `quadpi view` serves until it is ended, which it is once it has said where.
QUADPI = """
quadpi() {
    if [ "$1" = view ]; then
        exec {said}< <(exec "$PYTHON" -m quadpi_core.cli "$@" --port 0 --no-open)
        grep --quiet "Page at http" <&$said && kill -INT $! && wait $!
        return
    fi
    "$PYTHON" -m quadpi_core.cli "$@"
}
"""


def commands(page: str) -> list[str]:
    """The commands `quadpi …` in the fenced and indented code of a page, continued lines included."""
    indented = re.findall(r"^ {4}(.*)$", page, flags=re.MULTILINE)
    code = "\n".join([*blocks(page, "sh"), *indented])
    return re.findall(r"^quadpi (?:[^\n]*\\\n)*[^\n]*", code, flags=re.MULTILINE)


# Commands of the documents other than `quadpi`, and where each is run; or, after a dash, why it is not.
RUN_BY = {
    r"make .*": "test/test_makefile.py",
    r"ros2 launch quadpi .*": "test/ros/test_launching.py",
    r"ros2 run quadpi (mavlink_bridge|player) .*": "test/ros/test_launching.py",
    r"ros2 lifecycle set /monitor .*": "test/ros/test_node_services.py - by the service that it calls",
    r"ros2 service call /monitor/load_model .*": "test/ros/test_live_process.py - by that service",
    r"ros2 run diagnostic_aggregator .*": "test/ros/test_live_process.py - the groups of its file",
    r"ros2 topic echo /prediction --field predicted.force": "test/test_layouts.py - that there is that field",
    r"ros2 (launch foxglove_bridge|run (rviz2|plotjuggler)) .*": "test/test_layouts.py - the files of others",
    r"(rosdep|colcon) .*": "test/test_packaging.py - what they install; neither has a wheel",
    r"python3 -m venv --system-site-packages .*": "test/test_packaging.py - on a ROS machine",
    r"pip install .*": "test/test_packaging.py - the names in it",
    r"\.venv/bin/quadpi view .*": "test/core/view/test_view_page.py",
    r"source .*": "test/test_packaging.py - on a ROS machine",
    r"(ros2 security|export ROS_SECURITY|ros2 run quadpi live --ros-args --enclave).*": (
        "- needs Fast DDS with its security plugins, which the wheels may lack"
    ),
}
PROGRAMS = re.compile(
    r"(?:make|ros2|rosdep|colcon|python3?|pip|source|export|sh|bash|cmake|cd|apt|\.venv/\S+) .*"
)


def test_every_command_is_run_somewhere():
    """A closed list: a new command needs a test that runs it, or a reason why none does."""
    documents = [ROOT / "README.md", ROOT / "bags" / "README.md", *PAGES]
    found = set()
    for page in documents:
        text = page.read_text()
        lines = re.findall(r"^ {4}(.*)$", text, flags=re.MULTILINE)
        lines += "\n".join(blocks(text, "sh")).splitlines()
        found |= {line.partition("  #")[0].strip() for line in lines if PROGRAMS.fullmatch(line)}
        found |= set(re.findall(r"`(make [^`]+)`", text))
    unknown = {line for line in found if not any(re.fullmatch(pattern, line) for pattern in RUN_BY)}
    assert not unknown
    for pattern, place in RUN_BY.items():
        assert any(re.fullmatch(pattern, line) for line in found), pattern
        where, _, reason = place.partition("- ")
        assert (ROOT / where.strip()).is_file() or reason, place


@pytest.mark.slow
def test_commands_of_the_readme_run(fly, request, tmp_path):
    """The first is that of the guide to data sets; the others run on flights of its vehicle."""
    first, *others = commands((ROOT / "README.md").read_text())
    assert first in commands((ROOT / "docs" / "add-a-data-set.md").read_text())
    shutil.copy(config_directory() / "vehicles" / "neurobem.yaml", tmp_path / "my-quad.yaml")
    for seed, name in enumerate("abc"):
        write_bag(tmp_path / "bags" / f"{name}.mcap", replace(fly(seed), vehicle="my-quad"))
    run_all([["bash", "-c", QUADPI + command] for command in others], tmp_path, request)
    assert (tmp_path / "replayed.mcap").is_file()


def test_commands_are_found():
    page = "```sh\nquadpi info a\n```\nquadpi is nice\n\n    quadpi a \\\n      b\n\nText quadpi info\n"
    assert commands(page) == ["quadpi info a", "quadpi a \\\n  b"]


def blocks(page: str, language: str) -> list[str]:
    """The fenced code of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)


def runs(page: Path) -> bool:
    """Whether a page shows what can be run here."""
    text = page.read_text()
    return page.name not in RUN_ELSEWHERE and bool(commands(text) or blocks(text, "python"))


@pytest.mark.slow
@pytest.mark.parametrize("page", list(filter(runs, PAGES)), ids=lambda p: p.name)
def test_commands_run(page, request, tmp_path):
    """In a folder with the bundled bags and the files that the page shows; then what it shows of Python."""
    text = page.read_text()
    if page.name in ON_REAL_FLIGHTS:
        for data in request.getfixturevalue("shared_data").iterdir():
            (tmp_path / data.name).symlink_to(data)
    elif "bags/" in text and "quadpi simulate" not in text:
        (tmp_path / "bags").mkdir()
        for bag in bags_directory().glob("*.mcap"):
            (tmp_path / "bags" / bag.name).symlink_to(bag)
    for content in blocks(text, "yaml"):
        if named := re.match(r"# (\S+\.yaml)\n", content):
            (tmp_path / named[1]).write_text(content)
    ran = [["bash", "-c", QUADPI + command] for command in commands(text)]
    ran += [[sys.executable, "-c", code] for code in blocks(text, "python")]
    run_all(ran, tmp_path, request)


# The command of `physical_folder`: the same flights give the same model, on each page.
IDENTIFIED = re.compile(r"quadpi identify bags/train_\*\.mcap --vehicle bebop2 -o (\S+)")


def run_all(ran: list[list[str]], folder: Path, request: pytest.FixtureRequest) -> None:
    """One after the other, each to success."""
    environment = os.environ | {"PYTHON": sys.executable, "PYTHONPATH": str(ROOT)}
    for command in ran:
        if known := IDENTIFIED.fullmatch(command[-1].removeprefix(QUADPI)):
            for bag in bags_directory().glob("train_*.mcap"):
                assert (folder / "bags" / bag.name).read_bytes() == bag.read_bytes()
            shutil.copytree(request.getfixturevalue("physical_folder"), folder / known[1])
            continue
        result = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        assert result.returncode == 0, f"{command[-1]}\n{result.stderr}"


@pytest.mark.parametrize(
    "page",
    [ROOT / "README.md", ROOT / "bags" / "README.md", ROOT / "experiments" / "README.md", *PAGES],
    ids=lambda p: f"{p.parent.name}-{p.name}",
)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text()):
        if "://" not in target:
            assert (page.parent / target).exists(), target


def test_every_page_is_linked_from_the_readme():
    linked = set(re.findall(r"\]\(([^)#]+\.md)", (ROOT / "README.md").read_text()))
    assert {str(page.relative_to(ROOT)) for page in PAGES} <= linked


def keys(data: Any) -> Iterator[str]:
    if isinstance(data, dict):
        yield from data
        for value in data.values():
            yield from keys(value)
    if isinstance(data, list):
        for value in data:
            yield from keys(value)


@pytest.mark.slow
def test_every_json_key_is_documented(quadpi, bags, predicting, tmp_path):
    model, data, scenario = tmp_path / "model", tmp_path / "data.json", tmp_path / "still.yaml"
    scenario.write_text("{description: still, vehicle: bebop2, seed: 1, flights: {still: {duration_s: 1}}}")
    page = "".join((ROOT / "docs" / name).read_text() for name in ("commands.md", "alarm.md"))
    named = set(re.findall(r"`([^`\n]+)`", page))
    documented = {key for path in named for key in re.split(r"[.…\[\]]+", path)}
    other = tmp_path / "other"
    simulated = [bags_directory() / f"{name}.mcap" for name in ("train_1", "train_2", "interpolation")]
    stems = (bag.stem for bag in (*bags, *simulated))
    names = {*AXES, *INPUT_NAMES, *stems, "all", model.name, other.name, "0.01", "0.1", "0.5"}
    fast = ("--axes", "Fx", "--method", "polynomial")
    runs = [
        ("identify", *bags, "--vehicle", "neurobem", *fast, "-o", model),
        ("info", bags[0]),
        ("info", model),
        ("info", predicting),
        ("evaluate", model, *bags),
        ("evaluate", predicting, *bags),
        ("identify", *bags, "--vehicle", "neurobem", *fast, "--settings", "paper", "-o", other),
        ("evaluate", model, other, *bags),
        ("replay", model, bags[0], "-o", tmp_path / "out.mcap"),
        ("replay", model, *bags, "-o", tmp_path / "replayed"),
        ("simulate", scenario, "-o", tmp_path / "simulated"),
        ("identify", *simulated[:2], "--vehicle", "bebop2", *fast, "-o", other),
        ("validate", other, simulated[2], "--realisations", "2"),
        ("rollout", predicting, bags[2]),
        ("discrepancy", "bebop2", *simulated, "-o", tmp_path / "found", "--effects", "body_drag"),
    ]
    for run in runs:
        assert quadpi(*run, "--json", data).status == 0
        assert set(keys(json.loads(data.read_text()))) - names <= documented, run
