# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Wild samples are left out of a flight, as they are live, and said to be."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.core import compiled
from quadpi_core.errors import LogError
from quadpi_core.flight import (
    MAX_GAP_NS,
    ImuStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    Stream,
    WindStream,
)
from quadpi_core.logs import decode_recording, read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.records import RATE_MAX_RAD_S, SPECIFIC_FORCE_MAX_M_S2
from quadpi_core.screening.plausibility import check_plausible
from quadpi_core.screening.wild_samples import beyond_limits, screened, usable_samples
from quadpi_core.vehicle import Vehicle

BAG = Path(__file__).parents[3] / "bags" / "train_1.mcap"
FIRST = 700
WHERE = {
    "gyro": ("imu", "angular_velocity"),
    "accelerometer": ("imu", "specific_force"),
    "rotor": ("rotor_speeds", "speeds"),
    "pose": ("pose", "position"),
}
SIZES = {"gyro": (30.0, 1e2, 1e4, 1e28), "accelerometer": (60.0, 1e2, 1e4, 1e28)}
SIZES |= {"rotor": (1e2, 1e4, 1e28), "pose": (1e2, 1e4, 1e28)}


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("bebop2")


@pytest.fixture(scope="module")
def clean(vehicle: Vehicle) -> Recording:
    return decode_recording(BAG, vehicle)


def wild(recording: Recording, sensor: str, size: float, count: int) -> Recording:
    """One axis of `count` samples, from sample FIRST on, is `size`."""
    stream_name, column = WHERE[sensor]
    stream = getattr(recording, stream_name)
    values = getattr(stream, column).copy()
    values[np.linspace(FIRST, len(stream) - 10, count).astype(int), 1] = size
    return replace(recording, **{stream_name: replace(stream, **{column: values})})


@pytest.mark.parametrize("count", [1, 100])
@pytest.mark.parametrize(("sensor", "size"), [(sensor, size) for sensor in SIZES for size in SIZES[sensor]])
def test_wild_samples_are_left_out_and_no_others(clean, vehicle, sensor, size, count):
    stream_name, column = WHERE[sensor]
    used = screened(wild(clean, sensor, size, count), vehicle)
    check_plausible(used, vehicle)
    whole, stream = getattr(clean, stream_name), getattr(used, stream_name)
    assert len(stream) == len(whole) - count
    kept = np.isin(whole.time_ns, stream.time_ns)
    np.testing.assert_array_equal(getattr(stream, column), getattr(whole, column)[kept])
    (left_out,) = used.quality.left_out
    assert (left_out.topic, left_out.samples, left_out.first) == (stream.topic, count, FIRST)
    assert left_out.first_s == pytest.approx((whole.time_ns[FIRST] - clean.imu.time_ns[0]) * 1e-9)


def test_nothing_is_left_out_of_a_sound_flight(clean, vehicle):
    assert screened(clean, vehicle) is clean


def test_what_is_wild_for_long_is_no_outlier(clean, vehicle):
    """A unit is wrong in every sample, which a refusal says; and a step is no spike."""
    imu = clean.imu
    degrees = replace(clean, imu=replace(imu, angular_velocity=1e3 * imu.angular_velocity))
    with pytest.raises(LogError, match=r"topic imu: sample \d+: .*are beyond 70 rad/s: looks like deg/s"):
        check_plausible(screened(degrees, vehicle), vehicle)
    force = imu.specific_force.copy()
    force[FIRST:, 0] += 50.0
    stepped = replace(clean, imu=replace(imu, specific_force=force))
    assert screened(stepped, vehicle) is stepped


def test_limits_are_those_of_the_live_path(clean):
    """What the estimator refuses sample by sample is what is left out."""
    for column, limit in ((0, RATE_MAX_RAD_S), (3, SPECIFIC_FORCE_MAX_M_S2)):
        for value in (limit, np.nextafter(limit, np.inf)):
            sample = np.zeros(6)
            sample[column] = value
            rates, force = clean.imu.angular_velocity.copy(), clean.imu.specific_force.copy()
            # For longer than a spike.
            rates[FIRST : FIRST + 10], force[FIRST : FIRST + 10] = sample[:3], sample[3:]
            imu = replace(clean.imu, angular_velocity=rates, specific_force=force)
            used = screened(replace(clean, imu=imu), None)
            assert (len(used.imu) == len(imu)) == compiled.usable_imu(sample[:3], sample[3:])


def test_arrivals_count_what_is_left(clean, vehicle):
    """Where a log says how many IMU samples had arrived, those that were left out no longer count."""
    recording = wild(clean, "gyro", 1e4, 3)
    used = screened(recording, vehicle)
    known = recording.arrivals_of(recording.rotor_speeds)
    lost = ~np.isin(recording.imu.time_ns, used.imu.time_ns)
    before = np.concatenate(([0], np.cumsum(lost)))
    np.testing.assert_array_equal(used.arrivals_of(used.rotor_speeds), known - before[known])


