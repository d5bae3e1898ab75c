# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which format a path is, and that every failure to read it names it."""

from __future__ import annotations

from pathlib import Path

import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs import identify_format, read_recording


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.mat", None, "no such file or folder"),
        ("empty.mat", b"", "the file is empty"),
        ("flight.ulg.gz", b"\x1f\x8b\x08\x00", "is compressed; `gunzip flight.ulg.gz` unpacks it"),
        ("flight.mcap.zst", b"\x28\xb5\x2f\xfd", "is compressed; `unzstd flight.mcap.zst` unpacks it"),
        ("LOG.lz4", b"\x04\x22\x4d\x18", "is compressed; `unlz4 LOG.lz4` unpacks it"),
        ("LOG.zip", b"PK\x03\x04\x00", "is compressed; `unzip LOG.zip` unpacks it"),
        (
            "flight.xyz",
            b"some bytes",
            "not a known log format; known: ArduPilot .*, Crazyflie .*, bag ",
        ),
    ],
)
def test_unusable_paths_are_named(tmp_path: Path, name: str, content: bytes | None, message: str):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogError, match=f"{name}: {message}"):
        read_recording(path, None)


def test_formats_are_told_apart(tmp_path: Path):
    for name, content, description in (
        ("a.mcap", b"\x89MCAP", "bag"),
        ("b.mat", b"MATLAB", "NeuroBEM"),
        ("c.CSV", b"t,x", "table"),
        ("log17", b"\xbc\x02\x00", "Crazyflie"),
    ):
        (tmp_path / name).write_bytes(content)
        assert identify_format(tmp_path / name).description.startswith(description)
    assert identify_format(tmp_path).description.startswith("bag")
