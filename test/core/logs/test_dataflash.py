# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of a DataFlash log: every kind of value, damage, and pymavlink's reading of a real log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytest.importorskip("pyulog", reason="pyulog is not installed")


def test_dataflash_agrees_with_pymavlink(shared_data: Path) -> None:
    from pymavlink import DFReader

    from quadpi_core.logs.dataflash import decode_dataflash

    path = shared_data / "logs" / "ardupilot_copter_2014.BIN"
    messages = decode_dataflash(str(path), path.read_bytes()).messages
    reader = DFReader.DFReader_binary(str(path))
    theirs: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        theirs.setdefault(message.get_type(), []).append(message)
    assert {name: len(found) for name, found in messages.items()} == {k: len(v) for k, v in theirs.items()}
    for name in ("IMU", "ATT", "EKF1", "RCOU", "BARO"):
        for column in messages[name].factors:
            mine = messages[name].column(column)
            assert mine == pytest.approx([getattr(one, column) for one in theirs[name]]), (name, column)
