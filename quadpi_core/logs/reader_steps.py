# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that log readers share: stamps and attitudes, and states that autopilots log in separate messages."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.findings import LeftOut, UnusableReports, Verdict
from quadpi_core.flight import (
    MAX_GAP_NS,
    NO_STAMP,
    NOT_MEASURED,
    ImuStream,
    OdometryStream,
    RotorSpeedStream,
    Stamps,
)
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.records import NORM_TOLERANCE
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.screening.plausibility import finite_rows
from quadpi_core.screening.sample_order import longest, order_of
from quadpi_core.signals.chain import interpolate, interpolate_attitude
from quadpi_core.vehicle import ROTORS, Vehicle

_log = logging.getLogger(__name__)
# Longest pause across which signals of separate messages are interpolated: three usual intervals of the
# topic, at most a second [ns], and never less than MAX_GAP_NS.
_GAP_INTERVALS, _GAP_NS = 3, 1_000_000_000


def note(source: str, text: str) -> None:
    """Warn the user of something that the import of a log did or assumed."""
    _log.warning("%s: %s", source, text)


def by_frame(
    source: str, vehicle: Vehicle | None, layout: str = "", unit: str | None = None, rotors: int = ROTORS
) -> RotorOrder:
    """The order of the motors of a standard frame, of the usual one unless given.

    Raises:
        LogError: naming the log, if the vehicle's rotors do not sit as the frame's do.
    """
    try:
        return RotorOrder.by_layout(vehicle, layout, unit, rotors)
    except LogError as error:
        raise LogError(f"{source}: {error}") from error


def order_of_commands(
    source: str, vehicle: Vehicle | None, layout: str = "", rotors: int = ROTORS
) -> RotorOrder | None:
    """:func:`by_frame` for commands, which few need: where the vehicle does not fit, a note says so."""
    try:
        return by_frame(source, vehicle, layout, rotors=rotors)
    except LogError as error:
        note(source, f"topic motor_commands: left out: {str(error).removeprefix(f'{source}: ')}")
        return None


def finite_parameters(logged: Mapping[str, Any]) -> dict[str, float]:
    """The parameters of an autopilot that are numbers; one that is damaged is as if it were not logged."""
    numbers = {name: float(value) for name, value in logged.items() if isinstance(value, int | float)}
    return {name: value for name, value in numbers.items() if np.isfinite(value)}


def unsigned_speeds(source: str, speeds: Array) -> Array:
    """Rotor speeds (N, 4) without the sign of the sense of rotation that some logs give them; a note says so.

    A single negative value of a rotor that reads positive is no such sign, and stays.
    """
    turning = np.where(np.isfinite(speeds), speeds, 0.0)
    signed = np.sum(turning < 0.0, axis=0) > np.sum(turning > 0.0, axis=0)
    if np.any(signed):
        rotors = ", ".join(str(number + 1) for number in np.flatnonzero(signed))
        note(
            source, f"topic rotor_speeds: negative of rotor {rotors}, by the sense of rotation: without sign"
        )
    return np.where(signed, 0.0 - speeds, speeds)


def require_imu(source: str, imu: ImuStream | None, needed: str) -> ImuStream:
    """The IMU stream.

    Raises:
        LogError: for a log without one, naming the messages that would hold it.
    """
    if imu is None or len(imu) == 0:
        raise LogError(f"{source}: topic imu: the log holds no samples of gyro and accelerometer ({needed})")
    return imu


def odometry_of(
    time_ns: Stamps,
    position: Array,
    velocity_world: Array,
    attitude: tuple[Stamps, Array],
    imu: ImuStream,
) -> OdometryStream | None:
    """Odometry from position, velocity and attitude in separate messages; None where they do not overlap.

    Args:
        time_ns: (N,) of position and velocity.
        position: (N, 3) m, NED.
        velocity_world: (N, 3) m/s, NED.
        attitude: stamps (K,) and quaternions (K, 4), FRD to NED; rising stamps.
        imu: gives the rates.
    """
    if len(time_ns) == 0 or len(attitude[0]) == 0:
        return None
    turned = interpolate_attitude(*attitude, time_ns, _longest_gap_ns(attitude[0]))
    imu_ns, (gyro,) = rising(imu.time_ns, imu.angular_velocity)
    rates = interpolate(imu_ns, gyro, time_ns, _longest_gap_ns(imu_ns))
    both = turned.valid & rates.valid
    if not np.any(both):
        return None
    unit = turned.values[both]
    velocity = rotate_world_to_body(unit, velocity_world[both])
    return OdometryStream(time_ns[both], position[both], unit, velocity, rates.values[both])


