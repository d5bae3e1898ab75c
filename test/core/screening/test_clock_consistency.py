# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Streams of different clocks: the offset is named, and `aligned` takes it back; sound flights have none."""

from __future__ import annotations

import re
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.errors import SignalError
from quadpi_core.flight import OdometryStream, TwistStream
from quadpi_core.frames import body_rates
from quadpi_core.logs import read_recording
from quadpi_core.screening import clock_consistency
from quadpi_core.screening.clock_consistency import aligned, clock_mistake, rotor_clock_finding
from quadpi_core.screening.consistency import findings
from quadpi_core.screening.excerpt import excerpt
from quadpi_core.signals.alignment import Alignment
from quadpi_core.vehicle import SensorNoise, Vehicle


def late(recording, seconds, *names):
    """The recording with streams stamped later."""
    moved = {}
    for name in names:
        stream = getattr(recording, name)
        moved[name] = replace(stream, time_ns=stream.time_ns + round(1e9 * seconds))
    return replace(recording, **moved)


def with_state(recording):
    """The recording with a fused state in the place of its motion capture."""
    pose = recording.pose
    rates = np.vstack((body_rates(pose.time_ns, pose.attitude), np.zeros((1, 3))))
    state = OdometryStream(pose.time_ns, pose.position, pose.attitude, 0.0 * pose.position, rates)
    return replace(recording, pose=None, odometry=state)


def offset(seconds, rival_s=None):
    return Alignment(seconds, correlation=0.9, overlap_s=10.0, matches=1000, rival_s=rival_s)


@pytest.mark.parametrize(
    ("of_state", "seconds"),
    [*((False, seconds) for seconds in (-3.2, -0.4, 5.0, 17.0, 37.0, 1.7e9)), (True, -0.4), (True, 1.7e9)],
)
def test_an_offset_up_to_epochs_is_named_and_taken_back(flown, vehicle, seconds, of_state):
    recording = with_state(flown["train_2"]) if of_state else flown["train_2"]
    name = "odometry" if of_state else "pose"
    wrong = late(recording, seconds, name)
    (found,) = findings(wrong, vehicle)
    assert (found.mistake, found.leave_out) == ("clock offset", True)
    assert float(re.search(r"look ([-+][\d.]+) s off", found.text)[1]) == pytest.approx(seconds, abs=5e-3)
    assert "which `import --align` corrects" in found.text
    assert ("they share no time" in found.text) == (abs(seconds) > 20.0)
    moved, alignments = aligned(wrong, vehicle)
    (alignment,) = alignments.values()
    assert alignment.offset_s == pytest.approx(-seconds, abs=5e-3)
    assert list(findings(moved, vehicle)) == []


def test_rotor_speeds_that_share_no_time_are_named_and_moved(flown, vehicle):
    recording = flown["train_4"]
    wrong = late(recording, 120.0, "rotor_speeds")
    found = rotor_clock_finding(wrong, vehicle)
    assert found is not None
    assert "rotor_speeds" in str(found)
    assert "they share no time; the stamps look +1" in found.text
    moved, alignments = aligned(wrong, vehicle)
    assert alignments["rotor_speeds"].offset_s == pytest.approx(-120.0, abs=0.02)
    assert rotor_clock_finding(moved, vehicle) is None
    (same,) = findings(wrong, vehicle)
    assert same == found
    without = rotor_clock_finding(wrong, None)
    assert without is not None
    assert without.mistake == "clocks apart"


def test_streams_that_share_neither_time_nor_motion_print_both_ranges(flown, vehicle):
    recording = flown["train_2"]
    pose, rng = recording.pose, np.random.default_rng(3)
    noise = rng.normal(size=pose.attitude.shape)
    other = replace(pose, attitude=noise / np.linalg.norm(noise, axis=1, keepdims=True))
    (found,) = findings(late(replace(recording, pose=other), 1000.0, "pose"), vehicle)
    assert found.mistake == "clocks apart"
    assert "spans 1" in found.text
    assert ", imu " in found.text
    assert "they share no time; no offset makes their turns alike" in found.text


def test_laps_that_repeat_are_said_to_be_ambiguous(flown, vehicle):
    """The same five seconds, four times over."""
    recording, lap_ns = flown["train_2"], 5 * 10**9
    imu, pose = recording.imu, recording.pose
    start = int(imu.time_ns[0]) + 2 * lap_ns
    laps = {}
    for name, stream in (("imu", imu), ("pose", pose)):
        one = stream.take((stream.time_ns >= start) & (stream.time_ns < start + lap_ns))
        parts = [replace(one, time_ns=one.time_ns + lap * lap_ns) for lap in range(4)]
        laps[name] = type(stream).join(parts)
    flight = replace(recording, **laps, rotor_speeds=None, arrivals={})
    wrong = late(flight, 2.0, "pose")
    (found,) = findings(wrong, None)
    assert "which is ambiguous as the motion repeats" in found.text
    with pytest.raises(SignalError, match=r"offsets of [-+]\d\.\d+ s and [-+]\d\.\d+ s fit nearly alike"):
        aligned(wrong, vehicle)
    # Clocks that are set are taken at their word.
    alignment = aligned(late(flight, 0.2, "pose"), vehicle)[1]["mocap/pose"]
    assert alignment.offset_s == pytest.approx(-0.2, abs=0.03)


