# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a noisy attitude may look like, what no noise explains, and topics that come too seldom."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.errors import LogError
from quadpi_core.estimator.fusion import require_streams
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.logs import read_recording
from quadpi_core.logs.readers import log_formats
from quadpi_core.monitor.replay import follow, recorded_flight
from quadpi_core.screening.flight_runs import parts_without_pause
from quadpi_core.screening.plausibility import (
    BESIDE_IMU,
    implausibilities,
    missing_topics,
    thrust_coefficient,
)
from quadpi_core.vehicle import Vehicle

RATE_HZ, FLOWN_S = 200, 20.0
NOISE_RAD = 0.01


@pytest.fixture
def yawing():
    """yawing(swing [rad], gyro_scale) → a recording of yaw at 0.3 Hz, its attitude noisy."""

    def of(swing, gyro_scale=1.0):
        rng = np.random.default_rng(0)
        time = np.arange(int(RATE_HZ * FLOWN_S)) / RATE_HZ
        time_ns = np.round(1e9 * time).astype(np.int64)
        turning = 2.0 * np.pi * 0.3
        rates, half = np.zeros((len(time), 3)), 0.5 * rng.normal(0.0, NOISE_RAD, (len(time), 3))
        rates[:, 2] = gyro_scale * swing * turning * np.cos(turning * time)
        rates += rng.normal(0.0, 1e-3, rates.shape)
        half[:, 2] += 0.5 * swing * np.sin(turning * time)
        attitude = np.column_stack((np.sqrt(1.0 - np.sum(half**2, axis=1)), half))
        force = np.tile([0.0, 0.0, -9.81], (len(time), 1))
        return Recording(
            name="yawing",
            vehicle="bebop2",
            source="test",
            imu=ImuStream(time_ns, rates, force),
            pose=PoseStream(time_ns, np.zeros((len(time), 3)), attitude),
        )

    return of


def test_noise_of_an_attitude_at_rest_is_no_turning(yawing):
    assert list(implausibilities(yawing(0.0), None)) == []


def test_turning_through_noise_is_held_against_the_gyro(yawing):
    assert list(implausibilities(yawing(0.4), None)) == []
    (problem,) = implausibilities(yawing(0.4, np.pi / 180.0), None)
    assert "looks like rad/s taken for deg/s" in problem


def hover(force, *, tilt_rad=None, gyro=0.0, turning=0.0, seconds=20.0, rate_hz=RATE_HZ):
    """A steady specific force (3,) m/s² and gyro [rad/s]; with an attitude, tilted and turning, if given."""
    time = np.arange(int(rate_hz * seconds)) / rate_hz
    time_ns, none = np.round(1e9 * time).astype(np.int64), np.zeros((len(time), 3))
    pose = None
    if tilt_rad is not None:
        turned = Rotation.from_euler("x", tilt_rad) * Rotation.from_euler("z", (turning * time)[:, None])
        pose = PoseStream(time_ns, none, turned.as_quat(scalar_first=True))
    imu = ImuStream(time_ns, none + np.array([0.0, 0.0, gyro]), none + force)
    return Recording(name="hover", vehicle="bebop2", source="test", imu=imu, pose=pose)


def said(recording, vehicle=None):
    return " ".join(implausibilities(recording, vehicle))


@pytest.mark.parametrize(
    ("up_m_s2", "words"),
    [
        (0.39, "expected about 9.8"),
        (0.41, "looks like g"),
        (2.49, "looks like g"),
        (2.51, "expected about 9.8"),
        (3.9, "expected about 9.8"),
        (4.1, ""),
        (59.0, ""),
        (61.0, "expected about 9.8"),
        (-3.99, "expected about 9.8"),
        (-4.1, "points down in flight: looks like forward-left-up"),
    ],
)
def test_a_specific_force_is_gs_or_metres_per_second_squared_and_points_up(up_m_s2, words):
    found = said(hover([0.0, 0.0, -up_m_s2]))
    assert words in found
    assert bool(found) == bool(words)