def attitude_alone(attitude: tuple[Stamps, Array] | None, imu: ImuStream) -> OdometryStream | None:
    """Odometry of a log that has no position or velocity; None without an attitude.

    Args:
        attitude: stamps (K,) and quaternions (K, 4), FRD to NED; rising stamps.
        imu: gives the rates.
    """
    if attitude is None:
        return None
    nothing = np.zeros((len(attitude[0]), 3))
    return without_parts(
        odometry_of(attitude[0], nothing, nothing, attitude, imu), position=True, velocity=True
    )


def without_parts(
    odometry: OdometryStream | None, *, position: bool, velocity: bool
) -> OdometryStream | None:
    """The states, position or velocity of which were not measured."""
    if odometry is not None:
        odometry.deviation[:] = [NOT_MEASURED if position else 0.0, 0.0, NOT_MEASURED if velocity else 0.0]
    return odometry


def _longest_gap_ns(time_ns: Stamps) -> int:
    """Longest interval of a topic (N,) that is no pause."""
    usual_ns = float(np.median(np.diff(time_ns))) if len(time_ns) > 1 else 0.0
    return int(np.clip(_GAP_INTERVALS * usual_ns, MAX_GAP_NS, _GAP_NS))


def unit_attitudes(source: str, topic: str, time_ns: Stamps, quaternion: Array) -> tuple[Stamps, Array]:
    """Stamps (M,) and unit quaternions (M, 4) of those (N, 4) that are; how many are none, a note says."""
    is_unit = has_attitude(source, topic, quaternion)
    kept, (unit,) = rising(time_ns[is_unit], normalised_attitude(quaternion[is_unit]))
    return kept, unit


def has_attitude(source: str, topic: str, quaternion: Array) -> npt.NDArray[np.bool_]:
    """Which quaternions (N, 4) have about unit length (N,); how many have not, a note says."""
    is_unit: npt.NDArray[np.bool_] = np.abs(np.linalg.norm(quaternion, axis=1) - 1.0) <= NORM_TOLERANCE
    if not np.all(is_unit):
        note(source, f"topic {topic}: {np.count_nonzero(~is_unit)} of {len(is_unit)} have no attitude")
    return is_unit


def rising(time_ns: Stamps, *columns: Array) -> tuple[Stamps, tuple[Array, ...]]:
    """The samples, by rising stamps, of signals that a stream is put together of, or that only `info` shows.

    They are used or dropped by the rule of :mod:`quadpi_core.screening.sample_order`.
    """
    runs = order_of(time_ns, {"": ~finite_rows(*columns)}).runs()
    kept = runs[longest(time_ns, runs)]
    return time_ns[kept], tuple(values[kept] for values in columns)


def rotors_together(
    controllers: Sequence[tuple[Stamps, Array]], order: RotorOrder, vehicle: Vehicle | None
) -> RotorSpeedStream | None:
    """Rotor speeds of controllers that are logged separately, at the stamps of the one with most samples.

    A controller reads 0 between two samples of which one does: no rotor passes through all speeds in between.

    Args:
        controllers: stamps (K,) and speeds (K, 1) of each, in the vehicle's rotor order; rising stamps.
        order: says the unit.
        vehicle: see :meth:`RotorOrder.speeds`.
    """
    if any(len(time_ns) == 0 for time_ns, _ in controllers):
        return None
    time_ns = max((stamps for stamps, _ in controllers), key=len)
    gaps_ns = [_longest_gap_ns(stamps) for stamps, _ in controllers]
    together = [
        interpolate(stamps, speeds, time_ns, gap)
        for (stamps, speeds), gap in zip(controllers, gaps_ns, strict=True)
    ]
    reads = [
        interpolate(stamps, (speeds != 0.0) * 1.0, time_ns, gap)
        for (stamps, speeds), gap in zip(controllers, gaps_ns, strict=True)
    ]
    valid = np.all([one.valid for one in together], axis=0)
    if not np.any(valid):
        return None
    speeds = np.concatenate(
        [
            np.where(own.values == 1.0, one.values, 0.0)[valid]
            for one, own in zip(together, reads, strict=True)
        ],
        axis=1,
    )
    return RotorSpeedStream(time_ns[valid], order.speeds(speeds, vehicle))


