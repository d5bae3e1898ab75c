# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights in blocks are screened, imported and described like whole ones, in the memory of short ones."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.swings import write_long_bag
from quadpi_core.errors import LogError
from quadpi_core.flight import VALUE_MAX, ImuStream, Recording
from quadpi_core.logs import bag_files, decode_recording, read_recording
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import open_recording, recording_topics, write_bag
from quadpi_core.logs.importing import import_logs
from quadpi_core.logs.inspect import inspect_blocks, inspect_recording
from quadpi_core.reading_options import streams_by_field
from quadpi_core.screening import flight_runs, wild_samples
from quadpi_core.screening.consistency import checked
from quadpi_core.screening.excerpt import excerpt, rotor_excerpt
from quadpi_core.screening.flight_runs import Excerpting
from quadpi_core.screening.wild_samples import Screening, beyond_limits
from quadpi_core.signals import alignment
from quadpi_core.vehicle import Vehicle

BAG = Path(__file__).parents[3] / "bags" / "train_1.mcap"
RATE_HZ = 500.0
DELAY_NS = 300_000_000


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("bebop2")


@pytest.fixture(scope="module")
def flown(vehicle: Vehicle) -> Recording:
    """Part of a flight, with wild samples in two topics and a pose that begins late and ends early."""
    recording = decode_recording(BAG, vehicle)
    imu, rotors = recording.imu.take(slice(0, 6000)), recording.rotor_speeds
    end_ns = imu.time_ns[-1]
    gyro, speeds = imu.angular_velocity.copy(), rotors.speeds.copy()
    gyro[5000:5003] = np.nan
    gyro[[1, 2000, 2001, 4500], 0] = 1e4
    gyro[[7, 3000], 1] += 30.0
    speeds[900, 2] = 1e5
    pose = recording.pose
    seen = (pose.time_ns > imu.time_ns[1500]) & (pose.time_ns < imu.time_ns[4500])
    return replace(
        recording,
        imu=replace(imu, angular_velocity=gyro),
        rotor_speeds=replace(rotors, speeds=speeds).take(rotors.time_ns <= end_ns),
        pose=pose.take(seen),
        arrivals={},
    )


@pytest.fixture
def late(flown, tmp_path) -> Path:
    """A bag of it in which poses were logged late, so that blocks are not cut by the stamps.

    Some samples repeat a stamp, others are stored later than they belong.
    """
    imu, pose = flown.imu, flown.pose
    stored = np.r_[0:990, 1010:1030, 990:1010, 1030 : len(imu)]
    twice = np.sort(np.r_[np.arange(len(pose)), 50, 51, 150])
    disordered = replace(flown, imu=imu.take(stored), pose=pose.take(twice))
    topics = [
        replace(topic, log_time_ns=np.sort(topic.log_time_ns) + DELAY_NS * (topic.name == "/mocap/pose"))
        for topic in recording_topics(disordered)
    ]
    write_mcap(tmp_path / "late.mcap", topics, {"vehicle": flown.vehicle})
    return tmp_path / "late.mcap"


@pytest.fixture
def long_bag(tmp_path) -> Path:
    write_long_bag(tmp_path / "long.mcap", Vehicle.load("neurobem"), 150.0)
    return tmp_path / "long.mcap"


def few_samples(monkeypatch, count: int) -> None:
    for module in (wild_samples, flight_runs):
        monkeypatch.setattr(module, "FEW_SAMPLES", count)
    # The search for another clock has a grid of its own, which does not grow beyond it.
    monkeypatch.setattr(alignment, "_GRID_MAX", count)


@pytest.mark.parametrize("size", [1, 3, 7, 1000])
def test_screening_does_not_depend_on_the_parts(flown, vehicle, size):
    imu = flown.imu.take(slice(1950, 2200))
    unknown = imu.angular_velocity.copy()
    unknown[[0, 49, 53, 249]] = np.nan
    for stream in (imu, replace(imu, angular_velocity=unknown), flown.rotor_speeds.take(slice(850, 950))):
        name = "imu" if isinstance(stream, ImuStream) else "rotor_speeds"
        screening = Screening(vehicle, readings=False)
        for start in range(0, len(stream), size):
            screening.add(replace(flown, pose=None, **{name: stream.take(slice(start, start + size))}))
        in_parts, whole = screening.finish({})[name], list(beyond_limits(stream, vehicle))
        assert any(len(found.samples) for found in whole)
        for part, found in zip(in_parts, whole, strict=True):
            np.testing.assert_array_equal(part.samples, found.samples)
            assert part[1:] == found[1:]