def test_motion_capture_moves_as_a_whole(noisy_vehicle, simulate_flight):
    precise = replace(noisy_vehicle, noise=SensorNoise(mocap_attitude_rad=0.001))
    recording = simulate_flight(11, vehicle=precise).recording
    pose = recording.pose
    both = replace(recording, twist=TwistStream(pose.time_ns, pose.position, np.ones(len(pose), dtype=bool)))
    wrong = late(both, 0.08, "pose", "twist")
    moved, alignments = aligned(wrong, precise)
    alignment = alignments["mocap/pose"]
    assert alignment.offset_s == pytest.approx(-0.08, abs=2e-3)
    for name in ("pose", "twist"):
        expected = getattr(wrong, name).time_ns + alignment.offset_ns
        np.testing.assert_array_equal(getattr(moved, name).time_ns, expected)
    with pytest.raises(SignalError, match=r"simulated\.bag: topic mocap/pose is missing"):
        aligned(replace(recording, pose=None), noisy_vehicle)


@pytest.mark.parametrize(("share", "is_found"), [(0.99, True), (1.01, False)])
def test_streams_that_share_a_second_are_judged_by_what_they_share(flown, vehicle, share, is_found):
    recording = flown["train_4"]
    length = 1e-9 * float(recording.imu.time_ns[-1] - recording.rotor_speeds.time_ns[0])
    wrong = late(recording, length - share, "rotor_speeds")
    assert (rotor_clock_finding(wrong, vehicle) is not None) == is_found
    assert clock_consistency.SHARED_S.value == 1.0


@pytest.mark.parametrize(("seconds", "is_found"), [(0.049, False), (0.051, True)])
@pytest.mark.parametrize(("price", "explains"), [(0.49, True), (0.51, False)])
def test_a_delay_is_a_clock_of_its_own_if_it_is_large_and_explains(
    flown, monkeypatch, seconds, is_found, price, explains
):
    recording = flown["train_2"]
    prices = iter((price, 1.0))
    monkeypatch.setattr(clock_consistency, "turn_offset", lambda *_: offset(seconds))
    monkeypatch.setattr(clock_consistency, "cost", lambda *_: next(prices))
    found = clock_mistake(recording, recording.pose, excerpt(recording, recording.pose))
    assert (found is not None) == (is_found and explains)


@pytest.mark.parametrize(("explained", "is_found"), [(0.24, False), (0.26, True)])
def test_rotor_speeds_have_to_explain_a_quarter_where_they_are_moved(
    flown, vehicle, monkeypatch, explained, is_found
):
    monkeypatch.setattr(clock_consistency, "rotor_evidence", lambda *_: SimpleNamespace(explained=explained))
    found = rotor_clock_finding(late(flown["train_4"], 120.0, "rotor_speeds"), vehicle)
    assert (found.mistake == "clock offset") == is_found


@pytest.mark.parametrize(("seconds", "is_taken"), [(0.99, True), (1.01, False)])
def test_clocks_that_agree_to_a_second_are_taken_at_their_word(
    flown, vehicle, monkeypatch, seconds, is_taken
):
    monkeypatch.setattr(clock_consistency, "turn_offset", lambda *_: offset(seconds, rival_s=5.0))
    with nullcontext() if is_taken else pytest.raises(SignalError, match="fit nearly alike"):
        aligned(flown["train_2"], vehicle)


@pytest.mark.slow
def test_no_real_flight_has_a_clock_of_its_own(shared_data):
    """And moved by 5 s, each is found to be, or called ambiguous."""
    vehicle, said = Vehicle.load("crazyflie_rpm"), []
    logs = [
        log for name in ("imrc_brushless", "imrc_payload", "imrc_brushed") for log in find(shared_data, name)
    ]
    for log in logs:
        recording = read_recording(log, vehicle)
        assert not [one for one in findings(recording, None) if one.mistake.startswith("clock")], log
        found = [one for one in findings(late(recording, 5.0, "pose"), None) if one.mistake == "clock offset"]
        said.append(found[0].text if found else "")
    wrong = [text for text in said if "look +5.0" not in text and "look +4.9" not in text]
    assert all("ambiguous" in text for text in wrong)
    assert len(wrong) <= 2


def find(folder, name):
    return sorted(path for path in (folder / name).iterdir() if path.suffix == "")
