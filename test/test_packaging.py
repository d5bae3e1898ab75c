# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What pip and colcon install is what the checkout holds."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import pytest

import quadpi_core

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("quadpi_core", "quadpi_ros")
SHARED = ("bags", "config", "msg")
BUILD_FILES = ("pyproject.toml", "package.xml", "README.md", "LICENSE")


@pytest.mark.slow
def test_wheel_holds_every_module_and_every_shared_file(tmp_path: Path) -> None:
    source = tmp_path / "source"
    for folder in PACKAGES + SHARED:
        shutil.copytree(ROOT / folder, source / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for name in BUILD_FILES:
        shutil.copy(ROOT / name, source)
    pip_wheel = (sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation")
    subprocess.run([*pip_wheel, "--wheel-dir", str(tmp_path), str(source)], check=True)
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        installed = {name.split(".data/data/share/quadpi/")[-1] for name in archive.namelist()}
    expected = (path for folder in PACKAGES + SHARED for path in (ROOT / folder).rglob("*.*"))
    assert {str(path.relative_to(ROOT)) for path in expected if "__pycache__" not in path.parts} <= installed


def test_versions_agree() -> None:
    assert ElementTree.parse(ROOT / "package.xml").findtext("version") == quadpi_core.__version__
    declared = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert declared is not None
    assert declared[1] == quadpi_core.__version__


@pytest.mark.parametrize(
    ("listing", "path"),
    [
        (r"foreach\(NODE (.+)\)", "quadpi_ros/{}.py"),
        (r"install\(DIRECTORY (.+) DESTINATION", "{}"),
    ],
)
def test_cmake_installs_what_exists(listing: str, path: str) -> None:
    names = re.search(listing, (ROOT / "CMakeLists.txt").read_text())
    assert names is not None
    for name in names[1].split():
        assert (ROOT / path.format(name)).exists(), name
