# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that cannot be those of a flight are left out of a recording.

These are what the live path leaves out too, by the same limits, and besides spikes within the limits: one or
two samples far from those before and after them. The live path cannot know what comes after.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from quadpi_core.flight import (
    ImuStream,
    OdometryStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    Stream,
    TwistStream,
    WindStream,
)
from quadpi_core.frames import Array
from quadpi_core.quality import LeftOut
from quadpi_core.signals.limits import (
    AIRSPEED_MAX_M_S,
    MEASURED_SPEED_MAX_M_S,
    POSITION_MAX_M,
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
)
from quadpi_core.vehicle import Vehicle

# More of a topic than this share is no outlier but a wrong unit, which is refused and not left out.
OUTLIER_SHARE = 0.01
# Up to this share of a topic is left out as spikes: no unit makes single samples stand out.
SPIKE_SHARE = 0.1
# A spike is as far from the median of five samples as no vehicle gets in two, and as noise does not get
# either: this many times what 80 % of the samples stay within. Of the flights that were tried the farthest
# were at 2 rad/s, 17 m/s² and 11 % of the largest rotor speed in the air, and more in crashes.
_SPIKE_NEIGHBOURS = 5
_SPIKE_RATE_RAD_S, _SPIKE_FORCE_M_S2 = 5.0, 20.0
_SPIKE_POSITION_M, _SPIKE_VELOCITY_M_S = 0.5, 5.0
_SPIKE_ROTOR_SHARE = 0.2
_SPIKE_NOISES, _SPIKE_NOISE_PERCENTILE = 20.0, 80.0


class Beyond(NamedTuple):
    """Samples of a topic that are finite and beyond a limit.

    Attributes:
        samples: (N,) which ones.
        limit: in words.
        unit: what the numbers look like where there are too many to be left out; None if they then stay.
        most: share up to which they are left out.
    """

    samples: npt.NDArray[np.bool_]
    limit: str
    unit: str | None
    most: float = OUTLIER_SHARE

    @property
    def share(self) -> float:
        """Of all samples; zero where there are none."""
        return float(np.count_nonzero(self.samples) / max(len(self.samples), 1))

    @property
    def first(self) -> int:
        """Index of the first one."""
        return int(np.argmax(self.samples))


def screened(recording: Recording, vehicle: Vehicle | None) -> Recording:
    """The recording without the samples beyond the limits; its `quality` says how many there were, and where.

    Values that are not finite stay, as no sensor sends them: :meth:`Recording.check` refuses them. So does a
    topic of which too much is beyond a limit to be outliers: its unit is wrong, which
    :func:`quadpi_core.logs.plausibility.check_plausible` says.

    Args:
        recording: as read.
        vehicle: that flew; without one rotor speeds are not judged.
    """
    kept: dict[str, Any] = {}
    said: list[LeftOut] = []
    arrivals = dict(recording.arrivals)
    for name in ("imu", "rotor_speeds", "pose", "twist", "odometry", "wind"):
        stream: Stream | None = getattr(recording, name)
        outliers = [] if stream is None else list(_outliers(recording, stream, vehicle))
        if stream is None or not outliers:
            continue
        said += (what for _, what in outliers)
        usable = ~np.any([found.samples for found, _ in outliers], axis=0)
        kept[name] = stream.take(usable)
        if stream.topic in arrivals and len(arrivals[stream.topic]) == len(stream):
            arrivals[stream.topic] = arrivals[stream.topic][usable]
        if stream is recording.imu:
            lost = np.concatenate(([0], np.cumsum(~usable)))
            arrivals = {topic: count - lost[count] for topic, count in arrivals.items()}
    if not kept:
        return recording
    quality = replace(recording.quality, left_out=tuple(said))
    return replace(recording, quality=quality, arrivals=arrivals, **kept)


def left_out(recording: Recording, vehicle: Vehicle | None) -> Iterator[LeftOut]:
    """What :func:`screened` leaves out."""
    for stream in recording.streams():
        yield from (what for _, what in _outliers(recording, stream, vehicle))


def _outliers(
    recording: Recording, stream: Stream, vehicle: Vehicle | None
) -> Iterator[tuple[Beyond, LeftOut]]:
    start_ns = int(recording.imu.time_ns[0]) if len(recording.imu) else 0
    for found in beyond_limits(stream, vehicle):
        if 0.0 < found.share <= found.most:
            count, at_ns = int(np.count_nonzero(found.samples)), int(stream.time_ns[found.first])
            yield (
                found,
                LeftOut(
                    stream.topic, found.limit, count, len(stream), found.first, (at_ns - start_ns) * 1e-9
                ),
            )


