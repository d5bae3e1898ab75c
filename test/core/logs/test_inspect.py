# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What inspection finds in spoilt recordings, and not in good ones, and that copies of a flight are known."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from quadpi_core.errors import LogError
from quadpi_core.flight import (
    NOT_MEASURED,
    BatteryStream,
    ImuStream,
    OdometryStream,
    Recording,
    RotorSpeedStream,
)
from quadpi_core.frames import body_flu_to_frd, body_frd_to_flu
from quadpi_core.logs import decode_recording, read_recording
from quadpi_core.logs.inspect import LongestRun, RunningRange, inspect_recording
from quadpi_core.logs.readers import RunningHash, recording_hash
from quadpi_core.screening.plausibility import check_plausible, thrust_coefficient
from quadpi_core.vehicle import Vehicle

RATE_HZ = 500
SAMPLES = 2000
HOVER_RAD_S = 1570.0
MILLISECOND = 1_000_000


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("crazyflie_rpm")


def with_speeds(recording: Recording, change: Callable[[np.ndarray], object]) -> Recording:
    speeds = recording.rotor_speeds.speeds.copy()
    change(speeds)
    return replace(recording, rotor_speeds=replace(recording.rotor_speeds, speeds=speeds))


def with_imu(recording: Recording, **scale: float) -> Recording:
    scaled = {name: getattr(recording.imu, name) * factor for name, factor in scale.items()}
    return replace(recording, imu=replace(recording.imu, **scaled))


def findings(recording: Recording, vehicle: Vehicle | None) -> str:
    return "\n".join(inspect_recording(recording, vehicle).findings)


def test_nothing_is_found_in_a_good_recording(hover: Recording, vehicle: Vehicle):
    check_plausible(hover, vehicle)
    assert inspect_recording(hover, vehicle).findings == ()


def test_timing_of_topics(hover: Recording, vehicle: Vehicle):
    imu, _, pose, _ = inspect_recording(hover, vehicle).topics
    assert (imu.topic, imu.count, imu.gaps, imu.repeated, imu.backward) == ("imu", SAMPLES, 0, 0, 0)
    assert imu.rate_hz == pytest.approx(500.0)
    assert pose.rate_hz == pytest.approx(100.0)
    assert imu.longest_gap_s == pytest.approx(0.002)


def test_envelope(hover: Recording, vehicle: Vehicle):
    rows = {row.quantity: row for row in inspect_recording(hover, vehicle).envelope}
    assert rows["altitude"].lowest == pytest.approx(1.0)
    assert rows["tilt"].highest == pytest.approx(np.degrees(0.2), rel=1e-3)
    assert rows["battery"].unit == "V"
    assert rows["rotor 4"].median == pytest.approx(HOVER_RAD_S, rel=0.01)


def test_parts_of_a_state_that_nobody_measured_are_no_values(hover: Recording, vehicle: Vehicle):
    pose = hover.pose
    nothing = np.zeros((len(pose), 3))
    deviation = np.tile([NOT_MEASURED, 0.0, NOT_MEASURED], (len(pose), 1))
    turned = OdometryStream(pose.time_ns, nothing, pose.attitude, nothing, nothing + pose.position, deviation)
    rows = {row.quantity: row for row in inspect_recording(replace(hover, odometry=turned)).envelope}
    assert "speed" not in rows
    assert rows["altitude"].lowest == pytest.approx(1.0)
    alone = replace(hover, odometry=turned, pose=None)
    assert {row.quantity for row in inspect_recording(alone).envelope}.isdisjoint({"speed", "altitude"})
    assert "stays the same" not in findings(alone, None)
    assert thrust_coefficient(alone, vehicle, in_hover=True) is None


def test_gap_repeated_and_backward_stamps_are_counted(hover: Recording, vehicle: Vehicle):
    time_ns = hover.imu.time_ns.copy()
    time_ns[1000:] += 300 * MILLISECOND
    time_ns[50] = time_ns[49]
    time_ns[60] = time_ns[50]
    spoilt = replace(hover, imu=replace(hover.imu, time_ns=time_ns))
    imu = inspect_recording(spoilt, vehicle).topics[0]
    assert (imu.gaps, imu.repeated, imu.backward) == (2, 1, 1)
    assert imu.longest_gap_s == pytest.approx(0.302)
    found = findings(spoilt, vehicle)
    assert "topic imu: gaps: 2, the longest 302 ms" in found
    assert "topic imu: 1 stamps repeat" in found
    assert "topic imu: 1 stamps run backward" in found


