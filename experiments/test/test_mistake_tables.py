# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tables of results/mistakes.md: shares by set, places on the page, and mistakes that docs/ knows."""

from __future__ import annotations

from collections import Counter

from mistake_tables import MOTION, PAGE, ROTORS, tables
from page_tables import ROOT, replaced

COUNTS = {"one": Counter({("arms × 2", True): 2, ("arms × 2", False): 1, ("vehicle hdbeetle", True): 4})}


def test_a_cell_is_how_often_of_how_many_times_a_mistake_is_named():
    found = tables(COUNTS)
    assert "| arms × 2 | 2 / 3 |" in found["named"]
    assert "| mass × 1.2 | – |" in found["named"]
    assert "| `hdbeetle` | 4 / 4 |" in found["vehicles"]


def test_the_page_has_a_place_for_each_table():
    page = PAGE.read_text(encoding="utf-8")
    for name, content in tables(COUNTS).items():
        assert content in replaced(page, name, content)


def test_the_page_for_users_lists_each_name():
    page = (ROOT / "docs" / "mistakes.md").read_text(encoding="utf-8")
    for named, _ in (*MOTION.values(), *ROTORS.values()):
        assert f"`{named}`" in page
