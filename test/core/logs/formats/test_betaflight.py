# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytest.importorskip("pyulog", reason="pyulog is not installed")
from quadpi_core.errors import QuadpiError
from quadpi_core.logs import read_recording
from quadpi_core.vehicle import Vehicle


def test_electrical_speeds_need_pole_pairs(written: dict[str, Path]) -> None:
    unknown = replace(Vehicle.load("neurobem"), pole_pairs=None)
    with pytest.raises(QuadpiError, match="pole_pairs"):
        read_recording(written[".bbl"], unknown)


def test_other_pole_pairs_than_the_log_says_are_noted(
    written: dict[str, Path], vehicle: Vehicle, caplog: pytest.LogCaptureFixture
) -> None:
    read_recording(written[".bbl"], replace(vehicle, pole_pairs=6))
    assert "motor_poles is 14, the vehicle file says 12" in caplog.text
