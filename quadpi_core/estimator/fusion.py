# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Turn the sensor streams of a recording into a flight: estimated state, one time grid, one low-pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quadpi_core.errors import LogError, SignalError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import Segment, smooth
from quadpi_core.findings import Break, DataQuality, LeftOut
from quadpi_core.flight import (
    MAX_GAP_NS,
    Flight,
    Recording,
    RotorSpeedStream,
    Stamps,
    Stream,
    WindStream,
    mean_rate_hz,
)
from quadpi_core.frames import Array
from quadpi_core.records import Threshold
from quadpi_core.screening.flight_runs import pauses, seldom_topics
from quadpi_core.screening.rotors_in_flight import carrying
from quadpi_core.signals.chain import (
    Mask,
    filter_zero_phase,
    first_gap,
    interpolate,
    interpolate_attitude,
    nominal_rate,
    uniform_stamps,
)
from quadpi_core.vehicle import Vehicle

EDGE_PERIODS = Threshold(
    "time beside a pause of the rotor speeds that is left out with it",
    1.0,
    "periods of the cut-off",
    "a pause is bridged by a line before the low-pass; so far from one of up to 0.5 s it changes the "
    "filtered speeds by 0.3 rad/s at most, beside it by 5, of a spread of 50",
    "pauses cut into three real flights of two Crazyflies",
)
COMMANDS_ALONE = "it has motor commands, from which `quadpi identify` makes them"
_TOO_FEW = "one sample is too few"


class Estimate(NamedTuple):
    """State and IMU biases at stamps (M,); position in the world, velocity in body axes."""

    time_ns: Stamps
    position: Array
    attitude: Array
    velocity: Array
    gyro_bias: Array
    accelerometer_bias: Array
    biases_estimated: bool = True


def fuse(
    recording: Recording, vehicle: Vehicle, cutoff_hz: float, segments: Sequence[Segment] | None = None
) -> Flight:
    """Estimate the state, resample all streams to the nominal grid of the IMU, and apply one low-pass to all.

    With motion capture, the state and the IMU biases come from the smoother of the EKF; without it, the state
    comes from the recorded odometry and the biases are taken as zero. The estimated biases vary over time as
    a random walk whose intensity is in the vehicle file; they are subtracted from the IMU samples.

    The flight covers the time in which all streams have samples and the estimator is initialised. Where the
    rotor speeds pause, the estimate goes on, and the flight has no samples; its `quality` says so. Wind is
    optional: still air without it, and its first and last sample hold before and after its stream.

    Args:
        recording: with the streams that :func:`require_streams` asks for.
        vehicle: gives sensor noise and gravity.
        cutoff_hz: of the fourth-order Butterworth low-pass, applied forward and backward
            (:func:`quadpi_core.signals.chain.zero_phase`).
        segments: record of the EKF over this recording, if it has run already.

    Raises:
        LogError: naming the topic that is missing, or pauses for more than 0.1 s and is not the rotor
            speeds, or if the streams do not overlap in time.
        SignalError: if the estimator never starts, or the cut-off is not below half the sample rate.
    """
    imu, rotor_speeds = recording.imu, require_streams(recording)
    estimate = _estimate(recording, vehicle, segments)

    grid = uniform_stamps(imu.time_ns)
    start_ns = max(estimate.time_ns[0], rotor_speeds.time_ns[0])
    end_ns = min(estimate.time_ns[-1], rotor_speeds.time_ns[-1])
    grid = grid[(grid >= start_ns) & (grid <= end_ns)]
    if len(grid) == 0:
        raise LogError(f"{recording.source}: the estimate and topic rotor_speeds share no time")

    speeds, known = interpolate(rotor_speeds.time_ns, rotor_speeds.speeds, grid, MAX_GAP_NS)

    def on_grid(time_ns: Stamps, values: Array) -> Array:
        return interpolate(time_ns, values, grid, MAX_GAP_NS).values

    rates = on_grid(imu.time_ns, imu.angular_velocity) - on_grid(estimate.time_ns, estimate.gyro_bias)
    specific_force = on_grid(imu.time_ns, imu.specific_force) - on_grid(
        estimate.time_ns, estimate.accelerometer_bias
    )
    try:
        filtered = filter_zero_phase(
            on_grid(estimate.time_ns, estimate.velocity),
            interpolate_attitude(estimate.time_ns, estimate.attitude, grid, MAX_GAP_NS).values,
            rates,
            specific_force,
            speeds,
            _wind(recording.wind, grid),
            rate_hz=nominal_rate(grid),
            cutoff_hz=cutoff_hz,
        )
    except SignalError as error:
        raise SignalError(f"{recording.source}: {error}") from error
    flight = Flight(
        name=recording.name,
        vehicle=recording.vehicle,
        source=recording.source,
        start_ns=int(grid[0]),
        time=1e-9 * (grid - grid[0]),
        position=on_grid(estimate.time_ns, estimate.position),
        quality=recording.quality,
        biases_estimated=estimate.biases_estimated,
        position_measured=recording.pose is not None or recording.twist is None,
        motors=vehicle.motors if recording.commanded else None,
        **filtered._asdict(),
    )
    pause = pauses(rotor_speeds)
    return flight if pause is None else _without(flight, known, pause, imu.time_ns, cutoff_hz)


