# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The examples of the library run from their first line to their last."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "prints"),
    [
        ("identify_and_judge", "<CoverageTable by speed: 1 flights"),
        ("missing_effect", "<Discrepancy without_side_force and 2 flights: "),
        ("own_regressor", "polynomial"),
    ],
)
def test_it_runs(name, prints, tmp_path):
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / f"{name}.py")],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert prints in done.stdout
