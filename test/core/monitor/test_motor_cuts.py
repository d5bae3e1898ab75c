# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Through estimator, pairing and monitor: motor cuts are stopped rotors, zeros of the telemetry never."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from quadpi_core.flight import Recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.alarm_log import reasons
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.replay import follow, open_flight, recorded_flight
from quadpi_core.results import BAD_DATA, LEVEL_ALARM
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.sensors import sense
from quadpi_core.simulation.simulated_bags import fly_plan
from quadpi_core.vehicle import Vehicle
from test.core.monitor.motor_cuts import FLOWN_S, with_motor_cut

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "model"
BEBOP = SimulatedVehicle.load("bebop2")
MOMENTS_S = (2.5, 4.7, 7.3, 9.1, 11.6)


class Row(NamedTuple):
    seconds: float
    causes: int
    words: tuple[str, ...]


@pytest.fixture(scope="module")
def model() -> AerodynamicModel:
    return AerodynamicModel.load(GOLDEN)


@pytest.fixture(scope="module")
def truth():
    plans = {plan.name: plan for plan in load_scenario("bundled").flights}
    return fly_plan(plans["interpolation"], BEBOP)


def sensed(truth, seed: int) -> Recording:
    return sense(truth, BEBOP.vehicle, SensorSuite.load("paper"), {}, (), seed).recording


def alarm_rows(model: AerodynamicModel, recording: Recording) -> Iterator[Row]:
    """The rows at alarm level, with seconds since the first IMU sample."""
    monitor = Monitor(model, BEBOP.vehicle, None)
    for part in follow(recorded_flight(recording, BEBOP.vehicle), BEBOP.vehicle):
        monitor.retune(part.rate)
        _, alarms, _ = monitor.step(*part.samples)
        for row in np.flatnonzero(alarms.level == LEVEL_ALARM):
            seconds = 1e-9 * float(alarms.time_ns[row] - recording.imu.time_ns[0])
            yield Row(seconds, int(alarms.causes[row]), reasons(alarms, row))


def with_telemetry(recording: Recording, rotor: int, at_s: float, telemetry: str) -> Recording:
    rotors = recording.rotor_speeds
    assert rotors is not None
    speeds = rotors.speeds.copy()
    after = 1e-9 * (rotors.time_ns - recording.imu.time_ns[0]) >= at_s
    if telemetry == "reads 0":
        speeds[after, rotor] = 0.0
    elif telemetry == "is not finite":
        speeds[after, rotor] = np.nan
    elif telemetry == "goes on":
        noise = np.random.default_rng(rotor).normal(0.0, 2.0, np.sum(after))
        speeds[after, rotor] = speeds[np.argmax(after) - 1, rotor] + noise
    return replace(recording, rotor_speeds=replace(rotors, speeds=speeds))


@pytest.mark.slow
@pytest.mark.parametrize("telemetry", ["measures", "goes on", "reads 0", "is not finite"])
def test_motor_cuts_are_stopped_rotors_within_0_3_s(model, truth, telemetry: str):
    found = 0
    for at_s in MOMENTS_S:
        for rotor in range(4):
            recording = sensed(with_motor_cut(truth, BEBOP, rotor, at_s), seed=rotor)
            rows = list(alarm_rows(model, with_telemetry(recording, rotor, at_s, telemetry)))
            named = [row for row in rows if any("stopped" in word for word in row.words)]
            # A sample without a reading cannot be predicted; once the rotor has stopped, it is not missed.
            said = named if telemetry == "is not finite" else rows
            assert not any(row.causes & BAD_DATA for row in said if row.seconds < at_s + FLOWN_S)
            right = bool(named) and f"rotor {rotor + 1} stopped" in named[0].words
            found += right and at_s < named[0].seconds < at_s + 0.3
    assert found >= 19


@pytest.mark.slow
@pytest.mark.parametrize(
    ("telemetry", "words"), [("reads 0", "rotor {} reads 0"), ("is not finite", "sample not finite")]
)
def test_telemetry_that_fails_alone_is_no_stopped_rotor(model, truth, telemetry: str, words: str):
    recording = sensed(truth, seed=1)
    for at_s in MOMENTS_S:
        for rotor in range(4):
            rows = list(alarm_rows(model, with_telemetry(recording, rotor, at_s, telemetry)))
            assert not any("stopped" in word for row in rows for word in row.words)
            named = next(row for row in rows if words.format(rotor + 1) in row.words)
            assert at_s < named.seconds < at_s + 0.3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "vehicle"),
    [
        *(("imrc_brushless", "crazyflie_rpm"), ("imrc_brushed", "crazyflie_rpm")),
        *(("neurobem", "neurobem"), ("indiflight", "indiflight")),
    ],
)
def test_no_rotor_stops_on_real_flights(model, shared_data, folder: str, vehicle: str):
    """Dead sensors among them; a hover speed is all that the model is needed for."""
    the_vehicle = Vehicle.load(vehicle)
    for path in sorted((shared_data / folder).iterdir()):
        with open_flight(path, the_vehicle) as flight:
            parts = list(follow(flight, the_vehicle))
        speeds = np.concatenate([part.samples.rotor_speeds for part in parts])
        hover = float(np.sqrt(np.median(np.sort(speeds, axis=1)[:, 2] ** 2)))
        assert hover > 0.0
        limits = replace(model.alarm_limits, hover_rotor_speed=hover)
        flown = replace(model, vehicle=the_vehicle.name, vehicle_fingerprint=the_vehicle.fingerprint)
        monitor = Monitor(replace(flown, alarm_limits=limits), the_vehicle, None)
        for part in parts:
            monitor.retune(part.rate)
            assert not np.any(monitor.step(*part.samples)[1].stopped), path.name