@pytest.mark.parametrize(("intervals", "gaps"), [(4.9, 0), (5.1, 1)])
def test_an_interval_of_five_usual_ones_is_a_gap(hover: Recording, vehicle: Vehicle, intervals, gaps):
    time_ns = hover.imu.time_ns.copy()
    time_ns[1000:] += round((intervals - 1.0) * 2 * MILLISECOND)
    later = replace(hover, imu=replace(hover.imu, time_ns=time_ns))
    assert inspect_recording(later, vehicle).topics[0].gaps == gaps


def test_arrival_times_jitter(hover: Recording, vehicle: Vehicle):
    jitter = np.random.default_rng(5).uniform(0.0, 9 * MILLISECOND, len(hover.pose)).astype(np.int64)
    spoilt = replace(hover, pose=replace(hover.pose, time_ns=hover.pose.time_ns + jitter))
    assert "topic mocap/pose: stamps jitter by" in findings(spoilt, vehicle)


@pytest.mark.parametrize("rotor", range(4))
def test_half_reading_rotor(hover: Recording, vehicle: Vehicle, rotor: int):
    def halve(speeds: np.ndarray) -> None:
        speeds[:, rotor] /= 2

    found = findings(with_speeds(hover, halve), vehicle)
    assert f"rotor {rotor + 1} reads 0.50 times the others: half-reading sensor?" in found
    assert found.count("reading sensor") == 1


def test_rotor_that_reads_half_at_times(hover: Recording, vehicle: Vehicle):
    def halve_at_times(speeds: np.ndarray) -> None:
        speeds[300:340, 2] /= 2
        speeds[900:1000, 2] /= 2

    found = findings(with_speeds(hover, halve_at_times), vehicle)
    assert "rotor 3 halves or doubles within one interval, 4 times: half-reading sensor?" in found


def test_nothing_is_said_of_rotors_that_stand_or_idle_on_the_ground(hover: Recording):
    """After a flight."""

    def on_ground(speeds: np.ndarray) -> None:
        speeds[500:1000] = 0.0
        speeds[1000:] = (300.0, 300.0, 150.0, 300.0)

    assert "rotor" not in findings(with_speeds(hover, on_ground), None)


def test_nothing_is_said_of_motors_that_are_tried_on_a_bench(hover: Recording, vehicle: Vehicle):
    """One after the other, at a speed that lifts nothing, and one at half of the others' speed."""

    def tried(speeds: np.ndarray) -> None:
        speeds[:] = 0.0
        for rotor in range(4):
            speeds[400 * rotor : 400 * rotor + 300, rotor] = 300.0
        speeds[1600:] = (300.0, 300.0, 150.0, 300.0)

    still = with_imu(with_speeds(hover, tried), angular_velocity=0.01)
    assert "rotor" not in findings(replace(still, pose=None), vehicle).replace("rotors and airframe", "")


def test_rotor_speeds_that_are_all_zero_are_no_telemetry(hover: Recording, vehicle: Vehicle):
    def silent(speeds: np.ndarray) -> None:
        speeds[:] = 0.0

    found = findings(with_speeds(hover, silent), vehicle).splitlines()
    assert [one for one in found if "rotor" in one] == [
        "every rotor speed reads 0, no telemetry: rules out identification, prediction and replay"
    ]


def test_all_rotors_reading_half_show_against_thrust(hover: Recording, vehicle: Vehicle):
    spoilt = with_speeds(hover, lambda speeds: np.divide(speeds, 2, out=speeds))
    assert "speeds too low by a constant factor" in findings(spoilt, vehicle)


def test_frozen_rotor_and_frozen_pose(hover: Recording, vehicle: Vehicle):
    def freeze(speeds: np.ndarray) -> None:
        speeds[400:800, 1] = speeds[400, 1]

    position, attitude = hover.pose.position.copy(), hover.pose.attitude.copy()
    position[100:150], attitude[100:150] = position[100], attitude[100]
    spoilt = replace(
        with_speeds(hover, freeze), pose=replace(hover.pose, position=position, attitude=attitude)
    )
    found = findings(spoilt, vehicle)
    assert "topic rotor_speeds: rotor 2 reads 15" in found
    assert "from 0.80 to 1.60 s in flight, without a change" in found
    assert "topic mocap/pose: sample 100: position stays the same for 0.49 s" in found


def test_spikes(hover: Recording, vehicle: Vehicle):
    def spike(speeds: np.ndarray) -> None:
        speeds[[70, 900], 0] = 1e5

    found = findings(with_speeds(hover, spike), vehicle)
    assert "above the vehicle's 2700 rad/s; the first is sample 70" in found


def test_constant_battery(hover: Recording, vehicle: Vehicle):
    spoilt = replace(hover, battery=BatteryStream(hover.imu.time_ns, np.full(SAMPLES, 3.7)))
    assert "battery: the voltage is constant at 3.7 V" in findings(spoilt, vehicle)


