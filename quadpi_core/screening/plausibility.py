# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which topics a recording lacks, and whether its units and axes can be right.

The tests accept unchecked recordings: samples that are not finite are skipped.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, Stamps
from quadpi_core.frames import Array, rotate_body_to_world
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold
from quadpi_core.screening.flight_runs import seldom, seldom_topics
from quadpi_core.screening.rotors_in_flight import Inertial
from quadpi_core.screening.wild_samples import Beyond, beyond_limits
from quadpi_core.signals.chain import interpolate_columns, nominal_rate
from quadpi_core.vehicle import Vehicle

# Rotors of any size lie between the inner bounds; rpm or erpm taken for rad/s is off by a factor above 36.
THRUST_COEFFICIENT_USUAL = (0.006, 0.05)
THRUST_COEFFICIENT_POSSIBLE = (0.001, 0.3)

# Speeds in the air over that of the blades' tips. In hover thrust falls by 3 % up to there; it grows with Σω²
# (by the power 0.7 at 0.09, and 0.35 at 0.12, in a simulated wind tunnel) while the vehicle is slow.
_HOVER_ADVANCE, _SLOW_ADVANCE = 0.01, 0.07
# Shortest hover that is used, and the time over which positions give a speed.
HOVER_S, _SPEED_S = 0.5, 0.2

_SPECIFIC_FORCE_M_S2 = (4.0, 60.0)
_SPECIFIC_FORCE_G = (0.4, 2.5)
_ATTITUDE_STEP_S = 0.05
_TURNING_RAD_S = 0.3
_LARGEST_RATIO = 10.0
# Noise makes an attitude seem to turn at a multiple of the true rate over short steps.
_LARGEST_RATIO_OF_ATTITUDE = 30.0
BESIDE_IMU = Threshold(
    "state beside the IMU",
    0.5,
    "of its samples within the IMU's stamps",
    "of a state that other clocks stamped, most is compared with another part of the flight, or with none",
    CONVENTION,
)
# Over this time the mean acceleration of any vehicle is small beside gravity.
_LONG_S = 5.0
_MEAN_UP_G = (0.5, 1.5)
# Samples further apart no longer show the dynamics of rotors and airframe.
_SLOWEST_IMU_HZ = 50.0
# A nominal rate may be measured lower by this factor.
_RATE_MARGIN = 0.9


def missing_topics(recording: Recording) -> Iterator[str]:
    """One sentence for each absent topic, or too slow IMU, with the uses that it rules out."""
    if recording.rotor_speeds is None and recording.commands is not None:
        yield "no rotor speeds: `identify` makes them of the motor commands of the log itself"
    elif recording.rotor_speeds is None:
        yield "no rotor speeds: rules out identification, prediction and replay"
    elif not np.any(recording.rotor_speeds.speeds):
        yield "every rotor speed reads 0, no telemetry: rules out identification, prediction and replay"
    mocap = recording.pose or recording.twist
    if mocap is None and recording.odometry is None:
        yield "neither pose nor odometry: rules out everything that needs velocity or attitude"
    elif mocap is None:
        yield "no motion-capture pose: the state is the logged odometry; rules out the live estimator"
    if len(recording.imu) > 1:
        with np.errstate(divide="ignore"):  # stamps that all repeat are reported elsewhere
            rate_hz = nominal_rate(recording.imu.time_ns)
        if rate_hz < _RATE_MARGIN * _SLOWEST_IMU_HZ:
            reason = "too slow for the dynamics of rotors and airframe"
            yield seldom("imu", rate_hz, _SLOWEST_IMU_HZ, reason, recording.remedies)
    yield from seldom_topics(recording)
    for stream in recording.streams():
        if len(stream) == 1:
            yield f"{stream.topic} has a single sample: rules out all that needs it"


def check_plausible(
    recording: Recording, vehicle: Vehicle, beyond: Mapping[str, Sequence[Beyond]] | None = None
) -> None:
    """Refuse a recording whose units or axes cannot be right; arguments as of :func:`implausibilities`.

    Raises:
        LogError: naming file and topic, and what the numbers look like.
    """
    recording.require_rotors(vehicle.name, vehicle.rotor_count)
    for problem in implausibilities(recording, vehicle, beyond):
        raise LogError(f"{recording.source}: {problem}")


