# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Of a flight with pauses one part is used, and of any flight the part that was asked for."""

from __future__ import annotations

import re
from dataclasses import astuple, replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.findings import NOTHING_TO_SAY
from quadpi_core.flight import OdometryStream, Recording
from quadpi_core.flight_files import FlightLeftOut
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import bag_files, read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.logs.importing import import_logs
from quadpi_core.reading_options import ReadingOptions, TimeRange, join_blocks, split_recording
from quadpi_core.screening.flight_runs import in_range, in_range_of_blocks, parts_without_pause
from quadpi_core.vehicle import Vehicle

BAG = Path(__file__).parents[3] / "bags" / "train_1.mcap"
SECOND = 10**9


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("bebop2")


@pytest.fixture(scope="module")
def flown(vehicle) -> Recording:
    return replace(in_range(read_recording(BAG, vehicle), TimeRange(to_s=20.0)), quality=NOTHING_TO_SAY)


def without(recording: Recording, topic: str, *intervals: tuple[float, float]) -> Recording:
    """A recording whose topic pauses."""
    stream = getattr(recording, topic)
    seconds = 1e-9 * (stream.time_ns - recording.imu.time_ns[0])
    kept = np.ones(len(stream), dtype=bool)
    for first, last in intervals:
        kept &= (seconds <= first) | (seconds >= last)
    return replace(recording, **{topic: stream.take(kept)}, arrivals={})


def seconds_of(part: Recording, whole: Recording) -> list[float]:
    return (1e-9 * (part.imu.time_ns[[0, -1]] - whole.imu.time_ns[0])).tolist()


def test_a_flight_without_a_pause_is_itself(flown):
    assert parts_without_pause(flown) == [flown]


def test_parts_are_what_imu_and_state_share(flown):
    zeros = np.zeros((len(flown.imu), 3))
    level = np.tile([1.0, 0.0, 0.0, 0.0], (len(flown.imu), 1))
    odometry = OdometryStream(flown.imu.time_ns, zeros, level, zeros, zeros)
    states = replace(flown, pose=None, odometry=odometry)
    paused = without(without(states, "imu", (5.0, 5.2)), "odometry", (12.0, 12.3), (19.0, 19.5))
    parts = parts_without_pause(paused)
    assert [seconds_of(part, flown) for part in parts] == [
        pytest.approx([first, last], abs=0.011)
        for first, last in ((5.2, 12.0), (12.3, 19.0), (0.0, 5.0), (19.5, 20.0))
    ]
    for part in parts:
        for stream in part.streams():
            assert part.imu.time_ns[0] <= stream.time_ns[0] <= stream.time_ns[-1] <= part.imu.time_ns[-1]
    words = [sentence.split(" from ")[0] for sentence in parts[0].quality.sentences()]
    assert words == [
        "topic imu: pauses",
        "topic odometry: pauses",
        "topic imu: used is the longest of 4 parts without a pause, 6.8 of 20.0 s:",
    ]
    assert parts[0].quality.breaks[1].times == 2


@pytest.mark.parametrize("topic", ["pose", "rotor_speeds"])
def test_a_pause_of_motion_capture_or_rotor_speeds_ends_no_part(flown, topic):
    assert len(parts_without_pause(without(flown, topic, (5.0, 6.0)))) == 1


def test_identification_uses_the_longest_part_or_all(flown, vehicle, tmp_path):
    paused = without(flown, "imu", (6.0, 6.2), (17.5, 18.0))
    write_bag(tmp_path / "a.mcap", paused)
    (longest,) = prepare_flights([tmp_path / "a.mcap"], vehicle)
    assert (longest.name, longest.quality.breaks[0].times) == ("a", 2)
    assert longest.time[-1] == pytest.approx(11.3 - 1.0, abs=1.0)
    parts = prepare_flights([tmp_path / "a.mcap"], vehicle, mapping=ReadingOptions(all_parts=True))
    assert [(part.name, part.file) for part in parts] == [("a_part1", "a"), ("a_part2", "a")]
    assert len({part.sha256 for part in parts}) == 2
    assert parts[1].sha256 == longest.sha256


