# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that cannot be those of a flight are left out of a recording.

These are what the live path leaves out too, by the same limits, and besides spikes within the limits: one or
two samples far from those before and after them. The live path cannot know what comes after.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import median_filter

from quadpi_core.findings import LeftOut
from quadpi_core.flight import (
    ImuStream,
    OdometryStream,
    PoseStream,
    Recording,
    RotorSpeedStream,
    Stamps,
    Stream,
    TwistStream,
    WindStream,
)
from quadpi_core.frames import Array
from quadpi_core.recording_blocks import streams_by_field
from quadpi_core.sample_limits import (
    AIRSPEED_MAX_M_S,
    MEASURED_SPEED_MAX_M_S,
    POSITION_MAX_M,
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
)
from quadpi_core.screening.even_rows import EvenRows
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
        samples: (N,) indices, rising.
        of: how many samples the topic has.
        limit: in words.
        unit: what the numbers look like where there are too many to be left out; None if they then stay.
        most: share up to which they are left out.
    """

    samples: npt.NDArray[np.int64]
    of: int
    limit: str
    unit: str | None
    most: float = OUTLIER_SHARE

    @property
    def share(self) -> float:
        """Of all samples; zero where there are none."""
        return len(self.samples) / max(self.of, 1)

    @property
    def first(self) -> int:
        """Index of the first one, where there is one."""
        return int(self.samples[0])

    @property
    def is_left_out(self) -> bool:
        """Whether they are some, and few enough to be left out."""
        return 0.0 < self.share <= self.most


class StreamScreening:
    """Holds a topic against its limits while its samples come in parts.

    Args:
        kind: of the stream.
        vehicle: that flew; without one rotor speeds have no limits.
    """

    def __init__(self, kind: type[Stream], vehicle: Vehicle | None) -> None:
        self._judges = list(_judges(kind, vehicle))

    def add(self, stream: Stream) -> None:
        """Look at the samples that come next."""
        for judge in self._judges:
            judge.add(stream)

    def finish(self) -> Iterator[Beyond]:
        """What is beyond each limit, of all samples; none can be added then."""
        for judge in self._judges:
            yield from judge.finish()


def screened(recording: Recording, vehicle: Vehicle | None) -> Recording:
    """The recording without the samples beyond the limits; its `quality` says how many there were, and where.

    Values that are not finite stay, as no sensor sends them: :meth:`Recording.check` refuses them. So does a
    topic of which too much is beyond a limit to be outliers: its unit is wrong, which
    :func:`quadpi_core.screening.plausibility.check_plausible` says.

    Args:
        recording: as read.
        vehicle: that flew; without one rotor speeds are not judged.
    """
    kept: dict[str, Any] = {}
    said: list[LeftOut] = []
    arrivals = dict(recording.arrivals)
    for name, stream in streams_by_field(recording).items():
        found = list(beyond_limits(stream, vehicle))
        usable = usable_samples(found)
        if usable is None:
            continue
        said += left_out(stream.topic, found, stream.time_ns, recording.imu.time_ns)
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


def beyond_limits(stream: Stream, vehicle: Vehicle | None) -> Iterator[Beyond]:
    """Hold a topic against its limits; without a vehicle rotor speeds have none."""
    screening = StreamScreening(type(stream), vehicle)
    screening.add(stream)
    yield from screening.finish()


def usable_samples(found: Iterable[Beyond]) -> npt.NDArray[np.bool_] | None:
    """Samples (N,) of a topic that are not left out; None where all are."""
    outliers = [beyond for beyond in found if beyond.is_left_out]
    if not outliers:
        return None
    usable = np.ones(outliers[0].of, dtype=np.bool_)
    for beyond in outliers:
        usable[beyond.samples] = False
    return usable


def left_out(topic: str, found: Iterable[Beyond], time_ns: Stamps, imu_ns: Stamps) -> Iterator[LeftOut]:
    """What is to be said of the samples of a topic that are left out.

    Args:
        topic: its name.
        found: in it.
        time_ns: (N,) its stamps.
        imu_ns: (M,) those of the IMU, of which the first is where times count from.
    """
    start_ns = int(imu_ns[0]) if len(imu_ns) else 0
    for beyond in found:
        if beyond.is_left_out:
            after_s = (int(time_ns[beyond.first]) - start_ns) * 1e-9
            yield LeftOut(topic, beyond.limit, len(beyond.samples), beyond.of, beyond.first, after_s)


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
# By kind of stream: its columns that have limits.
_LIMITS: dict[type[Stream], tuple[tuple[str, _Limit], ...]] = {
    ImuStream: (("angular_velocity", _RATES), ("specific_force", _FORCE)),
    PoseStream: (("position", _POSITION),),
    TwistStream: (("velocity", _MEASURED_VELOCITY),),
    OdometryStream: (("position", _POSITION), ("velocity", _VELOCITY), ("rates", _RATES)),
    WindStream: (("velocity", _VELOCITY),),
}


def _judges(kind: type[Stream], vehicle: Vehicle | None) -> Iterator[_OfQuantity | _Negative]:
    for column, limit in _LIMITS.get(kind, ()):
        yield _OfQuantity(column, limit)
    if kind is RotorSpeedStream and vehicle is not None:
        highest = vehicle.rotor_speed_max_rad_s
        yield _OfQuantity(
            "speeds",
            _Limit(
                "rotor speed",
                vehicle.rotor_speed_spike_rad_s,
                _SPIKE_ROTOR_SHARE * highest,
                f"above the vehicle's {highest:.0f} rad/s",
                "rpm or erpm",
            ),
        )
        yield _Negative("speeds")


class _Negative:
    """Finds samples of which a finite value of a column is below zero."""

    def __init__(self, column: str) -> None:
        self._column = column
        self._negative = _Found()

    def add(self, stream: Stream) -> None:
        values = getattr(stream, self._column)
        with np.errstate(invalid="ignore"):
            self._negative.add(np.any(values < 0.0, axis=1) & np.isfinite(values).all(axis=1))

    def finish(self) -> Iterator[Beyond]:
        unit = "speeds that are signed by the sense of rotation"
        yield Beyond(self._negative.samples(), self._negative.of, "below zero", unit)


class _OfQuantity:
    """Finds samples of a column beyond a limit, then spikes that are not."""

    def __init__(self, column: str, limit: _Limit) -> None:
        self._column, self._limit = column, limit
        self._beyond = _Found()
        self._spikes = _Spikes(limit.spike)

    def add(self, stream: Stream) -> None:
        values = getattr(stream, self._column)
        largest = np.abs(values).max(axis=1)
        # The largest of some numbers and NaN is NaN, which is neither.
        self._beyond.add((largest > self._limit.largest) & (largest < np.inf))
        self._spikes.add(values)

    def finish(self) -> Iterator[Beyond]:
        limit, beyond, of = self._limit, self._beyond.samples(), self._beyond.of
        spikes = self._spikes.finish()
        many = len(np.setdiff1d(beyond, spikes, assume_unique=True)) > OUTLIER_SHARE * of
        within = np.setdiff1d(spikes, beyond, assume_unique=True)
        far = f"whose {limit.quantity} is far from those before and after"
        yield Beyond(beyond, of, limit.words, limit.unit, OUTLIER_SHARE if many else SPIKE_SHARE)
        yield Beyond(within, of, far, None, SPIKE_SHARE)


class _Spikes:
    """Finds samples far from the median of those around them, which come in parts.

    Args:
        least: a spike is at least as far from it.
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._count = 0
        self._noise = EvenRows()
        # Samples that are spikes unless the noise is large: which ones, and how far they are off.
        self._likely: list[tuple[npt.NDArray[np.int64], Array]] = []
        # Of the last known samples, and those around them: their numbers and values.
        self._last: tuple[npt.NDArray[np.int64], Array] | None = None
        self._begun = False

    def add(self, values: Array) -> None:
        """Look at values (N, C); those not finite are passed over."""
        known = np.flatnonzero(np.isfinite(values).all(axis=1))
        which, near = self._count + known, values[known]
        self._count += len(values)
        if self._last is not None:
            which, near = np.concatenate((self._last[0], which)), np.concatenate((self._last[1], near))
        self._last = which, near
        if len(near) >= _SPIKE_NEIGHBOURS:
            self._look(-(_SPIKE_NEIGHBOURS // 2))
            self._last = which[1 - _SPIKE_NEIGHBOURS :], near[1 - _SPIKE_NEIGHBOURS :]
            self._begun = True

    def finish(self) -> npt.NDArray[np.int64]:
        """Indices of the spikes, rising."""
        if not self._begun:
            return np.empty(0, dtype=np.int64)
        # Beyond the end the values are those before it, mirrored.
        self._look(None)
        noise = np.percentile(self._noise.rows(), _SPIKE_NOISE_PERCENTILE, axis=0)
        farthest = np.maximum(self._least, _SPIKE_NOISES * noise)
        return _joined([which[np.any(off > farthest, axis=1)] for which, off in self._likely])

    def _look(self, end: int | None) -> None:
        """Judge the last samples that were not yet, up to one from which on those around are not known."""
        assert self._last is not None  # there are some to look at
        which, near = self._last
        off = np.abs(near - median_filter(near, size=(_SPIKE_NEIGHBOURS, 1), mode="mirror"))
        new = slice(_SPIKE_NEIGHBOURS // 2 if self._begun else 0, end)
        which, off = which[new], off[new]
        self._noise.add(off)
        likely = np.any(off > self._least, axis=1)
        if np.any(likely):
            self._likely.append((which[likely], off[likely]))


class _Found:
    """Indices of samples that are found while samples come in parts; `of` counts them all."""

    def __init__(self) -> None:
        self.of = 0
        self._parts: list[npt.NDArray[np.int64]] = []

    def add(self, which: npt.NDArray[np.bool_]) -> None:
        """Take which ones (N,) of the samples that come next are found."""
        if np.any(which):
            self._parts.append(self.of + np.flatnonzero(which))
        self.of += len(which)

    def samples(self) -> npt.NDArray[np.int64]:
        """Those found, rising."""
        return _joined(self._parts)


def _joined(parts: Sequence[npt.NDArray[np.int64]]) -> npt.NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
