# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that every test may use."""

from __future__ import annotations

from pathlib import Path

import pytest

from quadpi_core.paths import data_directory


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real flights; the test skips where it is absent."""
    directory = data_directory()
    if not directory.is_dir():
        pytest.skip(f"real flights not found at {directory} (set QUADPI_DATA)")
    return directory
