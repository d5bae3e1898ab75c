# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import SignalError
from quadpi_core.flight import ImuStream, PoseStream
from quadpi_core.logs.formats.neurobem import read_neurobem
from quadpi_core.signals.alignment import OVERLAP, RIVAL, time_offset, turn_offset
from quadpi_core.vehicle import Vehicle


def chirp(time):
    return np.stack((np.sin(time * time), np.cos(1.3 * time * time + time)), axis=1)


def stamps(start, stop, rate):
    return np.rint(np.arange(start, stop, 1.0 / rate) * 1e9).astype(np.int64)


@pytest.mark.parametrize("offset", [0.0, 0.1234, -0.05678])
def test_recovers_an_offset_below_one_sample(offset):
    reference_ns, other_ns = stamps(0.0, 10.0, 500.0), stamps(2.0, 8.0, 120.0)
    noise = np.random.default_rng(8).normal(scale=0.1, size=(len(other_ns), 2))
    other = chirp(1e-9 * other_ns + offset) + noise
    found = time_offset(reference_ns, chirp(1e-9 * reference_ns), other_ns, other)
    assert found.offset_s == pytest.approx(offset, abs=1e-3)
    assert found.correlation > 0.97
    assert found.overlap_s == pytest.approx(6.0, abs=0.1)
    assert found.matches == pytest.approx(3000, abs=10)


def test_clocks_of_unrelated_epochs():
    reference_ns = 1_700_000_000_000_000_000 + stamps(0.0, 10.0, 500.0)
    other_ns = stamps(0.0, 5.0, 200.0)
    reference = chirp(1e-9 * (reference_ns - reference_ns[0]))
    found = time_offset(reference_ns, reference, other_ns, chirp(1e-9 * other_ns + 3.0))
    assert found.offset_ns == pytest.approx(1_700_000_003_000_000_000, abs=1e6)


def test_no_overlap_prints_ranges_offset_and_matches():
    first, later = stamps(0.0, 10.0, 100.0), stamps(100.0, 101.5, 100.0)
    with pytest.raises(
        SignalError,
        match=r"A and B: no overlap: reference spans 0\.000 to 9\.990 s, other 100\.000 to .* 0 matching",
    ):
        time_offset(first, chirp(1e-9 * first), later, chirp(1e-9 * later), what="A and B")


def test_signals_that_share_nothing_are_refused():
    rng = np.random.default_rng(9)
    time_ns = stamps(0.0, 20.0, 100.0)
    with pytest.raises(SignalError, match=r"best offset .* correlation 0\.\d+ over \d+ matching"):
        time_offset(time_ns, rng.normal(size=(2000, 3)), time_ns, rng.normal(size=(2000, 3)))


def test_a_constant_signal_is_refused():
    time_ns = stamps(0.0, 20.0, 100.0)
    with pytest.raises(SignalError, match="no overlap"):
        time_offset(time_ns, np.ones((2000, 3)), time_ns, np.ones((2000, 3)))


def test_the_gyro_of_neurobem_lags_by_a_few_milliseconds(shared_data):
    path = shared_data / "neurobem" / "bemnn20210218172600seg1.mat"
    recording = read_neurobem(path, Vehicle.load("neurobem"))
    alignment = turn_offset(recording.imu, recording.pose, "neurobem")
    assert 0.005 < alignment.offset_s < 0.009
    assert alignment.correlation > 0.99


@pytest.mark.parametrize(("stop", "found"), [(5.95, False), (6.05, True)])
def test_two_seconds_must_overlap(stop, found):
    reference_ns, other_ns = stamps(0.0, 10.0, 100.0), stamps(4.0, stop, 100.0)
    signals = (reference_ns, chirp(1e-9 * reference_ns), other_ns, chirp(1e-9 * other_ns))
    if found:
        assert time_offset(*signals).offset_s == pytest.approx(0.0, abs=1e-3)
        return
    with pytest.raises(SignalError, match=r"no overlap: reference spans .* 0 matching samples"):
        time_offset(*signals)


def test_what_poses_say_beyond_eight_hertz_is_filtered_out():
    """A quadrotor turns more slowly; differentiated attitudes are mostly noise there. Here of 12 Hz."""
    time_ns = stamps(0.0, 20.0, 200.0)
    time = 1e-9 * time_ns
    angle = np.cumsum(np.sin(2.0 * np.pi * 0.3 * time)) / 200.0
    shaken = angle + np.sin(2.0 * np.pi * 12.0 * time) / (2.0 * np.pi * 12.0)
    gyro = np.zeros((len(time), 3))
    gyro[:, 2] = np.sin(2.0 * np.pi * 0.3 * time)
    half = 0.5 * shaken
    attitude = np.stack((np.cos(half), 0.0 * half, 0.0 * half, np.sin(half)), axis=1)
    imu, pose = ImuStream(time_ns, gyro, np.zeros_like(gyro)), PoseStream(time_ns, 0.0 * gyro, attitude)
    assert turn_offset(imu, pose, "a").correlation > 0.95


def repeating(time):
    """Laps of 4 s, the later ones a little faster."""
    return np.stack((np.sin(0.5 * np.pi * time), np.cos(np.pi * time)), axis=1)


def test_a_motion_that_repeats_gives_no_offset_alone():
    time_ns, late_ns = stamps(0.0, 24.0, 100.0), stamps(5.0, 29.0, 100.0)
    laps = repeating(1e-9 * time_ns)
    found = time_offset(time_ns, laps, late_ns, laps)
    assert found.offset_s == pytest.approx(-5.0, abs=1e-3)
    assert found.rival_s is not None
    assert found.rival_s + 5.0 == pytest.approx(4.0 * round((found.rival_s + 5.0) / 4.0), abs=0.05)
    # What only one lap has singles it out.
    laps += 3.0 * np.exp(-(((1e-9 * time_ns - 9.0) / 0.3) ** 2))[:, np.newaxis]
    assert time_offset(time_ns, laps, late_ns, laps).rival_s is None
    assert 0.4 < RIVAL.value < 0.8


def test_short_overlaps_count_for_nothing():
    """The last 3 of 20 s repeat the first ones, better than noise lets the whole be alike."""
    rng = np.random.default_rng(4)
    time_ns = stamps(0.0, 20.0, 100.0)
    turns = chirp(1e-9 * time_ns)
    other = turns + rng.normal(scale=0.3, size=turns.shape)
    other[-300:] = turns[:300]
    assert time_offset(time_ns, turns, time_ns, other).offset_s == pytest.approx(0.0, abs=5e-3)
    assert 3.0 / 20.0 < OVERLAP.value < 0.5


def test_what_is_too_short_to_filter_names_the_pair():
    time_ns = np.arange(500) * 2_000_000
    with pytest.raises(SignalError, match="A and B: too short to align: 500 samples are too few"):
        time_offset(
            time_ns, chirp(1e-9 * time_ns), time_ns, chirp(1e-9 * time_ns), above_hz=1.0, what="A and B"
        )
