# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the numbers of a recording can be what they are said to be: units, axes, rotor speeds.

Every test works on recordings that are not checked: samples that are not finite are left out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording
from quadpi_core.frames import Array
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.screening.wild_samples import Beyond, beyond_limits
from quadpi_core.units import STANDARD_GRAVITY
from quadpi_core.vehicle import Vehicle

# Rotors of any size lie between the inner bounds; rpm or erpm taken for rad/s is off by a factor above 36.
THRUST_COEFFICIENT_USUAL = (0.006, 0.05)
THRUST_COEFFICIENT_POSSIBLE = (0.001, 0.3)

_SPECIFIC_FORCE_M_S2 = (4.0, 60.0)
_SPECIFIC_FORCE_G = (0.4, 2.5)
_ATTITUDE_STEP_S = 0.05
_TURNING_RAD_S = 0.3
_LARGEST_RATIO = 10.0
# Short steps of an attitude that is noisy seem to turn at a multiple of the true rate.
_LARGEST_RATIO_OF_ATTITUDE = 30.0
# Over this time no vehicle gains so much speed that its mean specific force is far from gravity's.
_LONG_S = 5.0
_MEAN_UP_G = (0.5, 1.5)


def check_plausible(
    recording: Recording, vehicle: Vehicle, beyond: Mapping[str, Sequence[Beyond]] | None = None
) -> None:
    """Refuse a recording whose units or axes cannot be right; arguments as of :func:`implausibilities`.

    Raises:
        LogError: naming file and topic, and what the numbers look like.
    """
    for problem in implausibilities(recording, vehicle, beyond):
        raise LogError(f"{recording.source}: {problem}")


def implausibilities(
    recording: Recording, vehicle: Vehicle | None, beyond: Mapping[str, Sequence[Beyond]] | None = None
) -> Iterator[str]:
    """What cannot be right, in plain words, the topic first.

    Args:
        recording: all of the flight, or parts spread over it.
        vehicle: that flew; without one its limits are not tested.
        beyond: by topic, what is beyond limits in all of the flight; of the recording unless given.
    """
    if beyond is None:
        beyond = {stream.topic: list(beyond_limits(stream, vehicle)) for stream in recording.streams()}
    yield from _specific_force(recording.imu)
    yield from _units(beyond)
    yield from _rates(recording)
    yield from _up(recording)
    if vehicle is not None and recording.rotor_speeds is not None:
        yield from _thrust(recording, vehicle)


def finite_rows(*signals: Array) -> npt.NDArray[np.bool_]:
    """Rows (N,) in which every signal is finite."""
    finite: npt.NDArray[np.bool_] = np.all(
        [np.isfinite(values).all(axis=tuple(range(1, values.ndim))) for values in signals], axis=0
    )
    return finite


def share(flags: npt.NDArray[np.bool_]) -> float:
    """Share of samples (N,) that are set; zero where there are none."""
    return float(np.count_nonzero(flags) / max(len(flags), 1))


def thrust_coefficient(recording: Recording, vehicle: Vehicle) -> float | None:
    """C_T = thrust / (ρ π R⁴ Σω²), thrust from the accelerometer, while the rotors turn fast; None without.

    Hover of a real rotor gives about 0.01 to 0.04.
    """
    imu, rotors = recording.imu, recording.rotor_speeds
    if rotors is None:
        return None
    measured = finite_rows(rotors.speeds)
    measured[measured] = np.all(rotors.speeds[measured] <= vehicle.rotor_speed_spike_rad_s, axis=1)
    speeds, time_ns = rotors.speeds[measured], rotors.time_ns[measured]
    known = finite_rows(imu.specific_force)
    if len(speeds) == 0 or not np.any(known):
        return None
    squares = np.sum(speeds**2, axis=1)
    order = np.argsort(imu.time_ns[known], kind="stable")
    force = np.interp(time_ns, imu.time_ns[known][order], -imu.specific_force[known, 2][order])
    fast = squares >= 0.5 * np.percentile(squares, 95)
    disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    total = disc * np.sum(squares[fast] ** 2)
    return float(vehicle.mass_kg * np.sum(force[fast] * squares[fast]) / total) if total > 0.0 else None


def _specific_force(imu: ImuStream) -> Iterator[str]:
    force = imu.specific_force[finite_rows(imu.specific_force)]
    if len(force) == 0:
        return
    median = float(np.median(np.linalg.norm(force, axis=1)))
    low, high = _SPECIFIC_FORCE_M_S2
    if _SPECIFIC_FORCE_G[0] < median < _SPECIFIC_FORCE_G[1]:
        yield f"topic imu: the median specific force is {median:.2f}: looks like g, m/s² expected"
    elif not low < median < high:
        yield f"topic imu: the median specific force is {median:.3g} m/s², expected about 9.8"
    elif float(np.median(force[:, 2])) > low:
        yield "topic imu: specific force points down in flight: looks like forward-left-up axes taken for FRD"


