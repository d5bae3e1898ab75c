# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew tables of the pages in results/, which are their own templates.

The text between `<!-- table: NAME -->` and `<!-- end -->` is replaced; all other text is written by hand and
kept.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Mapping
from pathlib import Path

from quadpi_core.paths import whole_output
from quadpi_core.version import __version__

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "experiments" / "results"
# The folders that the numbers depend on; a table names the last commit that changed them.
_SOURCES = ("quadpi_core", "config")


class TablesError(Exception):
    """The page cannot be renewed; the message is one line."""


def renew(page: Path, tables: Mapping[str, str]) -> None:
    """Write a page with other content of some tables, given by name; it appears whole or not at all.

    Raises:
        TablesError: if the page has not exactly one place for each of them.
    """
    text = page.read_text(encoding="utf-8")
    for name, content in tables.items():
        text = replaced(text, name, content)
    with whole_output(page) as temporary:
        temporary.write_text(text, encoding="utf-8")


def replaced(page: str, name: str, content: str) -> str:
    """The text of a page with other content of one table.

    Raises:
        TablesError: if the page has not exactly one place for it.
    """
    pattern = rf"(<!-- table: {re.escape(name)} -->\n).*?(<!-- end -->)"
    text, count = re.subn(pattern, lambda m: f"{m[1]}\n{content}\n\n{m[2]}", page, flags=re.DOTALL)
    if count != 1:
        raise TablesError(f"the page has {count} places `<!-- table: {name} -->`, expected one")
    return text


def stamp() -> str:
    """Version, and the commit that last changed what numbers depend on."""
    commit = _git("log", "-1", "--format=%h", "--", *_SOURCES)
    changed = " with changes since" if _git("status", "--porcelain", "--", *_SOURCES) else ""
    return f"quadpi {__version__}" + (f", commit {commit}{changed}" if commit else "")


def _git(*arguments: str) -> str:
    """What git prints; nothing outside a checkout."""
    ran = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return ran.stdout.strip()
