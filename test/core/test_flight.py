# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Streams, recordings and flights: what is refused, how they are cut and joined, what arrived when."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.findings import REASONS, Verdict
from quadpi_core.flight import Flight, ImuStream, PoseStream, Recording, ValueCheck, WindStream
from quadpi_core.reading_options import WHOLE, ReadingOptions, TimeRange, reading_options

SECOND, DAY = 10**9, 86_400 * 10**9
N = 100
TIME_NS = 1_700_000_000 * SECOND + np.arange(N) * 2_000_000


@pytest.fixture
def imu():
    rng = np.random.default_rng(1)
    return ImuStream(TIME_NS, *rng.normal(size=(2, N, 3)))


@pytest.fixture
def recording(imu):
    level = np.tile([1.0, 0.0, 0.0, 0.0], (N // 4, 1))
    pose = PoseStream(TIME_NS[::4], np.zeros((N // 4, 3)), level)
    wind = WindStream(TIME_NS[:1], np.zeros((1, 3)))
    return Recording("flight", "bebop2", "flight.mcap", imu, pose=pose, wind=wind)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t + 3 * DAY * (t > t[50]), r"sample 51: comes 3\.0 days after the one before; no flight"),
        (lambda t: t + 2**31 * SECOND, "sample 0: the stamp is before 1970 or after 2038"),
        (lambda t: t - t[0] - 1, r"sample 0: the stamp is before 1970 or after 2038 \(-1 ns\)"),
        (lambda t: np.where(t == t[7], t[6], t), "sample 7: the stamp repeats"),
        (lambda t: np.where(t == t[7], t[5], t), "sample 7: the stamp runs backward"),
    ],
)
def test_stamps_that_no_flight_has_are_refused(recording, change, message):
    wrong = replace(recording, imu=replace(recording.imu, time_ns=change(TIME_NS)))
    with pytest.raises(LogError, match=rf"^flight\.mcap: topic imu: {message}"):
        wrong.check()


def test_stamps_reach_to_the_end_of_a_message_s_seconds_and_span_two_days(imu):
    """Seconds in a message have 31 bits and a sign."""
    last = replace(imu, time_ns=TIME_NS - TIME_NS[-1] + 2**31 * SECOND - 1)
    last.check("a")
    with pytest.raises(LogError, match=f"sample {N - 1}: the stamp is before 1970 or after 2038"):
        replace(last, time_ns=last.time_ns + 1).check("a")
    replace(imu, time_ns=TIME_NS + (np.arange(N) >= 50) * (2 * DAY - TIME_NS[-1] + TIME_NS[0])).check("a")
    beyond = TIME_NS + (np.arange(N) >= 50) * (2 * DAY - TIME_NS[-1] + TIME_NS[0] + 1)
    with pytest.raises(LogError, match=r"sample 50: comes 2\.0 days after the one before"):
        replace(imu, time_ns=beyond).check("a")


def test_values_beyond_any_flight_are_refused(recording):
    position = recording.pose.position.copy()
    position[7, 1] = -1e6
    replace(recording, pose=replace(recording.pose, position=position)).check()
    position[7, 1] = -2e6
    message = r"topic mocap/pose: sample 7: position holds -2e\+06; nothing in a flight is beyond 1e\+06"
    with pytest.raises(LogError, match=message):
        replace(recording, pose=replace(recording.pose, position=position)).check()


def test_values_that_come_in_parts_are_named_by_their_place_in_the_whole(imu):
    force = imu.specific_force.copy()
    force[63, 1] = np.nan
    force[70, 0] = np.inf
    whole = replace(imu, specific_force=force)
    check = ValueCheck("flight.mcap: topic imu")
    for start in range(0, N, 30):
        check.add(whole.take(slice(start, start + 30)))
    with pytest.raises(LogError, match=r"^flight\.mcap: topic imu: sample 63: specific_force is not finite$"):
        check.finish()


def test_a_stream_of_its_parts_is_the_whole(imu):
    parts = [imu.take(slice(0, 13)), imu.take(np.arange(13, 40)), imu.take(np.arange(N) >= 40)]
    joined = ImuStream.join(parts)
    assert [len(part) for part in parts] == [13, 27, 60]
    np.testing.assert_array_equal(joined.time_ns, imu.time_ns)
    np.testing.assert_array_equal(joined.specific_force, imu.specific_force)


def test_an_empty_stream_names_its_topic(imu):
    with pytest.raises(LogError, match=r"^a: topic imu: holds no samples$"):
        imu.take(slice(0, 0)).check("a")
    with pytest.raises(LogError, match=r"^a: topic imu: holds no samples$"):
        imu.take(slice(0, 0)).require_samples("a")


def test_arrivals_are_those_of_the_log_unless_samples_were_lost_since(recording):
    """By stamps, a pose came after the sample of the IMU at its instant or before it."""
    by_stamps = 4 * np.arange(N // 4) + 1
    np.testing.assert_array_equal(recording.arrivals_of(recording.pose), by_stamps)
    logged = replace(recording, arrivals={"mocap/pose": by_stamps + 5})
    np.testing.assert_array_equal(logged.arrivals_of(logged.pose), by_stamps + 5)
    np.testing.assert_array_equal(logged.arrivals_of(logged.pose.take(slice(3, None))), by_stamps[3:])


def test_a_recording_lists_the_streams_that_it_has(recording):
    assert [stream.topic for stream in recording.streams()] == ["imu", "mocap/pose", "wind"]


def test_a_flight_that_is_cut_keeps_its_clock():
    time = np.arange(11) / 250.0
    three, four = np.arange(33.0).reshape(11, 3), np.arange(44.0).reshape(11, 4)
    flight = Flight("a", "v", "a.mcap", 5, time, three, four, *[three] * 4, four, three)
    cut = flight.slice(slice(2, None, 2))
    assert (cut.name, cut.start_ns, len(cut)) == ("a", 5, 5)
    assert cut.time[0] == 2 / 250.0
    assert (flight.rate_hz, cut.rate_hz) == (pytest.approx(250.0), pytest.approx(125.0))
    np.testing.assert_array_equal(cut.rotor_speeds, four[2::2])


# Parts of flights by time, as `--from` and `--to` ask for them.


@pytest.mark.parametrize("ends", [(2.0, 1.0), (2.0, 2.0), (-1.0, 2.0), (math.nan, 2.0), (1.0, math.nan)])
def test_a_range_that_is_none_is_refused(ends):
    with pytest.raises(QuadpiError, match="no range of seconds since the first IMU sample"):
        TimeRange(*ends)


def test_stamps_count_from_the_first_imu_sample():
    assert TimeRange(1.5, 2.0).stamps(10) == (1_500_000_010, 2_000_000_010)
    first, last = TimeRange(to_s=1.0).stamps(10**9)
    assert (first < 0, last) == (True, 2 * 10**9)
    assert WHOLE.is_whole
    assert str(TimeRange(1.5)) == "from 1.5 s to its end"


# Every verdict on the reports of speed controllers but one is a reason, in its own words.


def test_every_verdict_but_a_sample_has_a_reason_of_its_own() -> None:
    assert set(REASONS) == set(Verdict) - {Verdict.SAMPLE}
    assert len(set(REASONS.values())) == len(REASONS)


# What a user says of a log: options, or a mapping file alone.


def test_a_mapping_alone_stands_for_options_with_it():
    assert reading_options("mavros") == ReadingOptions("mavros")
    assert reading_options(None) == ReadingOptions()
    chosen = ReadingOptions(None, {"imu": "/uav1/imu"}, "/uav1")
    assert reading_options(chosen) is chosen