def _rates(recording: Recording) -> Iterator[str]:
    for stream in _attitude_streams(recording):
        gyro, attitude, turning = _rotation_rates(recording.imu, stream)
        if gyro > _TURNING_RAD_S and gyro > _LARGEST_RATIO * attitude:
            yield (
                f"topic imu: the gyro turns at {gyro:.3g} rad/s while {stream.topic} turns at "
                f"{attitude:.3g}: looks like deg/s"
            )
        elif turning > _TURNING_RAD_S and turning > _LARGEST_RATIO_OF_ATTITUDE * gyro:
            yield (
                f"topic imu: the gyro turns at {gyro:.3g} rad/s while {stream.topic} turns at "
                f"{turning:.3g}: looks like rad/s taken for deg/s, or a wrong unit of time"
            )


def _attitude_streams(recording: Recording) -> Iterator[PoseStream | OdometryStream]:
    for stream in (recording.pose, recording.odometry):
        if stream is not None and len(stream) > 1:
            yield stream


def _rotation_rates(imu: ImuStream, stream: PoseStream | OdometryStream) -> tuple[float, float, float]:
    """Median turn rate [rad/s] over short steps: by the gyro, by the attitude, by that less its noise."""
    known = finite_rows(imu.angular_velocity) & np.r_[True, np.diff(imu.time_ns) > 0]
    seen = finite_rows(stream.attitude) & np.r_[True, np.diff(stream.time_ns) > 0]
    if known.sum() < 2 or seen.sum() < 2:
        return 0.0, 0.0, 0.0
    time, rates = imu.time_ns[known] * 1e-9, imu.angular_velocity[known]
    angle = np.zeros_like(rates)
    angle[1:] = np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(time)[:, np.newaxis], axis=0)
    clock, attitude = stream.time_ns[seen] * 1e-9, stream.attitude[seen]
    spacing = max(float(np.median(np.diff(clock))), 1e-9)
    short, long = (slice(None, None, max(1, round(n * _ATTITUDE_STEP_S / spacing))) for n in (1, 2))
    turned = np.diff(np.stack([np.interp(clock[short], time, column) for column in angle.T], axis=1), axis=0)
    by_gyro = _median(np.linalg.norm(turned, axis=1) / np.diff(clock[short]))
    by_short, by_long = (_median(_turned(attitude[s]) / np.diff(clock[s])) for s in (short, long))
    # Over twice the step, noise turns half as fast and the vehicle as fast as before.
    return by_gyro, by_short, math.sqrt(max(4.0 * by_long**2 - by_short**2, 0.0) / 3.0)


def _turned(attitude: Array) -> Array:
    """Angle (N - 1,) [rad] from each attitude (N, 4) to the next."""
    cosine = np.abs(np.sum(attitude[1:] * attitude[:-1], axis=1)).clip(max=1.0)
    angle: Array = 2.0 * np.arccos(cosine)
    return angle


def _median(values: Array) -> float:
    """0 of none."""
    return float(np.median(values)) if len(values) else 0.0


def _up(recording: Recording) -> Iterator[str]:
    """Turned into the world and averaged, specific force is minus gravity: it must point up."""
    imu = recording.imu
    known = finite_rows(imu.specific_force)
    if not np.any(known):
        return
    force = imu.specific_force[known]
    for stream in _attitude_streams(recording):
        seen = finite_rows(stream.attitude)
        nearest = np.searchsorted(imu.time_ns[known], stream.time_ns[seen]).clip(0, len(force) - 1)
        in_world = rotate_body_to_world(stream.attitude[seen], force[nearest])
        if not np.any(seen):
            continue
        up = -float(np.mean(in_world[:, 2]))
        low, high = _MEAN_UP_G
        if up < 0.3 * np.median(np.linalg.norm(force, axis=1)):
            yield f"topic {stream.topic}: attitude and specific force disagree on what is up: wrong frames?"
        elif np.ptp(stream.time_ns) > _LONG_S * 1e9 and not low < up / STANDARD_GRAVITY < high:
            yield (
                f"topic imu: the mean specific force points up at {up:.3g} m/s², expected about 9.8: wrong "
                f"unit, or gravity counted twice?"
            )


def _units(beyond: Mapping[str, Sequence[Beyond]]) -> Iterator[str]:
    """Topics with more samples beyond their limits than could be left out as outliers."""
    for topic, all_found in beyond.items():
        for found in all_found:
            if found.unit is not None and found.share > found.most:
                yield (
                    f"topic {topic}: sample {found.first}: {found.share:.0%} of the samples are "
                    f"{found.limit}: looks like {found.unit}"
                )


def _thrust(recording: Recording, vehicle: Vehicle) -> Iterator[str]:
    coefficient = thrust_coefficient(recording, vehicle)
    low, high = THRUST_COEFFICIENT_POSSIBLE
    if coefficient is not None and not low < coefficient < high:
        yield (
            f"topic rotor_speeds: thrust over Σω² gives C_T = {coefficient:.2g}, expected 0.01 to 0.04: "
            f"wrong unit or pole pairs of the rotor speeds, or another vehicle?"
        )
