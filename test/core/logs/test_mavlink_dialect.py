# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The messages that pymavlink lacks, against the XML of their documentation."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from quadpi_core.errors import LogError
from quadpi_core.logs.mavlink_frames import Framer, load_dialect

ROOT = Path(__file__).parents[3]


def test_without_pymavlink_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pymavlink.dialects.v20.ardupilotmega", None)
    with pytest.raises(LogError, match=r"needs pymavlink, which the extra `mavlink` brings: pip install"):
        load_dialect()


def generated(tmp_path: Path) -> ModuleType:
    """The module that pymavlink generates of the XML in the documentation."""
    import importlib.util

    from pymavlink.generator import mavgen, mavparse

    shutil.copy(ROOT / "docs" / "esc_messages.xml", tmp_path / "esc.xml")
    options = mavgen.Opts(str(tmp_path / "esc"), wire_protocol=mavparse.PROTOCOL_2_0, language="Python3")
    mavgen.mavgen(options, [str(tmp_path / "esc.xml")])
    spec = importlib.util.spec_from_file_location("esc", tmp_path / "esc.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("ESC_INFO", (4, 10**15, 7, 8, 3, 9, [1, 2, 3, 4], [10, 20, 30, 40], [-1, 2, -3, 4])),
        ("ESC_STATUS", (0, 123_456, [1, -2, 3, 2**31 - 1], [1.5, 2.5, 3.5, 4.5], [0.0, 0.5, 1.0, 1.5])),
    ],
)
def test_own_messages_are_those_of_the_documented_xml(
    mavlink_sender: Any, name: str, values: tuple[object, ...], tmp_path: Path
) -> None:
    module = generated(tmp_path)
    theirs = module.MAVLink(None, 1, 1)
    packet = bytes(getattr(module, f"MAVLink_{name.lower()}_message")(*values).pack(theirs))
    assert mavlink_sender().packet(name, *values) == packet
    (message,) = Framer().feed(packet)
    names = load_dialect().mavlink_map[message.get_msgId()].fieldnames
    assert [getattr(message, field) for field in names] == list(values)
    extra = {"ESC_INFO": 251, "ESC_STATUS": 10}
    assert getattr(module, f"MAVLink_{name.lower()}_message").crc_extra == extra[name]
