# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables of pages are replaced between their marks."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

PAGE = "By hand.\n\n<!-- table: one -->\n<!-- end -->\n\nAlso.\n\n<!-- table: two -->\nold\n<!-- end -->\n"


def test_only_what_is_between_the_marks_is_replaced(tool: ModuleType, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    tool.renew(page, {"two": "\\1 %", "one": "new"})
    new = PAGE.replace("one -->\n", "one -->\n\nnew\n\n").replace("\nold\n", "\n\n\\1 %\n\n")
    assert page.read_text() == new


def test_a_page_without_exactly_one_place_is_refused_and_kept(tool: ModuleType, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE + PAGE)
    with pytest.raises(tool.TablesError, match="has 2 places"):
        tool.renew(page, {"one": ""})
    with pytest.raises(tool.TablesError, match="has 0 places"):
        tool.renew(page, {"three": ""})
    assert page.read_text() == PAGE + PAGE