@pytest.mark.parametrize("size", [1301, 1 << 20])
def test_a_bag_is_imported_like_the_whole_recording(late, vehicle, tmp_path, monkeypatch, size):
    recording = checked(read_recording(late, vehicle), vehicle)
    assert len(recording.quality.left_out) == 5
    write_bag(tmp_path / "whole.mcap", recording)
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", size)
    (imported,) = import_logs([late], vehicle, tmp_path / "bags")
    assert imported.bag.read_bytes() == (tmp_path / "whole.mcap").read_bytes()
    assert imported.quality == recording.quality
    assert imported.imu_samples == len(recording.imu)
    assert imported.topics == ("imu", "rotor_speeds", "mocap/pose")


@pytest.mark.parametrize("size", [1301])
def test_a_bag_is_described_like_the_whole_recording(late, vehicle, monkeypatch, size):
    whole = inspect_recording(decode_recording(late, vehicle), vehicle)
    assert any("left out" in finding for finding in whole.findings)
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", size)
    with open_recording(late, vehicle) as bag:
        assert inspect_blocks(bag.blocks, vehicle) == whole


@pytest.mark.parametrize(
    ("value", "said"), [(np.nan, "the position is not finite"), (-2.0 * VALUE_MAX, "position holds -2e.06")]
)
def test_what_cannot_be_used_is_named_in_a_later_block(flown, vehicle, tmp_path, monkeypatch, value, said):
    position = flown.pose.position.copy()
    position[100:, 1] = value
    bag = tmp_path / "bad.mcap"
    write_bag(bag, replace(flown, pose=replace(flown.pose, position=position)))
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", 500)
    with pytest.raises(LogError, match=f"topic mocap/pose: sample 100: {said}") as caught:
        import_logs([bag], vehicle, tmp_path / "bags")
    with pytest.raises(LogError) as whole:
        read_recording(bag, vehicle)
    assert str(caught.value) == str(whole.value)
    assert not (tmp_path / "bags" / "bad.mcap").exists()


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_even_rows_do_not_depend_on_the_parts(monkeypatch, size):
    few_samples(monkeypatch, 50)
    rows = wild_samples.EvenRows()
    for start in range(0, 330, size):
        rows.add(np.arange(start, min(start + size, 330)))
    np.testing.assert_array_equal(rows.rows(), np.arange(0, 330, 8))


def test_the_excerpt_of_a_long_flight_has_what_the_consistency_check_looks_at(long_bag, monkeypatch):
    few_samples(monkeypatch, 4096)
    recording = decode_recording(long_bag, None)
    streams = streams_by_field(recording)
    excerpting = Excerpting({name: stream.time_ns for name, stream in streams.items()})
    excerpting.add(recording)
    part = excerpting.finish()
    assert 4096 < len(part.imu) < 0.8 * len(recording.imu)
    for own, whole in (
        (excerpt(part, part.pose), excerpt(recording, recording.pose)),
        (rotor_excerpt(part), rotor_excerpt(recording)),
    ):
        for name, values in vars(whole).items():
            np.testing.assert_array_equal(getattr(own, name), values)


def test_a_long_flight_is_judged_like_a_whole_one(long_bag, monkeypatch):
    whole = inspect_recording(decode_recording(long_bag, None), None)
    few_samples(monkeypatch, 4096)
    with open_recording(long_bag) as bag:
        judged = inspect_blocks(bag.blocks)
    assert (judged.topics, judged.findings) == (whole.topics, whole.findings)
    for own, of_all in zip(judged.envelope, whole.envelope, strict=True):
        assert (own.lowest, own.highest) == (of_all.lowest, of_all.highest)
        assert own.median == pytest.approx(of_all.median, abs=0.02 * (of_all.highest - of_all.lowest))


@pytest.mark.slow
def test_memory_hardly_grows_with_the_flight(tmp_path, monkeypatch):
    """Beyond the first two minutes: an excerpt is of a minute, in parts of any longer flight."""
    few_samples(monkeypatch, 4096)
    vehicle, bag = Vehicle.load("neurobem"), tmp_path / "long.mcap"

    def described():
        with open_recording(bag, vehicle) as opened:
            inspect_blocks(opened.blocks, vehicle)

    works = {"import": lambda: import_logs([bag], vehicle, tmp_path / "bags"), "info": described}
    lengths_s, peaks = (150.0, 300.0), {name: [] for name in works}
    for seconds in (10.0, *lengths_s):
        write_long_bag(bag, vehicle, seconds)
        for name, work in works.items():
            tracemalloc.start()
            work()
            peaks[name].append(tracemalloc.get_traced_memory()[1])
            tracemalloc.stop()
    # Stamps of all topics and what is made of them; the samples themselves take 130 bytes.
    for name, (_, short, long) in peaks.items():
        assert long - short < 70 * np.diff(lengths_s) * RATE_HZ, name