def without(
    stream: RotorSpeedStream, verdict: npt.NDArray[np.uint8], imu: ImuStream
) -> tuple[RotorSpeedStream, tuple[LeftOut, ...]]:
    """The samples of rotor speeds that the reports of speed controllers form, and those they do not, counted.

    Args:
        stream: of N samples.
        verdict: (N,) see :class:`quadpi_core.findings.Verdict`.
        imu: whose first stamp times count from.
    """
    unusable = UnusableReports()
    unusable.add(stream.time_ns, verdict)
    start_ns = int(imu.time_ns[0]) if len(imu) else 0
    return stream.take(verdict == Verdict.SAMPLE), tuple(unusable.left_out(stream.topic, start_ns))


def stamps_ns(time: Array, seconds_per_unit: float = 1.0) -> Stamps:
    """Integer nanosecond stamps (N,) of a clock (N,) that counts in units of `seconds_per_unit`.

    NO_STAMP, which is dropped, of a time that is not finite, or too large to be held as nanoseconds.
    """
    seconds = time * seconds_per_unit
    usable = np.abs(seconds) < np.iinfo(np.int64).max / 1e9
    stamps: Stamps = np.round(np.where(usable, seconds, 0.0) * 1e9).astype(np.int64)
    stamps[~usable] = NO_STAMP
    return stamps


def normalised_attitude(attitude: Array) -> Array:
    """Attitude quaternions (N, 4) scaled to unit length, as logs store them rounded; others as they are.

    :mod:`quadpi_core.screening.sample_order` judges those with the rest of their sample.
    """
    norm = np.linalg.norm(attitude, axis=1)
    return attitude / np.where(np.abs(norm - 1.0) <= NORM_TOLERANCE, norm, 1.0)[:, np.newaxis]


# Of a vehicle that is no multicopter, such as a VTOL, the sensors are read and the rotors left out.

_BY_ROTORS = MappingProxyType(
    {
        3: "a tricopter",
        4: "a quadrotor",
        6: "a hexacopter",
        8: "an octocopter",
        10: "a decacopter",
        12: "a dodecacopter",
    }
)
# Types of MAVLink's heartbeat, also in PX4's MAV_TYPE, by the number of rotors of a multicopter or by name;
# that of a quadrotor is what autopilots announce unless told otherwise.
_MAV_TYPES: MappingProxyType[int, int | str] = MappingProxyType(
    {
        **{1: "a fixed-wing aircraft", 3: "a coaxial helicopter", 4: "a helicopter", 7: "an airship"},
        **{10: "a rover", 11: "a boat", 12: "a submarine", 16: "an ornithopter"},
        **{13: 6, 14: 8, 15: 3, 29: 12, 35: 10},
        **dict.fromkeys(range(19, 26), "a VTOL aircraft"),
    }
)


class Airframe(NamedTuple):
    """A vehicle, as a log says it.

    Attributes:
        said: by what the log says it, such as "FRAME_CLASS 2".
        name: of such a vehicle, with its article.
        rotors: of a multicopter; None for a vehicle that is none.
    """

    said: str
    name: str
    rotors: int | None = None

    def __str__(self) -> str:
        return f"{self.said} is {self.name}"

    @property
    def is_multicopter(self) -> bool:
        """Whether rotors alone hold it in the air."""
        return self.rotors is not None

    @classmethod
    def of_rotors(cls, said: str, rotors: int) -> Airframe:
        """A multicopter of so many rotors."""
        return cls(said, _BY_ROTORS.get(rotors, f"a vehicle of {rotors} rotors"), rotors)

    @classmethod
    def of_mav_type(cls, said: str, mav_type: int) -> Airframe | None:
        """The vehicle of a MAV_TYPE; None for a quadrotor, and where the number does not say."""
        known = _MAV_TYPES.get(mav_type)
        if isinstance(known, int):
            return cls.of_rotors(said, known)
        return None if known is None else cls(said, known)

    def other_than(self, vehicle: Vehicle | None) -> str:
        """Why it is not that vehicle, for messages; empty where it may be."""
        if vehicle is None or self.rotors == vehicle.rotor_count:
            return ""
        return f"{self}; vehicle {vehicle.name} has {vehicle.rotor_count} rotors"


def has_rotors(source: str, airframe: Airframe | None, vehicle: Vehicle | None) -> bool:
    """Whether rotor speeds of a log can be those of a vehicle; a note says it where they cannot.

    Raises:
        LogError: naming both, for a multicopter of another number of rotors.
    """
    if airframe is None:
        return True
    if not airframe.is_multicopter:
        note(
            source,
            f"{airframe}: its sensors are read, its rotors are not, which rules out identification, "
            "prediction and replay",
        )
        return False
    if why := airframe.other_than(vehicle):
        raise LogError(f"{source}: {why}")
    return True
