# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What sensors report instead of what happens."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, RotorSpeedStream, WindStream
from quadpi_core.simulation.applied_effects import EFFECTS, altered_recording, read_effects
from quadpi_core.vehicle import Vehicle

SENSOR = [effect for effect in EFFECTS.values() if effect.kind == "sensor"]
EACH = pytest.mark.parametrize("effect", SENSOR, ids=lambda effect: effect.name)
STREAMS = ("imu", "rotor_speeds", "pose", "odometry", "wind")
# What each alters; an effect that is not here may alter anything.
ALTERS = {
    "imu_lever_arm": {"imu": {"specific_force"}},
    "imu_misalignment": {"imu": {"specific_force", "angular_velocity"}},
    "accelerometer_scale": {"imu": {"specific_force"}},
    "accelerometer_bias": {"imu": {"specific_force"}},
    "gyro_bias": {"imu": {"angular_velocity"}},
    "rotor_speed_scale": {"rotor_speeds": {"speeds"}},
    "sensor_delay": {"rotor_speeds": {"time_ns"}, "pose": {"time_ns"}, "odometry": {"time_ns"}},
}


@pytest.fixture
def recording():
    rng = np.random.default_rng(1)
    imu_ns, pose_ns = (10**9 + np.arange(0, 10**9, step) for step in (2_000_000, 8_333_333))
    attitude = rng.normal(size=(len(pose_ns), 4))

    def noise(time_ns, columns=3):
        return rng.normal(size=(len(time_ns), columns))

    return Recording(
        name="test",
        vehicle="bebop2",
        source="test",
        imu=ImuStream(imu_ns, noise(imu_ns), noise(imu_ns)),
        rotor_speeds=RotorSpeedStream(imu_ns, 700.0 + noise(imu_ns, 4)),
        pose=PoseStream(pose_ns, noise(pose_ns), attitude / np.linalg.norm(attitude, axis=1, keepdims=True)),
        odometry=OdometryStream(pose_ns, noise(pose_ns), attitude, noise(pose_ns), noise(pose_ns)),
        wind=WindStream(imu_ns, noise(imu_ns)),
    )


def altered(recording, name, **parameters):
    return altered_recording(read_effects({name: parameters}, "test"), recording, Vehicle.load("bebop2"))


def differing(before, after):
    """Names of the arrays that differ, by stream."""
    found = {}
    for stream in STREAMS:
        old, new = getattr(before, stream), getattr(after, stream)
        if old is None:
            assert new is None
            continue
        names = {
            f.name for f in fields(old) if not np.array_equal(getattr(old, f.name), getattr(new, f.name))
        }
        if names:
            found[stream] = names
    return found


def copy(recording):
    streams = {
        name: type(stream)(**{f.name: getattr(stream, f.name).copy() for f in fields(stream)})
        for name in STREAMS
        if (stream := getattr(recording, name)) is not None
    }
    return replace(recording, **streams)


@EACH
def test_alters_what_it_should_and_nothing_else(effect, recording):
    original = copy(recording)
    after = altered(recording, effect.name)
    after.check()
    found = differing(recording, after)
    assert found == ALTERS.get(effect.name, found) != {}
    assert differing(original, recording) == {}


@EACH
def test_zero_strength_changes_nothing(effect, recording):
    zero = {p.name: 0.0 if p.lowest <= 0.0 else p.default for p in effect.parameters}
    assert differing(recording, altered(recording, effect.name, **zero)) == {}


@EACH
def test_streams_that_are_not_there_are_not_missed(effect, recording):
    alone = replace(recording, rotor_speeds=None, pose=None, odometry=None, wind=None)
    altered(alone, effect.name).check()


def test_bias_is_added_after_the_scale(recording):
    effects = {
        "accelerometer_bias": {"x_m_s2": 1.0, "y_m_s2": 2.0, "z_m_s2": 3.0},
        "accelerometer_scale": None,
    }
    after = altered_recording(read_effects(effects, "test"), recording, Vehicle.load("bebop2"))
    expected = 1.02 * recording.imu.specific_force + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(after.imu.specific_force, expected)


def test_a_turned_imu_reports_the_same_vectors_in_its_axes(recording):
    after = altered(recording, "imu_misalignment", x_deg=0.0, y_deg=0.0, z_deg=30.0).imu
    # Its x axis points 30° to the right of the body's.
    cosine, sine = np.cos(np.radians(30.0)), np.sin(np.radians(30.0))
    for name in ("angular_velocity", "specific_force"):
        x, y, z = getattr(recording.imu, name).T
        expected = np.stack((cosine * x + sine * y, cosine * y - sine * x, z), axis=1)
        np.testing.assert_allclose(getattr(after, name), expected, atol=1e-12)
    small = altered(recording, "imu_misalignment", x_deg=0.01, y_deg=-0.02, z_deg=0.03).imu
    force = recording.imu.specific_force
    expected = force + np.cross(force, np.radians([0.01, -0.02, 0.03]))
    np.testing.assert_allclose(small.specific_force, expected, atol=2e-6)


def test_lever_arm_in_a_spin_feels_the_centripetal_force(recording):
    spin = replace(recording.imu, angular_velocity=np.tile([0.0, 0.0, 10.0], (len(recording.imu), 1)))
    after = altered(replace(recording, imu=spin), "imu_lever_arm", x_m=0.02, y_m=0.0, z_m=0.0)
    added = after.imu.specific_force - recording.imu.specific_force
    np.testing.assert_allclose(added, np.tile([-2.0, 0.0, 0.0], (len(added), 1)), atol=1e-12)


def test_lever_arm_follows_the_rigid_body(recording):
    time = 1e-9 * (recording.imu.time_ns - recording.imu.time_ns[0])
    frequency = np.array([6.0, 9.0, 4.0])
    rates = np.array([3.0, 2.0, 5.0]) * np.sin(np.outer(time, frequency))
    acceleration = np.array([3.0, 2.0, 5.0]) * frequency * np.cos(np.outer(time, frequency))
    arm = np.array([0.02, -0.01, 0.03])
    expected = np.cross(acceleration, arm) + np.cross(rates, np.cross(rates, arm))
    swinging = replace(recording, imu=replace(recording.imu, angular_velocity=rates))
    after = altered(swinging, "imu_lever_arm", x_m=arm[0], y_m=arm[1], z_m=arm[2])
    added = after.imu.specific_force - recording.imu.specific_force
    np.testing.assert_allclose(added[1:-1], expected[1:-1], atol=1e-3)
    np.testing.assert_allclose(added, expected, atol=1e-2)


def test_delay_stamps_the_same_values_later(recording):
    after = altered(recording, "sensor_delay", rotor_speeds_s=0.0125, mocap_s=0.03)
    assert np.all(after.rotor_speeds.time_ns - recording.rotor_speeds.time_ns == 12_500_000)
    for stream in ("pose", "odometry"):
        assert np.all(getattr(after, stream).time_ns - getattr(recording, stream).time_ns == 30_000_000)


def test_one_rotor_reads_half_or_all_read_more(recording):
    before = recording.rotor_speeds.speeds
    half = altered(recording, "rotor_speed_scale", rotor=3, change=-0.5).rotor_speeds.speeds
    np.testing.assert_allclose(half / before, np.tile([1.0, 1.0, 0.5, 1.0], (len(before), 1)))
    np.testing.assert_allclose(altered(recording, "rotor_speed_scale").rotor_speeds.speeds, 1.02 * before)