def implausibilities(
    recording: Recording, vehicle: Vehicle | None, beyond: Mapping[str, Sequence[Beyond]] | None = None
) -> Iterator[str]:
    """Sentences that say which units or axes cannot be right; each begins with the topic.

    Args:
        recording: the whole flight, or parts spread over it.
        vehicle: that flew; without one its limits are not tested.
        beyond: by topic, the samples beyond limits in the whole flight; by default, in the recording.
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
    return np.all([np.isfinite(values).all(axis=tuple(range(1, values.ndim))) for values in signals], axis=0)


def thrust_coefficient(recording: Recording, vehicle: Vehicle, *, in_hover: bool = False) -> float | None:
    """Thrust coefficient C_T = thrust / (ρ π R⁴ Σω²) of rotors that turn fast; None where they do not fly.

    The thrust is mass times specific force. Real rotors have about 0.01 to 0.04 in hover.

    Args:
        recording: a flight.
        vehicle: that flew.
        in_hover: only where the vehicle is slow; None if it is for less than HOVER_S, or no state tells.
    """
    turning = _turning(recording, vehicle)
    if turning is None:
        return None
    time_ns, squares, force = turning
    if in_hover:
        advance = _advance(recording, vehicle, time_ns, squares)
        hovers = advance < _HOVER_ADVANCE
        if np.sum(hovers) < HOVER_S * nominal_rate(time_ns):
            return None
        squares, force = squares[hovers], force[hovers]
    disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    total = disc * np.sum(squares**2)
    return float(vehicle.mass_kg * np.sum(force * squares) / total) if total > 0.0 else None


def is_slow(recording: Recording, vehicle: Vehicle) -> bool:
    """Whether a vehicle mostly flies so slowly that its thrust grows with the squares of the rotor speeds."""
    turning = _turning(recording, vehicle)
    if turning is None:
        return False
    return float(np.median(_advance(recording, vehicle, *turning[:2]))) < _SLOW_ADVANCE


def _turning(recording: Recording, vehicle: Vehicle) -> tuple[Stamps, Array, Array] | None:
    """Stamps, Σω² [rad²/s²] and specific force upward [m/s²] while rotors turn fast; None on the ground."""
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
    used = squares >= 0.5 * np.percentile(squares, 95)
    if Inertial.from_recording(recording).stands(int(time_ns[used].min()), int(time_ns[used].max())):
        return None
    return time_ns[used], squares[used], force[used]


def _advance(recording: Recording, vehicle: Vehicle, time_ns: Stamps, squares: Array) -> Array:
    """Speed in the air over that of the blades' tips (N,), from positions; infinite where no state tells."""
    state, wind = recording.pose or recording.odometry, recording.wind
    if state is None or np.all(state.deviation[:, 0] < 0.0):
        return np.full(len(squares), np.inf)
    clock, at = ((stamps - state.time_ns[0]) * 1e-9 for stamps in (state.time_ns, time_ns))
    half_s = 0.5 * _SPEED_S
    moved = interpolate_columns(clock, state.position, at + half_s)
    moved -= interpolate_columns(clock, state.position, at - half_s)
    if wind is not None and len(wind):
        moved -= _SPEED_S * interpolate_columns(wind.time_ns, wind.velocity, time_ns)
    within = (at >= half_s) & (at <= clock[-1] - half_s)
    speed = np.where(within, np.linalg.norm(moved, axis=1) / _SPEED_S, np.inf)
    return np.asarray(speed / (vehicle.rotor_radius_m * 0.5 * np.sqrt(np.maximum(squares, 1.0))))


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
        turns = f"topic imu: the gyro turns at {gyro:.3g} rad/s while {stream.topic} turns at"
        if gyro > _TURNING_RAD_S and not np.any(stream.attitude != stream.attitude[0]):
            yield (
                f"topic {stream.topic}: the attitude is the same in every sample while the gyro turns at "
                f"{gyro:.3g} rad/s: it is not measured, or of a body that does not move"
            )
        elif gyro > _TURNING_RAD_S and gyro > _LARGEST_RATIO * attitude:
            yield f"{turns} {attitude:.3g}: looks like deg/s"
        elif turning > _TURNING_RAD_S and turning > _LARGEST_RATIO_OF_ATTITUDE * gyro:
            yield f"{turns} {turning:.3g}: looks like rad/s taken for deg/s, or a wrong unit of time"


