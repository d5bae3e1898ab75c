# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights prepared for a fit: one causal pass for live samples and smoother, and files that are refused."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core import reading_options
from quadpi_core.errors import LogError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import smooth
from quadpi_core.estimator.fusion import fuse
from quadpi_core.flight import ImuStream
from quadpi_core.identification.prepared_flights import CausalPass, prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.parallel import Workers
from quadpi_core.signals.chain import nominal_rate
from quadpi_core.vehicle import Vehicle

from ..dragged_flights import CUTOFF_HZ


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("neurobem")


@pytest.fixture
def short_blocks(monkeypatch):
    monkeypatch.setattr(reading_options, "BLOCK_SAMPLES", 700)


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


def test_height_is_above_the_origin(dragged_paths, dragged_flights, vehicle):
    down = read_recording(dragged_paths[0], vehicle).pose.position[:, 2]
    assert dragged_flights[0].height.max() == pytest.approx(-down.min(), abs=0.05)
    assert dragged_flights[0].height.min() == pytest.approx(-down.max(), abs=0.05)


def test_a_copy_of_a_flight_is_refused(dragged_paths, vehicle, tmp_path):
    copy = shutil.copy(dragged_paths[0], tmp_path / "copy.mcap")
    with pytest.raises(LogError, match=rf"{copy}: the same flight as {dragged_paths[0]}"):
        prepare_flights([*dragged_paths[:2], copy], vehicle, CUTOFF_HZ)


@pytest.mark.slow
def test_a_cluster_prepares_the_same_flights(dragged_paths, vehicle, dragged_flights, cluster):
    for own, theirs in zip(
        dragged_flights,
        prepare_flights(dragged_paths, vehicle, CUTOFF_HZ, workers=Workers(scheduler=cluster)),
        strict=True,
    ):
        assert (own.name, own.sha256) == (theirs.name, theirs.sha256)
        for name in ("time", "inputs", "wrench", "height"):
            np.testing.assert_array_equal(getattr(own, name), getattr(theirs, name))


def test_flight_of_another_vehicle_is_refused(dragged_paths):
    with pytest.raises(
        LogError, match=rf"{dragged_paths[0]}: is a flight of vehicle neurobem, not of bebop2"
    ):
        prepare_flights(dragged_paths[:1], Vehicle.load("bebop2"), CUTOFF_HZ)


@pytest.mark.slow
def test_whole_fast_neurobem_flight_is_in_the_air(shared_data, vehicle):
    """It hovers before it races: by the median of its rotor speeds, the hover would pass for the ground."""
    path = shared_data / "neurobem" / "bemnn20210218172600seg1.mat"
    prepared = prepare_flights([path], vehicle, 30.0)[0]
    assert len(prepared.time) == len(fuse(read_recording(path, vehicle), vehicle, 30.0))


def test_a_rotor_that_drops_out_costs_what_it_did_not_measure(shared_data):
    """Ten times for 0.1 to 0.5 s in 14.6 s, and some hundred times for less."""
    (flight,) = prepare_flights(shared_data / "imrc_brushed" / "jana20", Vehicle.load("crazyflie_rpm"))
    assert (len(flight.time), flight.time[-1]) == (6187, pytest.approx(14.59, abs=0.01))
    assert np.mean(flight.live.known) > 0.8
    assert any("left out 1206 of 7393 samples while" in text for text in flight.quality.sentences())
