# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import ImuStream, PoseStream, Recording, Stream
from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.screening.first_seconds import (
    ARRAYS_MAX,
    MOVES_RAD_S,
    PAIRED_SHARE,
    STRETCH_S,
    STRETCHES,
    FirstSeconds,
    contradictions,
)
from quadpi_core.signals.chain import RATES, ROTOR_SPEEDS, SPECIFIC_FORCE, channels
from quadpi_core.vehicle import Vehicle
from test.core.mistakes import MISTAKES

BAGS = bags_directory()


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("bebop2")


@pytest.fixture(scope="module")
def flown(vehicle: Vehicle) -> Recording:
    return read_recording(BAGS / "train_2.mcap", vehicle)


def sent(recording: Recording, block_s: float = 0.02) -> Iterator[list]:
    """The samples in blocks as they come, those of the IMU last."""
    start_ns, end_ns = recording.imu.time_ns[[0, -1]]
    for begin in np.arange(start_ns, end_ns + 1, block_s * 1e9):
        block = []
        for stream in (recording.pose, recording.rotor_speeds, recording.imu):
            rows = (stream.time_ns >= begin) & (stream.time_ns < begin + block_s * 1e9)
            block.append(stream.take(rows))
        yield [stream for stream in block if len(stream)]


def taken(kept: FirstSeconds, streams: list[Stream]) -> Recording | None:
    """The stretch that samples complete."""
    found = [kept.take(type(stream), *vars(stream).values()) for stream in streams]
    return next((stretch for stretch in found if stretch is not None), None)


def stretches(recording: Recording) -> list[Recording]:
    kept = FirstSeconds("test")
    return [found for block in sent(recording) if (found := taken(kept, block)) is not None]


def still(recording: Recording) -> Recording:
    """At rest: the gyro has noise alone, below what is motion."""
    noise = 0.5 * MOVES_RAD_S * np.random.default_rng(1).uniform(-1.0, 1.0, (len(recording.imu), 3))
    return replace(recording, imu=replace(recording.imu, angular_velocity=noise))


def test_a_stretch_holds_the_samples_that_came(flown: Recording) -> None:
    (stretch,) = stretches(flown)
    span_s = 1e-9 * (stretch.imu.time_ns[-1] - stretch.imu.time_ns[0])
    assert STRETCH_S <= span_s < STRETCH_S + 0.1
    for name in ("imu", "pose", "rotor_speeds"):
        part, whole = getattr(stretch, name), getattr(flown, name)
        # All since the first block of the IMU, which comes last of its block.
        start = np.searchsorted(whole.time_ns, part.time_ns[0])
        assert part.time_ns[0] - stretch.imu.time_ns[0] <= 0.03e9
        np.testing.assert_array_equal(part.time_ns, whole.time_ns[start : start + len(part)])


def test_a_silent_imu_lets_nothing_pile_up() -> None:
    """Neither before its first sample nor within a stretch."""
    kept, moving, still_ = FirstSeconds("test"), np.ones((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]])

    def stamp(time_s: float) -> np.ndarray:
        return np.array([int(1e9 * time_s)])

    for k in range(10):
        assert kept.take(PoseStream, stamp(0.001 * k), moving, still_) is None
    kept.take(ImuStream, stamp(1.0), moving, moving)
    for k in range(ARRAYS_MAX + 10):
        kept.take(PoseStream, stamp(1.0 + 0.0001 * k), moving, still_)
    stretch = kept.take(ImuStream, stamp(1.0 + STRETCH_S), moving, moving)
    assert stretch is not None
    assert stretch.pose is not None
    assert len(stretch.pose) == ARRAYS_MAX == 15_000
    assert stretch.pose.time_ns[0] == stamp(1.0)


@pytest.mark.parametrize("bag", ["train_1", "train_3", "extrapolation"])
def test_nothing_is_said_of_sound_flights(bag: str, vehicle: Vehicle) -> None:
    (stretch,) = stretches(read_recording(BAGS / f"{bag}.mcap", vehicle))
    assert contradictions(stretch, vehicle) == []


@pytest.mark.parametrize("name", ["quaternion conjugated", "imu yawed by 90", "neighbours swapped"])
def test_mistakes_are_said(name: str, flown: Recording, vehicle: Vehicle) -> None:
    recording, assumed = MISTAKES[name].done(flown, vehicle)
    (stretch,) = stretches(recording)
    assert contradictions(stretch, assumed)