def test_missing_topics_say_what_they_rule_out(hover: Recording, vehicle: Vehicle):
    bare = replace(hover, rotor_speeds=None, pose=None, odometry=None)
    assert inspect_recording(bare, vehicle).findings == (
        "no rotor speeds: rules out identification, prediction and replay",
        "neither pose nor odometry: rules out everything that needs velocity or attitude",
    )
    assert "rules out the live estimator" in findings(replace(hover, pose=None), vehicle)


@pytest.mark.filterwarnings("error")
def test_not_finite_and_empty_streams_do_not_stop_the_inspection(hover: Recording, vehicle: Vehicle):
    nan = with_imu(with_speeds(hover, lambda speeds: speeds.fill(np.nan)), specific_force=np.nan)
    assert f"topic imu: {SAMPLES} samples hold a value that is not finite" in findings(nan, vehicle)
    empty = replace(
        hover,
        imu=ImuStream(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3))),
        rotor_speeds=RotorSpeedStream(np.empty(0, np.int64), np.empty((0, 4))),
    )
    assert "topic imu: holds no samples" in findings(empty, vehicle)


IMPLAUSIBLE = {
    "g": (lambda r: with_imu(r, specific_force=1 / 9.81), "topic imu: .*looks like g, m/s² expected"),
    "deg/s, slow": (lambda r: with_imu(r, angular_velocity=180 / np.pi), "topic imu: .*looks like deg/s"),
    "deg/s, fast": (
        lambda r: with_imu(replace(r, pose=None, odometry=None), angular_velocity=200.0),
        r"topic imu: sample \d+: .*are beyond 70 rad/s: looks like deg/s",
    ),
    "milli-g": (lambda r: with_imu(r, specific_force=100.0), "topic imu: .*expected about 9.8"),
    "flu": (
        lambda r: replace(r, imu=replace(r.imu, specific_force=body_frd_to_flu(r.imu.specific_force))),
        "topic imu: .*looks like forward-left-up axes taken for FRD",
    ),
    "rpm": (
        lambda r: with_speeds(r, lambda speeds: np.multiply(speeds, 30 / np.pi, out=speeds)),
        r"topic rotor_speeds: sample 0: 100% of the samples are above .* like rpm, erpm or squared speeds",
    ),
    "revolutions per second": (
        lambda r: with_speeds(r, lambda speeds: np.divide(speeds, 2 * np.pi, out=speeds)),
        "topic rotor_speeds: .*wrong unit or pole pairs",
    ),
    "reversed": (
        lambda r: with_speeds(r, lambda speeds: np.negative(speeds, out=speeds)),
        "topic rotor_speeds: sample 0: 100% of the samples are below zero",
    ),
    "wrong frame": (
        lambda r: replace(r, pose=replace(r.pose, attitude=r.pose.attitude[:, [1, 0, 3, 2]])),
        "topic mocap/pose: attitude and specific force disagree on what is up",
    ),
}


@pytest.mark.parametrize("kind", IMPLAUSIBLE)
def test_implausible_numbers_are_refused_and_found(hover: Recording, vehicle: Vehicle, kind: str):
    spoil, message = IMPLAUSIBLE[kind]
    spoilt = spoil(hover)
    with pytest.raises(LogError, match=rf"hover\.mcap: {message}") as caught:
        check_plausible(spoilt, vehicle)
    assert str(caught.value).removeprefix("hover.mcap: ") in inspect_recording(spoilt, vehicle).findings


@pytest.mark.parametrize(
    ("folder", "vehicle_name", "mapping", "coefficient"),
    [
        ("neurobem", "neurobem", None, 0.0225),
        ("imrc_brushless", "crazyflie_rpm", None, 0.0338),
        ("nanodrone", "nanodrone", "nanodrone", 0.0169),
    ],
)
def test_real_flights_are_plausible(shared_data: Path, folder, vehicle_name, mapping, coefficient):
    vehicle = Vehicle.load(vehicle_name)
    recordings = []
    for path in sorted((shared_data / folder).iterdir()):
        recording = read_recording(path, vehicle, mapping)
        check_plausible(recording, vehicle)
        assert thrust_coefficient(recording, vehicle) == pytest.approx(coefficient, rel=0.03)
        assert "half" not in findings(recording, vehicle)
        recordings.append(recording)
    assert len(set(map(recording_hash, recordings))) == len(recordings)