@pytest.mark.parametrize(
    ("up_m_s2", "seconds", "doubted"),
    [(4.8, 6.0, True), (5.0, 6.0, False), (14.6, 6.0, False), (14.8, 6.0, True), (14.8, 4.9, False)],
)
def test_over_five_seconds_the_mean_specific_force_is_half_to_one_and_a_half_g(up_m_s2, seconds, doubted):
    found = said(hover([0.0, 0.0, -up_m_s2], tilt_rad=0.0, seconds=seconds))
    assert ("gravity counted twice" in found) == doubted


@pytest.mark.parametrize(("share", "doubted"), [(0.29, True), (0.31, False)])
def test_less_than_0_3_of_the_specific_force_upward_is_another_frame(share, doubted):
    found = said(hover([0.0, 0.0, -9.8], tilt_rad=np.arccos(share), seconds=3.0))
    assert ("disagree on what is up" in found) == doubted


@pytest.mark.parametrize(
    ("gyro", "turning", "words"),
    [
        (3.0, 0.31, ""),
        (3.0, 0.29, "looks like deg/s"),
        (0.29, 0.01, ""),
        (0.31, 0.01, "looks like deg/s"),
        (0.29, 0.0, ""),
        (0.31, 0.0, "the attitude is the same in every sample"),
        (0.1, 2.9, ""),
        (0.1, 3.1, "looks like rad/s taken for deg/s"),
        (0.009, 0.29, ""),
        (0.009, 0.31, "looks like rad/s taken for deg/s"),
    ],
)
def test_gyro_and_attitude_differ_by_ten_or_thirty_where_something_turns(gyro, turning, words):
    found = said(hover([0.0, 0.0, -9.8], tilt_rad=0.0, gyro=gyro, turning=turning))
    assert words in found
    assert bool(found) == bool(words)


@pytest.mark.parametrize(
    ("coefficient", "doubted"), [(0.0009, True), (0.0011, False), (0.29, False), (0.31, True)]
)
def test_a_thrust_coefficient_of_no_rotor_is_doubted(coefficient, doubted):
    vehicle = Vehicle.load("bebop2")
    recording = hover([0.0, 0.0, -9.8])
    disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    speed = np.sqrt(vehicle.mass_kg * 9.8 / (4.0 * disc * coefficient))
    vehicle = replace(vehicle, rotor_speed_max_rad_s=2.0 * speed)
    rotors = RotorSpeedStream(recording.imu.time_ns, np.full((len(recording.imu), 4), speed))
    # A vehicle that does not turn at all stands on a bench.
    assert thrust_coefficient(replace(recording, rotor_speeds=rotors), vehicle) is None
    sway = 0.1 * np.sin(6.0e-9 * recording.imu.time_ns)[:, np.newaxis]
    recording = replace(
        recording,
        rotor_speeds=rotors,
        imu=replace(recording.imu, angular_velocity=recording.imu.angular_velocity + sway),
    )
    assert thrust_coefficient(recording, vehicle) == pytest.approx(coefficient)
    assert ("wrong unit or pole pairs" in said(recording, vehicle)) == doubted


@pytest.mark.parametrize(("rate_hz", "slow"), [(44.0, True), (46.0, False)])
def test_an_imu_of_less_than_nine_tenths_of_50_hz_is_too_slow(rate_hz, slow):
    sentences = list(missing_topics(hover([0.0, 0.0, -9.8], rate_hz=rate_hz)))
    assert any("too slow" in sentence for sentence in sentences) == slow


def test_a_topic_of_one_sample_is_named():
    recording = hover([0.0, 0.0, -9.8], tilt_rad=0.0)
    one = replace(recording, pose=PoseStream(*(column[:1] for column in vars(recording.pose).values())))
    assert "mocap/pose has a single sample: rules out all that needs it" in list(missing_topics(one))


@pytest.mark.parametrize(
    ("late_s", "judged"), [(0.0, True), (9.9, True), (10.1, False), (40.0, False), (-40.0, False)]
)
def test_turning_is_compared_where_most_of_a_state_is_beside_the_imu(late_s, judged):
    recording = hover([0.0, 0.0, -9.8], tilt_rad=0.0, gyro=3.0, turning=0.1)
    late = replace(recording.pose, time_ns=recording.pose.time_ns + round(1e9 * late_s))
    assert bool(said(replace(recording, pose=late))) == judged
    assert BESIDE_IMU.value == 0.5


