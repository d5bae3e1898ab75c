# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Sensors whose values are wrong, from the third second of a flight on; see README.md."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.estimator.filter_state import EstimatorStatus, Outcome
from quadpi_core.flight import WindStream
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import codec
from quadpi_core.records import SPECIFIC_FORCE_MAX_M_S2
from quadpi_core.results import BAD_DATA, EXTRAPOLATION, MISCOVERAGE
from quadpi_core.simulation.sensors import Sent
from quadpi_core.vehicle import ROTORS
from test.faults.onboard import deviation

AT_S = 3.0
# An alarm that nothing feeds is cleared after half a second, and said to be so at most a tenth later.
CLEARED_S = 0.62
# From silence to a filter that has begun anew.
STARTED_ANEW_S = 1.01
# Of the half width of an interval: what a fault that is over may still do to predictions.
CLOSE = 0.1


def is_not_finite(value, signal, rotor=None):
    """`altered`'s second argument: 30 samples of one number in a row are not one."""

    def alter(sent, seconds):
        values = getattr(sent.stream, signal).copy()
        column = slice(None) if rotor is None else rotor
        values[(seconds >= AT_S) & (seconds < AT_S + 0.06), column] = value
        return replace(sent, stream=replace(sent.stream, **{signal: values}))

    return alter


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize(
    ("topic", "signal", "rotor"),
    [
        ("imu", "angular_velocity", 1),
        ("imu", "specific_force", None),
        ("rotor_speeds", "speeds", 2),
    ],
)
def test_not_finite(altered, calm, topic, signal, rotor, value):
    flown = altered(topic, is_not_finite(value, signal, rotor))
    assert flown.words(BAD_DATA) == {"sample not finite"}
    first, last = flown.not_ok(BAD_DATA)
    assert first == pytest.approx(AT_S, abs=0.003)
    assert last < AT_S + 0.06 + CLEARED_S
    assert flown.raised(BAD_DATA) == [pytest.approx(AT_S + 0.05, abs=0.01)]
    assert not flown.standing()
    lost = calm.seconds(np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns))
    assert 30 <= len(lost) <= 31
    assert AT_S - 0.003 < lost.min() <= lost.max() < AT_S + 0.063
    assert deviation(flown, calm, AT_S + 0.3) < CLOSE


def test_one_sample_that_is_not_finite_is_a_warning(altered, calm):
    def alter(sent, seconds):
        values = sent.stream.angular_velocity.copy()
        values[int(np.argmax(seconds >= AT_S)), 2] = np.nan
        return replace(sent, stream=replace(sent.stream, angular_velocity=values))

    flown = altered("imu", alter)
    assert flown.words(BAD_DATA) == {"sample not finite"}
    assert flown.raised(BAD_DATA) == []
    assert len(np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns)) == 1


def test_gyro_beyond_what_it_can_measure(failing, calm):
    flown = failing("spike", "imu", AT_S, 0.5, size_rad_s=100.0)
    assert flown.words(BAD_DATA) == {"sample not plausible"}
    assert flown.health["imu"].refused == {"UNUSABLE": 25}
    assert len(np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns)) == 25
    assert flown.not_ok(BAD_DATA)[1] < AT_S + 0.5 + CLEARED_S
    assert deviation(flown, calm, AT_S + 0.6) < CLOSE


def test_imu_that_sends_no_numbers_for_long(failing, calm):
    flown = failing("not_finite", "imu", AT_S, 0.5)
    assert "sample not finite" in flown.words(BAD_DATA)
    assert flown.health["imu"].refused == {"UNUSABLE": 250, "STAMP_JUMPED": 1, "RESET": 1}
    first, last = flown.not_ok(BAD_DATA)
    assert first == pytest.approx(AT_S, abs=0.003)
    assert last < AT_S + 0.5 + STARTED_ANEW_S + CLEARED_S
    assert flown.states(AT_S + 0.51, AT_S + 1.5) == {EstimatorStatus.INITIALISING}
    assert deviation(flown, calm, AT_S + 0.5 + STARTED_ANEW_S + 0.2) < 0.3


