# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Steps that log readers share: stamps and attitudes, and states that autopilots log in separate messages."""

from __future__ import annotations

import bisect
import logging
from collections.abc import Sequence
from dataclasses import fields
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, OdometryStream, RotorSpeedStream, Stamps, Stream
from quadpi_core.frames import Array
from quadpi_core.rotations import rotate_world_to_body
from quadpi_core.rotor_order import RotorOrder
from quadpi_core.sample_limits import NORM_TOLERANCE
from quadpi_core.screening.plausibility import finite_rows
from quadpi_core.signals.resample import interpolate, interpolate_attitude
from quadpi_core.vehicle import Vehicle

_AnyStream = TypeVar("_AnyStream", bound=Stream)

_log = logging.getLogger(__name__)
_GAP_NS = 1_000_000_000


def note(source: str, text: str) -> None:
    """Warn the user of something that the import of a log did or assumed."""
    _log.warning("%s: %s", source, text)


def usable(source: str, stream: _AnyStream) -> _AnyStream | None:
    """The stream without samples that are not finite or whose stamp does not rise; None if none is left.

    Autopilots sometimes log a sample twice, or stamp in milliseconds at more than 1 kHz. A note gives the
    number of dropped samples.
    """
    finite = finite_rows(*(getattr(stream, column.name) for column in fields(stream)))
    kept = np.flatnonzero(finite)
    kept = kept[_rises(stream.time_ns[kept])]
    for dropped, reason in (
        (len(stream) - np.count_nonzero(finite), "that are not finite"),
        (np.count_nonzero(finite) - len(kept), "whose stamp does not rise"),
    ):
        if dropped:
            note(source, f"topic {stream.topic}: dropped {dropped} of {len(stream)} samples {reason}")
    return stream.take(kept) if len(kept) else None


def _rises(time_ns: Stamps) -> npt.NDArray[np.bool_]:
    """Mask (N,) of the most samples with rising stamps: one stamp far ahead does not drop later ones.

    Source: longest increasing subsequence, by patience sorting.
    """
    if np.all(time_ns[1:] > time_ns[:-1]):
        return np.ones(len(time_ns), dtype=bool)
    stamps = time_ns.tolist()
    smallest: list[int] = []
    ends: list[int] = []
    before: list[int] = []
    for index, stamp in enumerate(stamps):
        place = bisect.bisect_left(smallest, stamp)
        smallest[place : place + 1] = [stamp]
        ends[place : place + 1] = [index]
        before.append(ends[place - 1] if place else -1)
    rises = np.zeros(len(stamps), dtype=bool)
    index = ends[-1]
    while index >= 0:
        rises[index] = True
        index = before[index]
    return rises


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
    if imu is None:
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
    turned = interpolate_attitude(*attitude, time_ns, _GAP_NS)
    rates = interpolate(imu.time_ns, imu.angular_velocity, time_ns, _GAP_NS)
    both = turned.valid & rates.valid
    if not np.any(both):
        return None
    unit = turned.values[both]
    velocity = rotate_world_to_body(unit, velocity_world[both])
    return OdometryStream(time_ns[both], position[both], unit, velocity, rates.values[both])


def rising(time_ns: Stamps, *columns: Array) -> tuple[Stamps, tuple[Array, ...]]:
    """Samples of auxiliary signals that are finite and whose stamp rises."""
    kept = np.flatnonzero(finite_rows(*columns))
    kept = kept[_rises(time_ns[kept])]
    return time_ns[kept], tuple(values[kept] for values in columns)


def rotors_together(
    controllers: Sequence[tuple[Stamps, Array]], order: RotorOrder, vehicle: Vehicle | None
) -> RotorSpeedStream | None:
    """Rotor speeds of controllers that are logged separately, at the stamps of the one with most samples.

    Args:
        controllers: stamps (K,) and speeds (K, 1) of each, in the vehicle's rotor order; rising stamps.
        order: says the unit.
        vehicle: see :meth:`RotorOrder.speeds`.
    """
    if any(len(time_ns) == 0 for time_ns, _ in controllers):
        return None
    time_ns = max((stamps for stamps, _ in controllers), key=len)
    together = [interpolate(stamps, speeds, time_ns, _GAP_NS) for stamps, speeds in controllers]
    valid = np.all([one.valid for one in together], axis=0)
    if not np.any(valid):
        return None
    speeds = np.concatenate([one.values[valid] for one in together], axis=1)
    return RotorSpeedStream(time_ns[valid], order.speeds(speeds, vehicle))


def stamps_ns(source: str, time: Array, seconds_per_unit: float = 1.0) -> Stamps:
    """Integer nanosecond stamps (N,) of a clock (N,) that counts in units of `seconds_per_unit`.

    Raises:
        LogError: if a time is not finite, or too large to be held as nanoseconds.
    """
    seconds = time * seconds_per_unit
    usable = np.isfinite(seconds) & (np.abs(seconds) < np.iinfo(np.int64).max / 1e9)
    if not np.all(usable):
        index = int(np.argmin(usable))
        raise LogError(f"{source}: sample {index}: the time is not a usable number ({time[index]})")
    return np.round(seconds * 1e9).astype(np.int64)


def normalised_attitude(source: str, topic: str, attitude: Array) -> Array:
    """Attitude quaternions (N, 4) scaled to unit length; logs store them rounded.

    Samples that are not finite pass as they are: they are judged with the rest of their stream.

    Raises:
        LogError: naming the sample whose norm is not near 1, for then it is not an attitude.
    """
    norm = np.linalg.norm(attitude, axis=1)
    wrong = np.abs(norm - 1.0) > NORM_TOLERANCE
    if np.any(wrong):
        index = int(np.argmax(wrong))
        raise LogError(
            f"{source}: topic {topic}: sample {index}: the attitude quaternion has norm {norm[index]:.3g}, "
            "expected 1; are the columns or their order right?"
        )
    unit: Array = attitude / norm[:, np.newaxis]
    return unit