BAG = Path(__file__).parents[3] / "bags" / "train_1.mcap"
BEBOP = Vehicle.load("bebop2")
USES = "rules out identification, prediction and replay, which need"


@pytest.fixture(scope="module")
def flown() -> Recording:
    return read_recording(BAG, Vehicle.load("bebop2"))


def at(recording: Recording, topic: str, rate_hz: float, jitter_s: float = 0.004) -> Recording:
    """A recording with a topic at another rate; odometry stands for the poses."""
    if topic == "odometry":
        pose = recording.pose
        state = OdometryStream(
            pose.time_ns, pose.position, pose.attitude, 0.0 * pose.position, 0.0 * pose.position
        )
        recording = replace(recording, pose=None, odometry=state)
    stream = getattr(recording, topic)
    seconds = 1e-9 * (stream.time_ns - stream.time_ns[0])
    due = np.arange(0.0, seconds[-1], 1.0 / rate_hz)
    due += np.random.default_rng(0).uniform(0.0, jitter_s, len(due))
    rows = np.unique(np.searchsorted(seconds, due))
    return replace(recording, **{topic: stream.take(rows)}, arrivals={}, remedies={stream.topic: "set MORE"})


@pytest.mark.parametrize(
    ("topic", "rate_hz", "said"),
    [
        ("pose", 0.5, f"mocap/pose at 0.499 Hz: {USES} 0.9 Hz or more (in longer pauses an estimate drifts"),
        ("odometry", 0.5, f"odometry at 0.499 Hz: {USES} 0.9 Hz or more"),
        ("rotor_speeds", 4.0, f"rotor_speeds at 4 Hz: {USES} 12 Hz or more"),
    ],
)
def test_a_topic_that_comes_too_seldom_is_named_with_what_to_set(flown, topic, rate_hz, said):
    slow = at(flown, topic, rate_hz)
    (sentence,) = [one for one in missing_topics(slow) if USES in one]
    assert sentence.startswith(said)
    assert sentence.endswith("; set MORE")
    assert parts_without_pause(slow) == [slow]
    with pytest.raises(LogError, match=f"^{BAG}: topic ") as refusal:
        require_streams(slow)
    assert sentence in str(refusal.value)


def test_a_replay_says_it_too(flown):
    begin_ns = flown.imu.time_ns[0]
    streams = {name: getattr(flown, name) for name in ("imu", "rotor_speeds", "pose")}
    begun = {name: stream.take(stream.time_ns < begin_ns + 4 * 10**9) for name, stream in streams.items()}
    slow = at(replace(flown, **begun), "pose", 0.6)
    with pytest.raises(LogError, match=r"topic mocap/pose at 0\.6\d* Hz: rules out"):
        list(follow(recorded_flight(slow, BEBOP), BEBOP))


@pytest.mark.parametrize(("topic", "rate_hz"), [("pose", 5.0), ("odometry", 5.0), ("rotor_speeds", 30.0)])
def test_faster_topics_are_not_named(flown, topic, rate_hz):
    assert not [one for one in missing_topics(at(flown, topic, rate_hz)) if USES in one]


def test_formats_of_autopilots_name_what_to_set():
    named = {one.description.split(" ")[0]: one.remedies for one in log_formats() if one.remedies}
    assert {"PX4", "ArduPilot", "Betaflight", "Crazyflie", "MAVLink", "bag"} <= named.keys()
    assert "DSHOT_TEL_CFG" in named["PX4"]["rotor_speeds"]
    assert "SDLOG_PROFILE" in named["PX4"]["odometry"]
    assert "LOG_BITMASK" in named["ArduPilot"]["odometry"]
    assert "blackbox_sample_rate" in named["Betaflight"]["rotor_speeds"]
    assert "MAV_CMD_SET_MESSAGE_INTERVAL" in named["MAVLink"]["odometry"]