@pytest.mark.parametrize(("run", "spikes", "first"), [(1, 2, 2502), (4, 3, 2005)])
def test_real_spikes_are_found(shared_data: Path, run: int, spikes: int, first: int):
    vehicle = Vehicle.load("nanodrone")
    path = shared_data / "nanodrone" / f"multisine_20251017_run{run}.parquet"
    found = findings(decode_recording(path, vehicle, "nanodrone"), vehicle)
    assert f"topic rotor_speeds: left out {spikes} of " in found
    assert f"above the vehicle's 3000 rad/s; the first is sample {first}" in found


def test_numbers_without_bound_are_shown_without_a_warning(hover: Recording, vehicle: Vehicle):
    force = hover.imu.specific_force.copy()
    force[10:20] = 1e200
    wild = replace(hover, imu=replace(hover.imu, specific_force=force))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        inspection = inspect_recording(wild, vehicle)
    assert any("beyond" in finding for finding in inspection.findings)


def test_copies_are_recognised_across_conversions(hover: Recording):
    there_and_back = body_flu_to_frd(body_frd_to_flu(hover.imu.specific_force)) * (1.0 + 1e-13)
    copy = replace(
        hover,
        source="copy.mcap",
        name="copy",
        imu=replace(hover.imu, time_ns=hover.imu.time_ns + 5_000_000_000, specific_force=there_and_back),
        rotor_speeds=replace(hover.rotor_speeds, time_ns=hover.rotor_speeds.time_ns + 5_000_000_000),
    )
    assert recording_hash(copy) == recording_hash(hover)


def test_different_flights_are_not_duplicates(hover: Recording):
    other = with_imu(hover, specific_force=1.0 + 1e-5)
    faster = with_speeds(hover, lambda speeds: np.add(speeds, 1.0, out=speeds))
    assert len(set(map(recording_hash, (hover, other, faster)))) == 3


def test_the_hash_is_that_of_the_documented_bytes(hover: Recording):
    """Model folders hold it: stamps in µs since the first sample, then values in single precision."""
    imu, rotors = hover.imu, hover.rotor_speeds
    late = replace(hover, rotor_speeds=replace(rotors, time_ns=rotors.time_ns + 1_999))
    stamps = (imu.time_ns - imu.time_ns[0]) // 1000
    content = (stamps.astype("<i8"), imu.angular_velocity.astype("<f4"), imu.specific_force.astype("<f4"))
    speeds = ((stamps + 1).astype("<i8"), rotors.speeds.astype("<f4"))
    expected = hashlib.sha256(b"".join(part.tobytes() for part in (*content, *speeds))).hexdigest()
    assert recording_hash(late) == expected
    alone = hashlib.sha256(b"".join(part.tobytes() for part in content)).hexdigest()
    assert recording_hash(replace(hover, rotor_speeds=None)) == alone


def test_a_recording_in_parts_has_the_hash_of_the_whole(hover: Recording):
    """More of a column waits for its turn than is held in memory."""
    parts = 60
    whole = replace(
        hover,
        imu=ImuStream.join([hover.imu] * parts),
        rotor_speeds=RotorSpeedStream.join([hover.rotor_speeds] * parts),
    )
    with RunningHash(whole.imu.time_ns, whole.rotor_speeds.time_ns) as running:
        for _ in range(parts):
            running.add(hover)
        assert running.hexdigest() == recording_hash(whole)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 1)), min_size=1, max_size=14), st.data())
def test_the_longest_run_of_equal_rows_is_found_across_parts(rows, data):
    """By trying every run; of equally long ones the first."""
    values = np.array(rows, dtype=float)
    expected = max(
        (
            (first, last)
            for first in range(len(rows))
            for last in range(first, len(rows))
            if len(set(rows[first : last + 1])) == 1
        ),
        key=lambda run: (run[1] - run[0], -run[0]),
    )
    cuts = sorted(data.draw(st.lists(st.integers(0, len(rows)), max_size=4)))
    running = LongestRun()
    for part in np.split(values, cuts):
        running.add(part)
    assert running.longest() == expected


def test_a_range_passes_over_what_is_not_finite():
    running = RunningRange("speed", "m/s")
    running.add(np.array([np.nan, np.nan]))
    assert list(running.ranges()) == []
    for part in ([np.nan, 3.0], [], [-1.0, np.inf, 4.0], [2.0, 8.0]):
        running.add(np.array(part))
    (found,) = running.ranges()
    assert (found.quantity, found.unit) == ("speed", "m/s")
    assert (found.lowest, found.median, found.highest) == (-1.0, 3.0, 8.0)


def test_the_median_of_many_values_is_that_of_some_of_them():
    running, values = RunningRange("speed", "m/s"), np.random.default_rng(0).normal(size=100_000)
    for part in np.split(values, 100):
        running.add(part)
    (found,) = running.ranges()
    assert found.median == pytest.approx(0.0, abs=0.05)
    assert (found.lowest, found.highest) == (values.min(), values.max())
