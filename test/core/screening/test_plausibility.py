# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a noisy attitude may look like, and what no noise explains."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.flight import ImuStream, PoseStream, Recording
from quadpi_core.screening.plausibility import implausibilities

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
