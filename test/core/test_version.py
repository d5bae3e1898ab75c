# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The version of the package is that of every file that declares one."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import yaml

import quadpi_core

ROOT = Path(__file__).resolve().parents[2]


def test_versions_agree() -> None:
    assert ElementTree.parse(ROOT / "package.xml").findtext("version") == quadpi_core.__version__
    declared = re.search(r'^version = "(.+)"$', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert declared is not None
    assert declared[1] == quadpi_core.__version__
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == quadpi_core.__version__
    assert citation["license"] == "Apache-2.0"


def test_bloom_knows_every_release() -> None:
    released = re.findall(r"^## (\d.*)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)
    for_bloom = re.findall(
        r"^(\d\S*) \(\d{4}-\d\d-\d\d\)\n-+$", (ROOT / "CHANGELOG.rst").read_text(), re.MULTILINE
    )
    assert for_bloom == [version.split()[0] for version in released]