def _without(flight: Flight, known: Mask, pause: Break, imu_ns: Stamps, cutoff_hz: float) -> Flight:
    """A flight without the samples around which rotor speeds are not known; `quality` says so."""
    # Slow to import, and most flights have no pause.
    from scipy.ndimage import binary_erosion

    edge = round(EDGE_PERIODS.value * mean_rate_hz(flight.time) / cutoff_hz)
    known = binary_erosion(known, np.ones(2 * edge + 1), border_value=1)
    if not np.any(known):
        raise LogError(f"{flight.source}: topic rotor_speeds: nothing is known between its pauses")
    unknown = np.flatnonzero(~known)
    first_ns = flight.start_ns + round(1e9 * flight.time[unknown[0]])
    left_out = LeftOut(
        "imu",
        "while the rotor speeds pause",
        len(unknown),
        len(known),
        int(np.searchsorted(imu_ns, first_ns)),
        1e-9 * float(first_ns - imu_ns[0]),
    )
    quality = flight.quality.joined(DataQuality(left_out=(left_out,), breaks=(pause,)))
    return replace(flight.slice(known), quality=quality)


def require_streams(recording: Recording) -> RotorSpeedStream:
    """Check that a recording has the streams that :func:`fuse` needs, and return its rotor speeds.

    Raises:
        LogError: naming the topic that is missing or comes too seldom, or pauses for more than 0.1 s and is
            not the rotor speeds.
    """
    recording.check()
    rotor_speeds = recording.rotor_speeds
    if rotor_speeds is None:
        alone = f"; {COMMANDS_ALONE}" if recording.commands is not None else ""
        raise LogError(
            f"{recording.source}: topic rotor_speeds is missing, which every kind of model needs{alone}"
        )
    for seldom in seldom_topics(recording):
        raise LogError(f"{recording.source}: topic {seldom}")
    if len(rotor_speeds) < 2:
        raise LogError(f"{recording.source}: topic {rotor_speeds.topic}: {_TOO_FEW}")
    _require_no_gap(recording.source, recording.imu)
    if recording.pose is None and recording.twist is None:
        if recording.odometry is None:
            raise LogError(f"{recording.source}: topics mocap/pose and odometry are missing: one is needed")
        _require_no_gap(recording.source, recording.odometry)
    return rotor_speeds


def fuse_airborne(
    recording: Recording, vehicle: Vehicle, cutoff_hz: float, segments: Sequence[Segment] | None = None
) -> Flight:
    """:func:`fuse`, then :func:`airborne`: the part of a flight in the air; raises what they raise."""
    return airborne(fuse(recording, vehicle, cutoff_hz, segments), vehicle.gravity_m_s2)


def airborne(flight: Flight, gravity: float) -> Flight:
    """The flight from lift-off to touch-down; on the ground the wrench is not aerodynamic.

    Raises:
        LogError: naming the file, if the rotors never carry the vehicle.
    """
    flying = np.flatnonzero(carrying(flight.rotor_speeds, -flight.specific_force[:, 2], gravity))
    if len(flying) == 0:
        raise LogError(f"{flight.source}: topic rotor_speeds: the rotors never carry the vehicle")
    return flight.slice(slice(int(flying[0]), int(flying[-1]) + 1))


def _estimate(recording: Recording, vehicle: Vehicle, segments: Sequence[Segment] | None) -> Estimate:
    odometry = recording.odometry
    if recording.pose is not None or recording.twist is not None or odometry is None:
        if segments is None:
            segments = Ekf(vehicle, nominal_rate(recording.imu.time_ns)).segments(recording)
        smoothed = smooth(recording.imu, segments)
        return Estimate(
            smoothed.time_ns,
            smoothed.position,
            smoothed.attitude,
            smoothed.velocity_body,
            smoothed.gyro_bias,
            smoothed.accelerometer_bias,
        )
    no_bias = np.zeros((len(odometry), 3))
    return Estimate(
        odometry.time_ns, odometry.position, odometry.attitude, odometry.velocity, no_bias, no_bias, False
    )


def _wind(wind: WindStream | None, grid: Stamps) -> Array:
    """Wind (M, 3) m/s on the grid, interpolated across gaps of any length, as it changes slowly."""
    if wind is None:
        return np.zeros((len(grid), 3))
    return interpolate(wind.time_ns, wind.velocity, grid, np.iinfo(np.int64).max).values


def _require_no_gap(source: str, stream: Stream) -> None:
    if len(stream) < 2:
        raise LogError(f"{source}: topic {stream.topic}: {_TOO_FEW}")
    index = first_gap(stream.time_ns, MAX_GAP_NS)
    if index is not None:
        pause = 1e-9 * float(stream.time_ns[index] - stream.time_ns[index - 1])
        raise LogError(
            f"{source}: topic {stream.topic}: sample {index}: comes {pause:.3f} s after the one before; "
            f"pauses above {1e-9 * MAX_GAP_NS:g} s cannot be bridged"
        )
