# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that no flight can have are dropped, late ones sorted, clocks that fall or jump end a run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, PoseStream, Recording
from quadpi_core.screening.sample_order import SHARE_MAX, order_of, usable_recording

STEP = 2_000_000
SECOND = 500
CLEAN = 10**9 + STEP * np.arange(4 * SECOND)


def changed(rows, values):
    stamps = CLEAN.copy()
    stamps[rows] = values
    return stamps


def imu(time_ns):
    """Samples that hold their own number."""
    numbers = np.repeat(np.arange(float(len(time_ns)))[:, np.newaxis], 3, axis=1)
    return ImuStream(np.array(time_ns), numbers, numbers)


def recording(time_ns, **streams):
    return Recording("flight", "", "flight.mcap", imu(time_ns), **streams)


def poses(time_ns, norm=1.0):
    count = len(time_ns)
    attitude = np.zeros((count, 4))
    attitude[:, 0] = norm
    return PoseStream(
        np.array(time_ns), np.repeat(np.arange(float(count))[:, np.newaxis], 3, axis=1), attitude
    )


def test_clean_samples_pass_as_they_are():
    clean = recording(CLEAN, pose=poses(CLEAN[::5]))
    assert usable_recording(clean) is clean


@pytest.mark.parametrize(
    ("stamps", "fault", "first", "count"),
    [
        (changed(700, CLEAN[699]), "stamp repeats", 700, 1),
        (changed(slice(1, None, 2), CLEAN[::2]), "stamp repeats", 1, 2 * SECOND),
        (changed(700, CLEAN[690] + 1), "stamp runs backward", 700, 1),
        (changed(slice(700, 715), CLEAN[680:695] + 7), "stamp runs backward", 700, 15),
        (changed(700, 10**18), "stamp is far from those around it", 700, 1),
        (changed(0, 10**18), "stamp is far from those around it", 0, 1),
        (changed(-1, 10**18), "stamp is far from those around it", 4 * SECOND - 1, 1),
        (changed(700, 0), "stamp runs backward", 700, 1),
        (changed(700, -1), "stamp is no number from 1970 to 2038", 700, 1),
    ],
)
def test_samples_that_cannot_be_are_dropped_and_counted(stamps, fault, first, count):
    used = usable_recording(recording(stamps))
    (said,) = used.quality.left_out
    assert (said.topic, said.limit, said.first, said.samples) == ("imu", f"whose {fault}", first, count)
    assert np.all(np.diff(used.imu.time_ns) > 0)
    kept = used.imu.specific_force[:, 0].astype(int)
    assert len(kept) == len(stamps) - count
    assert first not in kept
    np.testing.assert_array_equal(used.imu.time_ns, stamps[kept])
    assert used.quality.breaks == used.quality.reordered == ()


@pytest.mark.parametrize(
    "order",
    [
        np.r_[0:100, 101, 100, 102:2000],
        np.r_[1, 0, 2:2000],
        np.r_[0:500, 600:700, 500:600, 700:2000],
        np.arange(2000).reshape(-1, 2)[:, ::-1].ravel(),
    ],
    ids=["two", "first", "burst", "pairs"],
)
def test_samples_stored_late_are_sorted(order):
    used = usable_recording(recording(CLEAN[order], pose=poses(CLEAN[order])))
    for stream in (used.imu, used.pose):
        np.testing.assert_array_equal(stream.time_ns, CLEAN)
    np.testing.assert_array_equal(order[used.imu.specific_force[:, 0].astype(int)], np.arange(2000))
    assert used.quality.left_out == ()
    assert [said.topic for said in used.quality.reordered] == ["imu", "mocap/pose"]
    assert used.quality.reordered[0].first == np.argmax(np.diff(order) < 0) + 1


@pytest.mark.parametrize(
    ("share", "refused"), [(0.98 * SHARE_MAX.value, False), (1.02 * SHARE_MAX.value, True)]
)
def test_a_source_is_refused_beyond_one_share(share, refused):
    force = np.zeros((len(CLEAN), 3))
    force[10 : 10 + round(share * len(CLEAN)), 1] = np.nan
    damaged = recording(CLEAN)
    damaged = replace(damaged, imu=replace(damaged.imu, specific_force=force))
    if refused:
        with pytest.raises(
            LogError,
            match=r"^flight\.mcap: topic imu: sample 10: the specific_force is not finite, and 1020 of",
        ):
            usable_recording(damaged)
    else:
        assert "whose specific_force is not finite" in str(usable_recording(damaged).quality.left_out[0])


