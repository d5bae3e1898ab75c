# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small recordings after public bug reports give the right values that their README says."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def report(shared_data: Path) -> Callable[[str], Path]:
    """report(name) → the folder of that case; the test skips where it is absent."""

    def folder(name: str) -> Path:
        path = shared_data / "reports" / name
        if not path.is_dir():
            pytest.skip(f"no case {path}")
        return path

    return folder