def test_a_part_that_cannot_be_used_costs_itself_alone(flown, vehicle, tmp_path):
    """Without motion capture its estimator never starts."""
    path = tmp_path / "a.mcap"
    write_bag(path, without(without(flown, "imu", (6.0, 6.2), (12.0, 12.2)), "pose", (12.0, 21.0)))
    left_out: list[FlightLeftOut] = []
    every = ReadingOptions(all_parts=True)
    parts = prepare_flights([path], vehicle, mapping=every, left_out=left_out)
    assert [part.name for part in parts] == ["a_part1", "a_part2"]
    ((name, file, reason),) = map(astuple, left_out)
    assert (name, file) == ("a_part3", str(path))
    with pytest.raises(QuadpiError, match=re.escape(reason)):
        prepare_flights([path], vehicle, mapping=every)


@pytest.mark.parametrize("size", [500, 1 << 20])
def test_a_part_is_imported_and_read_alike(vehicle, tmp_path, monkeypatch, size):
    part = TimeRange(3.25, 9.0)
    write_bag(tmp_path / "whole.mcap", recording := read_recording(BAG, vehicle, ReadingOptions(part=part)))
    assert seconds_of(recording, read_recording(BAG, vehicle)) == pytest.approx([3.25, 9.0], abs=0.002)
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", size)
    (imported,) = import_logs([BAG], vehicle, tmp_path / "bags", ReadingOptions(part=part))
    again, expected = read_recording(imported.bag, vehicle), read_recording(tmp_path / "whole.mcap", vehicle)
    for stream, other in zip(again.streams(), expected.streams(), strict=True):
        for column, values in vars(other).items():
            np.testing.assert_array_equal(getattr(stream, column), values)
    assert imported.quality.used == recording.quality.used
    assert imported.quality.used[0].imu_samples == len(again.imu)


def test_a_topic_without_a_sample_in_the_part_is_none_of_its_bag(flown, vehicle, tmp_path):
    path, options = tmp_path / "a.mcap", ReadingOptions(part=TimeRange(6.0, 12.0))
    write_bag(path, without(flown, "pose", (5.0, 21.0)))
    (imported,) = import_logs([path], vehicle, tmp_path / "bags", options)
    topics = [stream.topic for stream in read_recording(path, vehicle, options).streams()]
    assert list(imported.topics) == topics == ["imu", "rotor_speeds"]


@pytest.mark.parametrize("command", ["read", "import", "blocks"])
def test_a_part_without_a_sample_is_refused(flown, vehicle, tmp_path, command):
    part = TimeRange(100.0, 101.0)
    write_bag(tmp_path / "a.mcap", flown)
    commands = {
        "read": lambda: in_range(flown, part),
        "import": lambda: import_logs(
            [tmp_path / "a.mcap"], vehicle, tmp_path / "bags", ReadingOptions(part=part)
        ),
        "blocks": lambda: list(in_range_of_blocks(split_recording(flown), "a.mcap", part)),
    }
    with pytest.raises(LogError, match=r"topic imu: has no sample from 100 s to 101 s: it ends at [\d.]+ s$"):
        commands[command]()


@pytest.mark.parametrize("stray_ns", [None, 7])
def test_a_part_of_blocks_is_that_of_the_whole(flown, stray_ns):
    """Which begins with the first sample that is used: a stray stamp before it counts for nothing."""
    part = TimeRange(3.25, 15.0)
    whole, read = in_range(flown, part), flown
    if stray_ns is not None:
        rows = np.concatenate(([0], np.arange(len(flown.imu))))
        imu = flown.imu.take(rows)
        stamps = imu.time_ns.copy()
        stamps[0] = stray_ns
        arrivals = {topic: came + 1 for topic, came in flown.arrivals.items()}
        read = replace(flown, imu=replace(imu, time_ns=stamps), arrivals=arrivals)
    found = join_blocks(in_range_of_blocks(split_recording(read), "a.mcap", part))
    np.testing.assert_array_equal(found.imu.time_ns, whole.imu.time_ns)
    arrived = whole.arrivals_of(whole.pose)
    np.testing.assert_array_equal(np.sort(found.arrivals["mocap/pose"]), np.sort(arrived))
