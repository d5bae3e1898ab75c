# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One pass of the causal filter gives the live samples and what the smoother needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core import recording_blocks
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.smoother import smooth
from quadpi_core.flight import ImuStream
from quadpi_core.identification.prepared_flights import CausalPass
from quadpi_core.signals.resample import nominal_rate
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("neurobem")


@pytest.fixture
def short_blocks(monkeypatch):
    monkeypatch.setattr(recording_blocks, "BLOCK_SAMPLES", 700)


@pytest.mark.usefixtures("short_blocks")
def test_smoothing_after_the_live_pass_gives_the_same_bits(fly, vehicle):
    recording = fly(0)
    shared = CausalPass.over(recording, vehicle).segments
    own = Ekf(vehicle, nominal_rate(recording.imu.time_ns)).segments(recording)
    assert shared is not None
    for one, other in zip(smooth(recording.imu, shared).rows, smooth(recording.imu, own).rows, strict=True):
        assert one.tobytes() == other.tobytes()


def test_a_rate_that_changes_is_not_shared(fly, vehicle):
    """Live, the filter starts again at the new rate; the smoother bridges it."""
    recording = fly(0)
    imu = recording.imu
    every_other = np.arange(len(imu) // 2, len(imu), 2)
    rows = np.concatenate((np.arange(len(imu) // 2), every_other))
    slower = ImuStream(imu.time_ns[rows], imu.angular_velocity[rows], imu.specific_force[rows])
    assert CausalPass.over(replace(recording, imu=slower, arrivals={}), vehicle).segments is None


def test_without_motion_capture_there_is_nothing_to_smooth(fly, vehicle):
    recording = fly(0)
    states = Ekf(vehicle).run(recording).fused.odometry
    passed = CausalPass.over(replace(recording, pose=None, odometry=states), vehicle)
    assert passed.segments is None
    assert sum(len(part.samples.time_ns) for part in passed.parts) > 0
