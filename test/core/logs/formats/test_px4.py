# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import sys
from pathlib import Path

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytest.importorskip("pyulog", reason="pyulog is not installed")
from quadpi_core.errors import LogError
from quadpi_core.logs import read_recording
from quadpi_core.vehicle import Vehicle


def test_a_parameter_that_is_no_number_is_as_none(
    written: dict[str, Path], vehicle: Vehicle, caplog: pytest.LogCaptureFixture
) -> None:
    """Damage in the type of a parameter leaves bytes."""
    data = written[".ulg"].read_bytes()
    assert data.count(b"float CA_ROTOR0_PX") == 1
    written[".ulg"].write_bytes(data.replace(b"float CA_ROTOR0_PX", b"fl\xffat CA_ROTOR0_PX"))
    recording = read_recording(written[".ulg"], vehicle)
    assert recording.rotor_speeds is not None
    assert "its motors are taken as quad X" in caplog.text


def test_the_library_that_a_format_needs_is_named(
    written: dict[str, Path], vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyulog", None)
    with pytest.raises(LogError, match=r"needs pyulog.*pip install quadpi-monitor\[logs\]"):
        read_recording(written[".ulg"], vehicle)