def test_motion_capture_that_is_not_finite(failing, calm):
    flown = failing("not_finite", "mocap/pose", AT_S, 0.5)
    assert sum(flown.health["mocap/pose"].refused.values()) + flown.poses[Outcome.UNUSABLE] == 60
    assert flown.states(AT_S + 0.3, AT_S + 0.5) == {EstimatorStatus.DEGRADED}
    assert not flown.alarms.level.any()
    assert deviation(flown, calm, 0.0) < 0.5


def test_wind_that_is_not_finite(sensors, fly_onboard, calm):
    sent = sensors()
    time_ns = sent["imu"].taken_ns[::25]
    velocity = np.zeros((len(time_ns), 3))
    velocity[int(np.argmax(time_ns >= calm.start_ns + round(1e9 * AT_S)))] = np.nan
    flown = fly_onboard(sent | {"wind": Sent(WindStream(time_ns, velocity), time_ns, time_ns)})
    assert flown.words(BAD_DATA) == {"sample not finite"}
    assert flown.not_ok(BAD_DATA)[1] < AT_S + 0.05 + CLEARED_S
    assert deviation(flown, calm, AT_S + 0.2) < CLOSE


@pytest.mark.parametrize(
    ("signal", "words"), [("angular_velocity", "gyro frozen"), ("specific_force", "accelerometer frozen")]
)
def test_frozen_inertial_sensor(failing, calm, signal, words):
    flown = failing("frozen", "imu", AT_S, 0.5, signal=signal)
    assert flown.words(BAD_DATA) == {words}
    assert flown.raised(BAD_DATA) == [pytest.approx(AT_S + 0.1, abs=0.02)]
    assert flown.not_ok(BAD_DATA)[1] < AT_S + 0.5 + CLEARED_S
    assert EstimatorStatus.DEGRADED in flown.states(AT_S, AT_S + 0.6)
    assert flown.states(AT_S + 1.0, 8.0) == {EstimatorStatus.OK}
    np.testing.assert_array_equal(flown.predictions.time_ns, calm.predictions.time_ns)
    assert deviation(flown, calm, AT_S + 1.5) < 0.5


@pytest.mark.parametrize("rotors", [(2,), (1, 2, 3, 4)])
def test_frozen_rotor_speeds(failing, calm, rotors):
    flown = failing("frozen", "rotor_speeds", AT_S, 1.0, rotors=rotors)
    assert {f"rotor {rotor} frozen" for rotor in rotors} <= flown.words(BAD_DATA)
    assert flown.raised(BAD_DATA) == [pytest.approx(AT_S + 0.55, abs=0.02)]
    assert flown.not_ok(BAD_DATA)[1] < AT_S + 1.0 + CLEARED_S
    assert deviation(flown, calm, AT_S + 1.2) < CLOSE


@pytest.mark.parametrize("rotor", range(1, ROTORS + 1))
def test_half_reading_rotor_sensor(failing, calm, rotor):
    flown = failing("half_reading", "rotor_speeds", AT_S, 1.5, rotors=(rotor,))
    assert flown.words(BAD_DATA) == {f"rotor {rotor} jumps", f"rotor {rotor} reads half"}
    first, last = flown.not_ok(BAD_DATA)
    assert first == pytest.approx(AT_S, abs=0.005)
    (raised,) = flown.raised(BAD_DATA)
    assert raised < AT_S + 1.0
    assert last < AT_S + 1.5 + 0.3 + CLEARED_S
    np.testing.assert_array_equal(flown.predictions.time_ns, calm.predictions.time_ns)
    assert deviation(flown, calm, AT_S + 1.7) < CLOSE


@pytest.mark.parametrize("size", [200.0, -500.0])
@pytest.mark.parametrize("rotor", [1, 3])
def test_spiking_rotor_sensor(failing, calm, rotor, size):
    flown = failing("spike", "rotor_speeds", AT_S, 0.5, rotors=(rotor,), size_rad_s=size)
    assert flown.words(BAD_DATA) == {f"rotor {rotor} jumps"}
    assert flown.not_ok(BAD_DATA)[0] == pytest.approx(AT_S, abs=0.005)
    assert flown.not_ok(BAD_DATA)[1] < AT_S + 0.5 + 0.3 + CLEARED_S
    assert deviation(flown, calm, AT_S + 0.7) < CLOSE


