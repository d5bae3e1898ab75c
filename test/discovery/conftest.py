# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The package `blind` beside these tests, as `make discovery` imports it."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def _logged_as_before() -> Iterator[None]:
    """What a benchmark silences in its process is heard by the next test."""
    logger = logging.getLogger("quadpi_core")
    level = logger.level
    yield
    logger.setLevel(level)