def beyond_limits(stream: Stream, vehicle: Vehicle | None) -> Iterator[Beyond]:
    """Hold a topic against its limits; without a vehicle rotor speeds have none."""
    if isinstance(stream, ImuStream):
        yield from _judged(stream.angular_velocity, _RATES)
        yield from _judged(stream.specific_force, _FORCE)
    elif isinstance(stream, RotorSpeedStream) and vehicle is not None:
        highest = vehicle.rotor_speed_max_rad_s
        yield from _judged(
            stream.speeds,
            _Limit(
                "rotor speed",
                vehicle.rotor_speed_spike_rad_s,
                _SPIKE_ROTOR_SHARE * highest,
                f"above the vehicle's {highest:.0f} rad/s",
                "rpm or erpm",
            ),
        )
        with np.errstate(invalid="ignore"):
            negative = np.any(stream.speeds < 0.0, axis=1) & np.isfinite(stream.speeds).all(axis=1)
        yield Beyond(negative, "below zero", "speeds that are signed by the sense of rotation")
    elif isinstance(stream, PoseStream):
        yield from _judged(stream.position, _POSITION)
    elif isinstance(stream, TwistStream):
        yield from _judged(stream.velocity, _MEASURED_VELOCITY)
    elif isinstance(stream, OdometryStream):
        yield from _judged(stream.position, _POSITION)
        yield from _judged(stream.velocity, _VELOCITY)
        yield from _judged(stream.rates, _RATES)
    elif isinstance(stream, WindStream):
        yield from _judged(stream.velocity, _VELOCITY)


class _Limit(NamedTuple):
    """Of a quantity: its largest value, the least spike, and how both are called."""

    quantity: str
    largest: float
    spike: float
    words: str
    unit: str


_RATES = _Limit("rate", RATE_MAX_RAD_S, _SPIKE_RATE_RAD_S, f"beyond {RATE_MAX_RAD_S:g} rad/s", "deg/s")
_FORCE = _Limit(
    "specific force",
    SPECIFIC_FORCE_MAX_M_S2,
    _SPIKE_FORCE_M_S2,
    f"beyond {SPECIFIC_FORCE_MAX_M_S2:g} m/s²",
    "a wrong unit of acceleration",
)
_POSITION = _Limit(
    "position", POSITION_MAX_M, _SPIKE_POSITION_M, f"beyond {POSITION_MAX_M:g} m", "millimetres"
)
_VELOCITY = _Limit(
    "velocity",
    AIRSPEED_MAX_M_S,
    _SPIKE_VELOCITY_M_S,
    f"beyond {AIRSPEED_MAX_M_S:g} m/s",
    "a wrong unit of velocity",
)
_MEASURED_VELOCITY = _VELOCITY._replace(
    largest=MEASURED_SPEED_MAX_M_S, words=f"beyond {MEASURED_SPEED_MAX_M_S:g} m/s"
)


def _judged(values: Array, limit: _Limit) -> Iterator[Beyond]:
    """Values (N, C) beyond a limit, then spikes that are not."""
    largest = np.abs(values).max(axis=1)
    # The largest of some numbers and NaN is NaN, which is neither.
    beyond = (largest > limit.largest) & (largest < np.inf)
    spikes = _spikes(values, limit.spike)
    many = np.count_nonzero(beyond & ~spikes) > OUTLIER_SHARE * len(values)
    yield Beyond(beyond, limit.words, limit.unit, OUTLIER_SHARE if many else SPIKE_SHARE)
    yield Beyond(
        spikes & ~beyond, f"whose {limit.quantity} is far from those before and after", None, SPIKE_SHARE
    )


def _spikes(values: Array, least: float) -> npt.NDArray[np.bool_]:
    """Samples (N,) of values (N, C) far from the median of those around them, at least by `least`."""
    known = np.isfinite(values).all(axis=1)
    spikes = np.zeros(len(values), dtype=np.bool_)
    if np.count_nonzero(known) >= _SPIKE_NEIGHBOURS:
        usual = median_filter(values[known], size=(_SPIKE_NEIGHBOURS, 1), mode="mirror")
        off = np.abs(values[known] - usual)
        noise = np.percentile(off, _SPIKE_NOISE_PERCENTILE, axis=0)
        spikes[known] = np.any(off > np.maximum(least, _SPIKE_NOISES * noise), axis=1)
    return spikes
