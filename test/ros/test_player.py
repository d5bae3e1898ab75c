# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The program that plays a bag."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path


def test_player_names_a_bag_that_is_not_there(
    run_main: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    status, errors = run_main("player", str(tmp_path / "none.mcap"))
    assert status == 2
    assert errors == f"quadpi: {tmp_path / 'none.mcap'}: no such bag\n"