def _attitude_streams(recording: Recording) -> Iterator[PoseStream | OdometryStream]:
    """States that are there while the IMU is; `clock_consistency` judges other stamps."""
    imu_ns = recording.imu.time_ns
    for stream in (recording.pose, recording.odometry):
        if stream is None or len(stream) < 2 or len(imu_ns) == 0:
            continue
        together = (stream.time_ns >= imu_ns.min()) & (stream.time_ns <= imu_ns.max())
        if np.mean(together) >= BESIDE_IMU.value:
            yield stream.take(together)


def _rotation_rates(imu: ImuStream, stream: PoseStream | OdometryStream) -> tuple[float, float, float]:
    """Median turn rates [rad/s] over short steps: of gyro, attitude, and attitude without noise."""
    known = finite_rows(imu.angular_velocity) & np.r_[True, np.diff(imu.time_ns) > 0]
    seen = finite_rows(stream.attitude) & np.r_[True, np.diff(stream.time_ns) > 0] & _beside(imu, stream)
    if known.sum() < 2 or seen.sum() < 2:
        return 0.0, 0.0, 0.0
    time, rates = imu.time_ns[known] * 1e-9, imu.angular_velocity[known]
    angle = np.zeros_like(rates)
    angle[1:] = np.cumsum(0.5 * (rates[1:] + rates[:-1]) * np.diff(time)[:, np.newaxis], axis=0)
    clock, attitude = stream.time_ns[seen] * 1e-9, stream.attitude[seen]
    spacing = max(float(np.median(np.diff(clock))), 1e-9)
    short, long = (slice(None, None, max(1, round(n * _ATTITUDE_STEP_S / spacing))) for n in (1, 2))
    turned = np.diff(interpolate_columns(time, angle, clock[short]), axis=0)

    def median_rate(turns: Array, times: Array) -> float:
        return float(np.median(turns / np.diff(times))) if len(turns) else 0.0

    by_gyro = median_rate(np.linalg.norm(turned, axis=1), clock[short])
    by_short, by_long = (median_rate(_turned(attitude[s]), clock[s]) for s in (short, long))
    # Over twice the step, noise contributes half the rate, and the motion the same.
    return by_gyro, by_short, math.sqrt(max(4.0 * by_long**2 - by_short**2, 0.0) / 3.0)


def _beside(imu: ImuStream, stream: PoseStream | OdometryStream) -> npt.NDArray[np.bool_]:
    """The samples (N,) of a state for whose time there are samples of the IMU: clocks may be years apart."""
    return np.asarray((stream.time_ns >= imu.time_ns[0]) & (stream.time_ns <= imu.time_ns[-1]))


def _turned(attitude: Array) -> Array:
    """Angle (N - 1,) [rad] from each attitude (N, 4) to the next."""
    cosine = np.abs(np.sum(attitude[1:] * attitude[:-1], axis=1)).clip(max=1.0)
    return np.asarray(2.0 * np.arccos(cosine))


def _up(recording: Recording) -> Iterator[str]:
    """The mean specific force in the world must be about minus gravity: it must point up."""
    imu = recording.imu
    known = finite_rows(imu.specific_force)
    if not np.any(known):
        return
    force = imu.specific_force[known]
    for stream in _attitude_streams(recording):
        seen = finite_rows(stream.attitude) & _beside(imu, stream)
        if not np.any(seen):
            continue
        nearest = np.searchsorted(imu.time_ns[known], stream.time_ns[seen]).clip(0, len(force) - 1)
        up = -float(np.mean(rotate_body_to_world(stream.attitude[seen], force[nearest])[:, 2]))
        low, high = _MEAN_UP_G
        if up < 0.3 * np.median(np.linalg.norm(force, axis=1)):
            yield f"topic {stream.topic}: attitude and specific force disagree on what is up: wrong frames?"
        elif np.ptp(stream.time_ns) > _LONG_S * 1e9 and not low < up / STANDARD_GRAVITY < high:
            yield (
                f"topic imu: the mean specific force points up at {up:.3g} m/s², expected about 9.8: wrong "
                f"unit, or gravity counted twice?"
            )


def _units(beyond: Mapping[str, Sequence[Beyond]]) -> Iterator[str]:
    """Topics with more samples beyond a limit than outliers can explain."""
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