def test_wrong_units_are_named(flown: Recording, vehicle: Vehicle) -> None:
    in_g = replace(flown.imu, specific_force=flown.imu.specific_force / 9.81)
    (stretch,) = stretches(replace(flown, imu=in_g))
    assert "looks like g" in contradictions(stretch, vehicle)[0]


def test_a_vehicle_at_rest_says_nothing_and_is_waited_for(flown: Recording) -> None:
    kept = FirstSeconds("test")
    assert [taken(kept, block) for block in sent(still(flown))] == [None] * len(list(sent(flown)))
    assert not kept.complete
    assert kept.lacking == "in the last 15 s the vehicle did not move"


def test_samples_that_cannot_be_used_are_left_out(flown: Recording) -> None:
    rates = flown.imu.angular_velocity.copy()
    rates[1000] = np.nan
    stamps = flown.imu.time_ns.copy()
    stamps[2000] = stamps[1999]
    (stretch,) = stretches(replace(flown, imu=ImuStream(stamps, rates, flown.imu.specific_force)))
    assert contradictions(stretch, Vehicle.load(flown.vehicle)) == []


def paired(flown: Recording) -> np.ndarray:
    """Values (N, 20) as the monitor has them: all at the stamps of the IMU."""
    values = np.zeros((len(flown.imu), channels(4)))
    values[:, RATES], values[:, SPECIFIC_FORCE] = flown.imu.angular_velocity, flown.imu.specific_force
    values[:, ROTOR_SPEEDS] = 700.0
    return values


@pytest.mark.parametrize(("every", "judged"), [(3, True), (1, False)])
def test_samples_whose_state_came_too_late_are_no_fault_of_the_imu(
    every: int, judged: bool, flown: Recording
) -> None:
    """As on a computer that is too slow; of less than half of the samples nothing is said."""
    assert PAIRED_SHARE == 0.5
    values, imu = paired(flown), flown.imu
    for late in range(0, len(values), 10 * every):
        values[late : late + 8, RATES] = np.nan
    kept = FirstSeconds("test")
    found = [kept.take(None, imu.time_ns[k : k + 9], values[k : k + 9]) for k in range(0, len(imu), 9)]
    whole = [one for one in found if one is not None]
    assert len(whole) == judged
    assert kept.lacking == ("it takes 15 s of motion" if judged else "only 20% of the samples had a state")
    assert all(np.all(np.isfinite(one.imu.angular_velocity)) for one in whole)


def test_paired_samples_are_those_of_imu_and_rotors(flown: Recording) -> None:
    values, imu = paired(flown), flown.imu
    kept = FirstSeconds("test")
    found = [kept.take(None, imu.time_ns[k : k + 9], values[k : k + 9]) for k in range(0, len(imu), 9)]
    (stretch,) = [one for one in found if one is not None]
    count = len(stretch.imu)
    np.testing.assert_array_equal(stretch.imu.angular_velocity, imu.angular_velocity[:count])
    np.testing.assert_array_equal(stretch.imu.specific_force, imu.specific_force[:count])
    np.testing.assert_array_equal(stretch.rotor_speeds.speeds, 700.0)


def test_it_ends_after_its_stretches(flown: Recording) -> None:
    kept, found = FirstSeconds("test"), 0
    for repeat in range(STRETCHES + 2):
        later_ns = repeat * 21 * 10**9
        for block in sent(flown):
            moved = [replace(stream, time_ns=stream.time_ns + later_ns) for stream in block]
            found += taken(kept, moved) is not None
    assert found == STRETCHES
    assert kept.complete


def test_a_clock_that_is_set_back_begins_a_stretch(flown: Recording) -> None:
    kept = FirstSeconds("test")
    blocks = list(sent(flown))
    assert all(taken(kept, block) is None for block in blocks[:500])
    (stretch,) = [found for block in blocks if (found := taken(kept, block)) is not None]
    assert stretch.imu.time_ns[0] < flown.imu.time_ns[0] + 100_000_000


@pytest.mark.parametrize(("rate_rad_s", "moves"), [(0.098, False), (0.102, True)])
def test_a_stretch_is_15_s_and_moves_from_a_tenth_of_a_radian_per_second_on(
    rate_rad_s: float, moves: bool
) -> None:
    """Of three stretches, in all axes together."""
    kept = FirstSeconds("test")
    found: list[float] = []
    for k in range(50):
        stamp = np.array([k * 1_000_000_000])
        turning = np.array([[0.6, 0.0, 0.8]]) * rate_rad_s
        if kept.take(ImuStream, stamp, turning, turning) is not None:
            found.append(float(k))
    assert found == [15.0, 31.0, 47.0] * moves
    assert kept.complete == moves
