# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Time of one IMU sample in the core, called from Python as the nodes do, without ROS.

A step is the prediction of the EKF, its state, pairing with the rotor speeds, low-pass, inputs, six axes of
one method with their bounds, and the alarm.

No baseline shares the disturbances of the machine. So the methods fly in turns, and the figure is the lowest
median of a turn; the highest is reported beside it.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks import Result
from benchmarks.swings import IMU_HZ, VEHICLE, swings, three_models
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.flight import Recording
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs.bags import write_bag
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.monitor.monitor import Monitor, Monitors
from quadpi_core.monitor.pairing import Pairing
from quadpi_core.vehicle import Vehicle

NAMES = ("core_step_us",)

FLOWN_S = 10.0
TURNS = 7


def run() -> list[Result]:
    vehicle = Vehicle.load(VEHICLE)
    recording = swings(vehicle, FLOWN_S)
    with tempfile.TemporaryDirectory() as folder:
        models = three_models(Path(folder), vehicle)
        bags = [Path(folder) / f"{k}.mcap" for k in range(2)]
        for k, bag in enumerate(bags):
            write_bag(bag, swings(vehicle, seed=k))
        models["physical"] = identify(
            prepare_flights(bags, vehicle),
            vehicle,
            load_pools("quadrotor"),
            IdentifyOptions(method="physical"),
        )
    turns = [
        {method: microseconds(model, vehicle, recording) for method, model in models.items()}
        for _ in range(TURNS)
    ]
    medians, calmest = [], []
    for method in models:
        steps, poses = min((turn[method] for turn in turns), key=lambda times: float(np.median(times[0])))
        calmest.append(float(np.median(steps)))
        most = max(float(np.median(turn[method][0])) for turn in turns)
        medians.append(
            f"{method}: median {calmest[-1]:.0f} to {most:.0f} in {TURNS} turns, "
            f"p99 {np.quantile(steps, 0.99):.0f}, correction by a pose {np.median(poses):.0f}"
        )
    return [Result(NAMES[0], max(calmest), "µs", "; ".join(medians), goal=10.0, at_most=True)]


def microseconds(model: AerodynamicModel, vehicle: Vehicle, recording: Recording) -> tuple[Array, Array]:
    """How long each step after the first second takes, and each correction by a pose."""
    imu, poses, rotors = recording.imu, recording.pose, recording.rotor_speeds
    assert poses
    assert rotors
    ekf, pairing = Ekf(vehicle, IMU_HZ), Pairing()
    monitors = Monitors({"model": Monitor(model, vehicle, IMU_HZ)})
    steps, corrections = [], []
    pose = 0
    for k in range(len(imu)):
        while pose < len(poses) and poses.time_ns[pose] < imu.time_ns[k]:
            arguments = int(poses.time_ns[pose]), poses.position[pose], poses.attitude[pose]
            start = time.perf_counter_ns()
            ekf.update_pose(*arguments)
            corrections.append(time.perf_counter_ns() - start)
            pose += 1
        time_ns, gyro, force = int(imu.time_ns[k]), imu.angular_velocity[k], imu.specific_force[k]
        speeds = rotors.speeds[k]
        start = time.perf_counter_ns()
        sample = ekf.step(time_ns, gyro, force).fused
        if sample is None:
            continue
        pairing.add_estimate(time_ns, sample.motion, monitors.paired(pairing))
        completed = pairing.add_rotor_speeds(time_ns, speeds, monitors.paired(pairing))
        if not isinstance(completed, tuple):
            # The rate of the IMU has become known: it is what the monitor was made for.
            pairing.take()
            continue
        monitors.judged(completed)
        steps.append(time.perf_counter_ns() - start)
    return np.array(steps[1:]) / 1e3, np.array(corrections) / 1e3