@pytest.mark.parametrize("norm", [0.0, 0.9, 1e300])
def test_poses_whose_quaternion_is_no_rotation_are_dropped(norm):
    scale = np.ones(400)
    scale[100:160] = norm
    used = usable_recording(recording(CLEAN, pose=poses(CLEAN[::5], scale)))
    assert len(used.pose) == 340
    (said,) = used.quality.left_out
    assert str(said) == (
        "topic mocap/pose: left out 60 of 400 samples whose attitude is no unit quaternion; the first is "
        "sample 100, at 1.000 s"
    )


@pytest.mark.parametrize("arrived", [False, True])
@pytest.mark.parametrize(("shift_s", "kind"), [(-3, "falls"), (-30, "falls"), (10**6, "jumps")])
def test_of_two_boots_the_longest_is_used(arrived, shift_s, kind):
    """No sample of two boots comes into one flight."""
    second = CLEAN[-1] + STEP + shift_s * 10**9 + STEP * np.arange(6 * SECOND) + 40 * 10**9
    first = CLEAN + 40 * 10**9
    together = recording(np.r_[first, second], pose=poses(np.r_[first[::5], second[3::5]]))
    if arrived:
        rows = np.r_[np.arange(1, 2001, 5), np.arange(2004, 5001, 5)]
        together = replace(together, arrivals={"mocap/pose": rows})
    used = usable_recording(together)
    np.testing.assert_array_equal(used.imu.time_ns, second)
    np.testing.assert_array_equal(used.pose.time_ns, second[3::5])
    if arrived:
        np.testing.assert_array_equal(used.arrivals["mocap/pose"], np.arange(4, 3001, 5))
    fell, _ = used.quality.breaks
    before, after = 1e-9 * first[-1], 1e-9 * second[0]
    assert str(fell) == f"topic imu: the clock {kind} from {before:.1f} to {after:.1f} s at IMU sample 2000"
    (part,) = used.quality.used
    assert part.imu_samples == 3000


def test_a_clock_that_falls_into_a_pause_begins_a_run():
    """20 s, a pause of 30 s, 5 s more; then the clock falls by 25 s, to within the pause."""
    first = 10**9 + STEP * np.arange(20 * SECOND)
    second = first[-1] + 30 * 10**9 + STEP * np.arange(5 * SECOND)
    third = second[-1] - 25 * 10**9 + STEP * np.arange(20 * SECOND)
    order = order_of(np.concatenate((first, second, third)))
    assert (order.dropped, order.late) == ((), None)
    assert order.starts == (0, 25 * SECOND)


def test_a_stream_of_another_clock_keeps_what_arrived_with_the_longest_run():
    """Motion capture stamped by a computer that did not start again."""
    first, second = CLEAN, CLEAN[0] + STEP * np.arange(6 * SECOND)
    pose = poses(10**12 + STEP * np.arange(5000)[::5])
    together = recording(np.r_[first, second], pose=pose)
    together = replace(together, arrivals={"mocap/pose": np.arange(1, 5001, 5)})
    assert usable_recording(together).pose.time_ns[0] == pose.time_ns[400]


@settings(deadline=None)
@given(st.lists(st.integers(0, 12), min_size=1, max_size=12), st.sampled_from([1, 60_000_000, 10**9]))
def test_runs_rise_and_every_sample_is_used_or_counted_once(steps, unit):
    stamps = unit * np.array(steps)
    found = order_of(stamps)
    used = np.concatenate(found.runs())
    assert len(set(used.tolist())) == len(used)
    assert len(used) + sum(fault.samples for fault in found.dropped) == len(stamps)
    for run in found.runs():
        assert np.all(np.diff(stamps[run]) > 0)


def test_stamps_that_nobody_sets_are_told_from_repeats():
    words = "1999 of 2000 samples cannot be used.*does the publisher set the stamp of the header"
    with pytest.raises(LogError, match=words):
        usable_recording(recording(np.zeros_like(CLEAN)))
