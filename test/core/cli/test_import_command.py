# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi import`: every stream is in the bag, motion capture moved where that is asked for."""

from __future__ import annotations

from dataclasses import replace

from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag


def test_import_keeps_every_stream(quadpi, bags, tmp_path):
    assert quadpi("import", *bags, "--vehicle", "neurobem", "-o", tmp_path / "again").status == 0
    for bag in bags:
        assert (tmp_path / "again" / bag.name).read_bytes()[:8] == b"\x89MCAP0\r\n"
        original, again = read_recording(bag, None), read_recording(tmp_path / "again" / bag.name, None)
        assert [len(stream) for stream in again.streams()] == [len(stream) for stream in original.streams()]


def test_import_aligns_motion_capture_with_the_gyro(quadpi, fly, tmp_path):
    recording = fly(0)
    late = replace(recording.pose, time_ns=recording.pose.time_ns + 40_000_000)
    write_bag(tmp_path / "late.mcap", replace(recording, pose=late))
    run = quadpi(
        "import", tmp_path / "late.mcap", "--vehicle", "neurobem", "--align", "-o", tmp_path / "bags"
    )
    assert run.status == 0
    moved = read_recording(tmp_path / "bags" / "late.mcap", None).pose
    assert abs(int(moved.time_ns[0] - recording.pose.time_ns[0])) < 2_000_000