def test_a_bag_with_a_wild_sample_is_read_without_it(clean, vehicle, tmp_path):
    write_bag(tmp_path / "wild.mcap", wild(clean, "gyro", 1e28, 1))
    used = read_recording(tmp_path / "wild.mcap", vehicle)
    assert np.diff(used.imu.time_ns).max() < MAX_GAP_NS
    assert list(used.quality.sentences()) == [
        f"topic imu: left out 1 of {len(clean.imu)} samples beyond 70 rad/s; the first is sample {FIRST}, "
        "at 1.400 s"
    ]


COUNT = 1000
STAMPS = 2_000_000 * np.arange(COUNT)
LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def still(kind: type[Stream], rng: np.random.Generator, noise: float = 0.0) -> Stream:
    """A sensor of a vehicle at rest: its first column has noise."""
    none = np.zeros((COUNT, 3))
    first = noise * rng.standard_normal((COUNT, 3))
    if kind is PoseStream:
        return PoseStream(STAMPS, first, np.tile(LEVEL, (COUNT, 1)))
    if kind is RotorSpeedStream:
        return RotorSpeedStream(STAMPS, 500.0 + np.hstack((first, first[:, :1])))
    if kind is WindStream:
        return WindStream(STAMPS, first)
    return ImuStream(STAMPS, first, none)


def struck(stream: Stream, column: str, size: float, count: int = 1) -> Stream:
    """With single samples, evenly spread, farther from their neighbours by so much."""
    values = getattr(stream, column).copy()
    values[np.linspace(10, COUNT - 10, count).astype(int), 0] += size
    return replace(stream, **{column: values})


def outliers(stream: Stream, vehicle: Vehicle | None = None) -> int:
    usable = usable_samples(beyond_limits(stream, vehicle))
    return 0 if usable is None else int(np.count_nonzero(~usable))


@pytest.mark.parametrize(
    ("kind", "column", "least"),
    [
        (ImuStream, "angular_velocity", 5.0),
        (ImuStream, "specific_force", 20.0),
        (PoseStream, "position", 0.5),
        (WindStream, "velocity", 5.0),
        (RotorSpeedStream, "speeds", None),
    ],
)
def test_a_spike_is_farther_from_its_neighbours_than_a_vehicle_moves(vehicle, kind, column, least):
    """In rad/s, m/s², m and m/s; of rotor speeds a fifth of the largest."""
    least = 0.2 * vehicle.rotor_speed_max_rad_s if least is None else least
    stream = still(kind, np.random.default_rng(1))
    for size, found in ((0.98 * least, 0), (1.02 * least, 1)):
        assert outliers(struck(stream, column, size), vehicle) == found


@pytest.mark.parametrize(("noises", "found"), [(17.0, 0), (23.0, 1)])
def test_a_spike_is_twenty_times_farther_than_four_fifths_of_the_samples(noises, found):
    """From the median of five, of noise that is uniform but for a fifth that is far larger."""
    rng = np.random.default_rng(2)
    noise = np.where(rng.random((COUNT, 3)) < 0.15, 3.0, 1.0) * rng.uniform(-1.0, 1.0, (COUNT, 3))
    near = np.median(np.lib.stride_tricks.sliding_window_view(noise[:, 0], 5), axis=1)
    typical = np.percentile(np.abs(noise[2:-2, 0] - near), 80.0)
    imu = replace(still(ImuStream, rng), angular_velocity=noise)
    noisy = replace(imu, angular_velocity=noise * [1.0, 0.0, 0.0])
    assert outliers(struck(noisy, "angular_velocity", noises * typical)) == found


@pytest.mark.parametrize("size", [1e4, 30.0])
@pytest.mark.parametrize(("count", "left_out"), [(100, True), (101, False)])
def test_a_tenth_of_the_samples_may_be_spikes(size, count, left_out):
    stream = struck(still(ImuStream, np.random.default_rng(3)), "angular_velocity", size, count)
    assert outliers(stream) == count * left_out


@pytest.mark.parametrize(("count", "left_out"), [(9, True), (12, False)])
def test_a_hundredth_of_the_samples_may_be_beyond_a_limit_for_long(count, left_out):
    """In runs that are no spikes: more is another unit."""
    stream = still(ImuStream, np.random.default_rng(4))
    rates = stream.angular_velocity.copy()
    rates[500 : 500 + count] = 100.0
    assert outliers(replace(stream, angular_velocity=rates)) == count * left_out