def test_rotor_sensor_that_spikes_beyond_what_the_rotor_can(failing, calm):
    flown = failing("spike", "rotor_speeds", AT_S, 0.5, rotors=(1,), size_rad_s=5000.0)
    assert flown.words(BAD_DATA) == {"sample not plausible"}
    assert len(np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns)) in (25, 50)
    assert deviation(flown, calm, AT_S + 0.7) < CLOSE


@pytest.mark.parametrize("rotors", [(1, 2), (1, 3), (2, 3)])
def test_swapped_rotors(failing, rotors):
    """Four plausible speeds: that they contradict the motion is all that can be known of it."""
    flown = failing("swapped", "rotor_speeds", 1.2, 20.0, rotors=rotors, seconds=12.0)
    (raised,) = flown.raised(MISCOVERAGE)
    assert raised < 10.0
    assert any(text.startswith(("roll", "pitch", "yaw")) for text in flown.words(MISCOVERAGE))
    assert flown.words(BAD_DATA) == flown.words(EXTRAPOLATION) == set()


def test_sign_of_quaternions(altered, calm):
    def alter(sent, _):
        signs = np.where(np.arange(len(sent.stream)) % 3 == 0, -1.0, 1.0)[:, None]
        return replace(sent, stream=replace(sent.stream, attitude=signs * sent.stream.attitude))

    flown = altered("mocap/pose", alter)
    assert not flown.alarms.level.any()
    assert flown.health["mocap/pose"].refused == {}
    assert deviation(flown, calm, 0.0) < 1e-6


@pytest.mark.parametrize("norm", [0.0, 0.5, 1.3, 1e300])
def test_quaternions_that_are_not_unit(altered, calm, norm):
    def alter(sent, seconds):
        scale = np.where((seconds >= AT_S) & (seconds < AT_S + 0.5), norm, 1.0)[:, None]
        return replace(sent, stream=replace(sent.stream, attitude=scale * sent.stream.attitude))

    flown = altered("mocap/pose", alter)
    (reason,) = flown.health["mocap/pose"].refused
    assert "the orientation is no unit quaternion" in reason
    assert flown.health["mocap/pose"].refused[reason] == 60
    assert flown.states(AT_S + 0.3, AT_S + 0.5) == {EstimatorStatus.DEGRADED}
    assert flown.states(AT_S + 0.6, 8.0) == {EstimatorStatus.OK}
    assert not flown.alarms.level.any()
    assert deviation(flown, calm, 0.0) < 0.5


def test_every_sensor_at_once(sensors, fly_onboard, calm):
    """Messages of noise and numbers that are none, for a second: no number that is none comes out."""
    rng = np.random.default_rng(1)
    kinds = {
        "imu": sensor_messages.IMU_SAMPLES,
        "rotor_speeds": sensor_messages.rotor_speed_samples(4),
        "mocap/pose": sensor_messages.POSE_SAMPLES,
    }

    def spoil(topic, payloads):
        """What is infinite is so in the message: turned into other axes it would no longer be."""
        own, counts = codec(kinds[topic].type_name), kinds[topic].counts
        time_ns, values = own.decode_stamped(payloads, counts)
        failing = (calm.seconds(time_ns) >= AT_S) & (calm.seconds(time_ns) < AT_S + 1.0)
        noise = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e-300, 0.0, 3.0], values.shape)
        values[failing] = noise[failing]
        return own.encode_stamped(time_ns, values, tuple((name, (0.0,) * n) for name, n in counts.items()))

    flown = fly_onboard(sensors(), spoil)
    assert flown.raised(BAD_DATA) == [pytest.approx(AT_S + 0.05, abs=0.02)]
    assert flown.poses[Outcome.USED] < calm.poses[Outcome.USED]
    assert np.abs(flown.predictions.measured).max() < SPECIFIC_FORCE_MAX_M_S2
    assert flown.not_ok(BAD_DATA)[1] < AT_S + 1.0 + STARTED_ANEW_S + CLEARED_S
    assert not flown.standing()
    assert deviation(flown, calm, AT_S + 1.0 + STARTED_ANEW_S + 0.2) < 0.3
