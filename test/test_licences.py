# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""LICENCES.md names the licence of every package that runs with quadpi, by its metadata; no GPL."""

from __future__ import annotations

import re
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "LICENCES.md"
# What runs; `test`, `bench` and `dev` do not, and the wheels of ROS 2 state nothing.
EXTRAS = ("mavlink", "logs", "reports", "rerun", "train", "cluster")
GPL = re.compile(r"(?<!L)GPL|(?<!Lesser )General Public|Affero", re.IGNORECASE)


def requirements(table: str) -> list[Requirement]:
    """Of a list in pyproject.toml; `dependencies`, or an extra."""
    text = (ROOT / "pyproject.toml").read_text()
    block = re.search(rf"^{table} = \[(.*?)\]$", text, flags=re.MULTILINE | re.DOTALL)
    assert block
    return [Requirement(found) for found in re.findall(r'"([^"]+)"', block[1])]


def installed(first: list[Requirement]) -> dict[str, Distribution]:
    """The packages that these need, directly or through others, by name; those that are here."""
    found: dict[str, Distribution] = {}
    todo = list(first)
    while todo:
        wanted = todo.pop()
        name = canonicalize_name(wanted.name)
        if name in found:
            continue
        try:
            found[name] = distribution(wanted.name)
        except PackageNotFoundError:
            continue
        for text in found[name].requires or ():
            needed = Requirement(text)
            extras = {"", *wanted.extras}
            if needed.marker is None or any(needed.marker.evaluate({"extra": extra}) for extra in extras):
                todo.append(needed)
    return found


def stated(package: Distribution) -> str:
    """The licence in the metadata: the expression, a short name, or the classifiers."""
    expression, text = package.metadata.get("License-Expression"), package.metadata.get("License") or ""
    if expression:
        return expression
    if text and len(text) < 30:
        return text
    classifiers = package.metadata.get_all("Classifier") or []
    return ", ".join(line.split(" :: ")[-1] for line in classifiers if line.startswith("License ::"))


def families(licence: str) -> set[str]:
    """What it is by kind: other versions of a package write the same licence in another way."""
    return set(re.findall(r"Apache|\bBSD|MIT|PSF|ISC|LGPL|MPL|Zlib|CC0|BSL|0BSD|any-OSI", licence))


def rows() -> dict[str, tuple[str, str]]:
    """Licence and what it is for, by package, as the page has them."""
    found = re.findall(r"^\| ([a-z0-9-]+) \| (.+?) \| (.+?) \|$", PAGE.read_text(), flags=re.MULTILINE)
    return {name: (licence, needed) for name, licence, needed in found}


@pytest.mark.parametrize("table", ["dependencies", *EXTRAS])
def test_every_licence_is_on_the_page(table):
    default = installed(requirements("dependencies"))
    packages = installed(requirements(table))
    wrong = []
    for name in sorted(packages if table == "dependencies" else packages.keys() - default.keys()):
        needed = "always" if table == "dependencies" else f"`{table}`"
        licence = stated(packages[name])
        assert not GPL.search(licence), name
        found, for_what = rows().get(name, ("", ""))
        if (
            not families(licence)
            or not families(licence) <= families(found)
            or needed not in for_what.split(", ")
        ):
            wrong.append(f"| {name} | {licence} | {needed} |")
    assert not wrong, "\n".join(["LICENCES.md needs these rows:", *wrong])


def test_nothing_is_under_the_gpl_and_nothing_that_is_always_there_under_the_lgpl():
    assert len(rows()) > 30
    for name, (licence, needed) in rows().items():
        assert not GPL.search(licence), name
        assert needed != "always" or "LGPL" not in licence, name


@pytest.mark.parametrize("licence", ["GPL-3.0-only", "GNU General Public License v3 (GPLv3)", "AGPL-3.0"])
def test_the_gpl_is_recognised(licence):
    assert GPL.search(licence)
    assert not GPL.search("GNU Lesser General Public License v3 (LGPLv3)")
