# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Recordings in blocks give what the whole gives, and take no more memory than that."""

from __future__ import annotations

import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest

from benchmarks.swings import swings, write_long_bag
from quadpi_core import reading_options
from quadpi_core.flight import Recording, TwistStream, WindStream
from quadpi_core.logs import bag_files, read_recording
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import open_recording, output_topic, read_bag, write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.payloads import Payloads
from quadpi_core.reading_options import by_arrival, join_blocks, split_recording
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module")
def recording() -> Recording:
    """A second of flight; velocities in body axes and in the world by turns."""
    flown = swings(Vehicle.load("neurobem"), 1.0)
    pose = flown.pose
    in_body = np.arange(len(pose)) % 3 == 0
    return replace(flown, twist=TwistStream(pose.time_ns + 300_000, pose.position, in_body))


def assert_same(one: Recording, other: Recording) -> None:
    assert one.arrivals.keys() == other.arrivals.keys()
    for topic, counts in one.arrivals.items():
        np.testing.assert_array_equal(counts, other.arrivals[topic])
    for mine, its in zip(one.streams(), other.streams(), strict=True):
        for column in fields(mine):
            np.testing.assert_array_equal(getattr(mine, column.name), getattr(its, column.name))


@pytest.mark.parametrize("count", [1, 7, 100, 10**6])
def test_blocks_of_a_bag_joined_are_the_bag(recording, tmp_path, monkeypatch, count):
    write_bag(tmp_path / "bag.mcap", recording)
    whole = read_bag(tmp_path / "bag.mcap")
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", count)
    with open_recording(tmp_path / "bag.mcap") as bag:
        assert bag.streams == {"imu", "rotor_speeds", "pose"}  # of motion capture the first topic counts
        assert_same(join_blocks(bag.blocks()), whole)
        for block in by_arrival(bag.blocks()):
            for stream in block.streams()[1:]:
                arrived = block.arrivals_of(stream)
                assert len(arrived) == len(stream)
                assert np.all(arrived < max(len(block.imu), 1))
        assert_same(join_blocks(by_arrival(bag.blocks())), whole)


@pytest.mark.parametrize("count", [1, 7, 100, 10**6])
def test_blocks_of_a_recording_joined_are_the_recording(recording, monkeypatch, count):
    monkeypatch.setattr(reading_options, "BLOCK_SAMPLES", count)
    arrivals = {stream.topic: recording.arrivals_of(stream) for stream in recording.streams()[1:]}
    assert_same(join_blocks(split_recording(recording)), replace(recording, arrivals=arrivals))


@pytest.mark.parametrize("count", [1, 7, 100])
def test_a_bag_has_the_same_bytes_in_parts_of_any_length(recording, tmp_path, monkeypatch, count):
    wind = WindStream(recording.imu.time_ns[[3, 90]], np.ones((2, 3)))
    extra = [output_topic("wind", wind.time_ns, sensor_messages.pack_wind(wind))]
    write_bag(tmp_path / "whole.mcap", recording, extra)
    monkeypatch.setattr(reading_options, "BLOCK_SAMPLES", count)
    write_bag(tmp_path / "parts.mcap", recording, extra)
    assert (tmp_path / "parts.mcap").read_bytes() == (tmp_path / "whole.mcap").read_bytes()


def test_a_message_that_is_none_is_named_by_its_place_in_the_topic(recording, tmp_path, monkeypatch):
    packed = sensor_messages.pack_pose(recording.pose)
    rows = packed.rows(np.arange(len(packed)), int(packed.lengths[0])).copy()
    rows[77, -8:] = np.array([3.0]).view(np.uint8)
    topics = [
        output_topic("imu", recording.imu.time_ns, sensor_messages.pack_imu(recording.imu)),
        output_topic("mocap/pose", recording.pose.time_ns, Payloads.from_rows(rows)),
    ]
    write_mcap(tmp_path / "bag.mcap", topics, {})
    for count in (10, 10**6):
        monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", count)
        (left_out,) = read_recording(tmp_path / "bag.mcap", None).quality.left_out
        assert (left_out.topic, left_out.first, left_out.samples) == ("mocap/pose", 77, 1)


def test_reading_and_writing_take_little_beside_what_is_read(tmp_path):
    write_long_bag(tmp_path / "bag.mcap", Vehicle.load("neurobem"), 60.0)
    tracemalloc.start()
    recording = read_bag(tmp_path / "bag.mcap")
    held, read = tracemalloc.get_traced_memory()
    write_bag(tmp_path / "again.mcap", recording)
    written = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Its messages are five times as large, and would be held three times.
    assert read < held + 16e6
    assert written < held + 16e6
    assert (tmp_path / "again.mcap").stat().st_size > 4e6
