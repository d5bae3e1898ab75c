# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The programs of experiments/, imported as they import each other: by their names, from that folder."""

from __future__ import annotations

import importlib
import logging
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from quadpi_core.paths import data_directory

sys.path.insert(0, str(Path(__file__).parents[1]))


@pytest.fixture
def tool(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program that a test file is named after, imported anew: paper_tables for test_paper_tables.py."""
    name = request.path.stem.removeprefix("test_")
    monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module(name)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real flights; the test skips where it is absent."""
    directory = data_directory()
    if not directory.is_dir():
        pytest.skip(f"real flights not found at {directory} (set QUADPI_DATA)")
    return directory


@pytest.fixture(autouse=True)
def _logged_as_before() -> Iterator[None]:
    """What a benchmark silences in its process is heard by the next test."""
    logger = logging.getLogger("quadpi_core")
    level = logger.level
    yield
    logger.setLevel(level)
