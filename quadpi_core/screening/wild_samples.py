# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Outliers of a recording: samples beyond the limits of a flight, and spikes, which are left out.

The limits are those of the live path. Spikes are one or two samples within the limits but far from those
before and after them; the live path cannot detect them, as it does not know what comes after.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

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
from quadpi_core.screening.rotor_readings import RotorScreening
from quadpi_core.vehicle import Vehicle

# If a larger share of a topic is beyond a limit, its unit is wrong: it is refused, nothing is left out.
OUTLIER_SHARE = 0.01
# Up to this share of a topic is left out as spikes: no unit makes single samples stand out.
SPIKE_SHARE = 0.1
# A spike is farther from the median of five samples than a vehicle moves in two of them, and farther than
# noise: this many times the distance that 80 % of the samples stay within. The largest distances in the air,
# in the flights examined, were 2 rad/s, 17 m/s² and 11 % of the largest rotor speed; crashes have more.
_SPIKE_NEIGHBOURS = 5
_SPIKE_RATE_RAD_S, _SPIKE_FORCE_M_S2 = 5.0, 20.0
_SPIKE_POSITION_M, _SPIKE_VELOCITY_M_S = 0.5, 5.0
_SPIKE_ROTOR_SHARE = 0.2
_SPIKE_NOISES, _SPIKE_NOISE_PERCENTILE = 20.0, 80.0


# Samples up to which a flight is judged by all of them: nearly 9 minutes at 500 Hz.
FEW_SAMPLES = 1 << 18


class EvenRows:
    """Rows evenly spread over all that came, for the quantiles of a long flight in bounded memory.

    Keeps all rows up to FEW_SAMPLES of them, then every second, every fourth and so on. Which are kept does
    not depend on the parts that they come in.
    """

    def __init__(self) -> None:
        self._parts: list[Array] = []
        self._stride = 1
        self._count = 0

    def add(self, rows: Array) -> None:
        """Append rows (N, C), or numbers (N,)."""
        self._parts.append(rows[-self._count % self._stride :: self._stride].copy())
        self._count += len(rows)
        while self._count > FEW_SAMPLES * self._stride:
            self._parts = [self.rows()[::2].copy()]
            self._stride *= 2

    def rows(self) -> Array:
        """The rows that were kept.

        Raises:
            ValueError: if nothing was added.
        """
        if len(self._parts) != 1:
            self._parts = [np.concatenate(self._parts)]
        return self._parts[0]


class Beyond(NamedTuple):
    """Samples of a topic that are finite and beyond a limit.

    Attributes:
        samples: (N,) increasing indices.
        of: number of samples of the topic.
        limit: description of the limit, for messages.
        unit: what the numbers look like if there are too many outliers; None if they are then kept.
        most: largest share of the topic that is left out.
    """

    samples: npt.NDArray[np.int64]
    of: int
    limit: str
    unit: str | None
    most: float = OUTLIER_SHARE

    @property
    def share(self) -> float:
        """Share of all samples of the topic."""
        return len(self.samples) / max(self.of, 1)

    @property
    def first(self) -> int:
        """Index of the first such sample; there must be one."""
        return int(self.samples[0])

    @property
    def is_left_out(self) -> bool:
        """Whether there are any, and few enough to be left out."""
        return 0.0 < self.share <= self.most


class StreamScreening:
    """Compares the samples of a topic, which come in parts, with its limits.

    Args:
        kind: of the stream.
        vehicle: that flew; without one rotor speeds have no limits.
    """

    def __init__(self, kind: type[Stream], vehicle: Vehicle | None) -> None:
        self._judges = list(_judges(kind, vehicle))

    def add(self, stream: Stream) -> None:
        """Examine the next samples."""
        for judge in self._judges:
            judge.add(stream)

    def finish(self) -> Iterator[Beyond]:
        """The samples beyond each limit; no more can be added after this."""
        for judge in self._judges:
            yield from judge.finish()


def screened(recording: Recording, vehicle: Vehicle | None) -> Recording:
    """The recording without outliers; its `quality` says how many were left out, and where.

    Values that are not finite are none. Topics with too many samples beyond a limit are kept whole: their
    unit is wrong, which :func:`quadpi_core.screening.plausibility.check_plausible` reports.

    Args:
        recording: as read.
        vehicle: that flew; without one rotor speeds are not judged.
    """
    kept: dict[str, Any] = {}
    said: list[LeftOut] = []
    arrivals = dict(recording.arrivals)
    rotors = RotorScreening()
    rotors.add(recording)
    for name, stream in streams_by_field(recording).items():
        found = list(beyond_limits(stream, vehicle))
        if isinstance(stream, RotorSpeedStream):
            found = with_readings(found, rotors, stream.time_ns, recording.imu.time_ns)
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
    quality = replace(recording.quality, left_out=(*recording.quality.left_out, *said))
    return replace(recording, quality=quality, arrivals=arrivals, **kept)


def beyond_limits(stream: Stream, vehicle: Vehicle | None) -> Iterator[Beyond]:
    """The samples of a topic beyond each of its limits; without a vehicle rotor speeds have none."""
    screening = StreamScreening(type(stream), vehicle)
    screening.add(stream)
    yield from screening.finish()


def with_readings(
    found: Sequence[Beyond], rotors: RotorScreening, rotors_ns: Stamps, imu_ns: Stamps
) -> list[Beyond]:
    """All samples of the rotor speeds that are left out: each for one reason, readings of 0 before spikes.

    Args:
        found: the samples beyond their limits.
        rotors: that has all of the flight.
        rotors_ns: (N,) stamps of the rotor speeds.
        imu_ns: (M,) stamps of the IMU.
    """
    already = _joined([beyond.samples for beyond in found if beyond.is_left_out])
    own = list(rotors.finish(rotors_ns, imu_ns, already))
    told = _joined([samples for samples, _ in own])
    left = [beyond._replace(samples=np.setdiff1d(beyond.samples, told)) for beyond in found]
    return left + [Beyond(samples, rotors.samples, words, None, 1.0) for samples, words in own]


def usable_samples(found: Iterable[Beyond]) -> npt.NDArray[np.bool_] | None:
    """Mask (N,) of the samples of a topic that are not left out; None if none is."""
    outliers = [beyond for beyond in found if beyond.is_left_out]
    if not outliers:
        return None
    usable = np.ones(outliers[0].of, dtype=np.bool_)
    for beyond in outliers:
        usable[beyond.samples] = False
    return usable


def left_out(topic: str, found: Iterable[Beyond], time_ns: Stamps, imu_ns: Stamps) -> Iterator[LeftOut]:
    """A note for each kind of outlier that is left out of a topic.

    Args:
        topic: its name.
        found: its outliers.
        time_ns: (N,) its stamps.
        imu_ns: (M,) stamps of the IMU; times count from the first.
    """
    start_ns = int(imu_ns[0]) if len(imu_ns) else 0
    for beyond in found:
        if beyond.is_left_out:
            after_s = (int(time_ns[beyond.first]) - start_ns) * 1e-9
            yield LeftOut(topic, beyond.limit, len(beyond.samples), beyond.of, beyond.first, after_s)


class _Limit(NamedTuple):
    """Limits of a quantity: its largest value, the smallest spike, and the words for both."""

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
                "rpm, erpm or squared speeds",
            ),
        )
        yield _Negative("speeds")


class _Negative:
    """Finds samples with a negative value in a column."""

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
    """Finds samples of a column beyond a limit, and spikes within it."""

    def __init__(self, column: str, limit: _Limit) -> None:
        self._column, self._limit = column, limit
        self._beyond = _Found()
        self._spikes = _Spikes(limit.spike)

    def add(self, stream: Stream) -> None:
        values = getattr(stream, self._column)
        largest = np.abs(values).max(axis=1)
        # The maximum of numbers and NaN is NaN, for which both comparisons are false.
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
    """Finds samples far from the median of their neighbours; they come in parts.

    Args:
        least: smallest distance of a spike from that median.
    """

    def __init__(self, least: float) -> None:
        self._least = least
        self._count = 0
        self._noise = EvenRows()
        # Candidates, which are spikes unless the noise is large: their indices and distances from the median.
        self._likely: list[tuple[npt.NDArray[np.int64], Array]] = []
        # Indices and values of the last finite samples, the neighbours of those to come.
        self._last: tuple[npt.NDArray[np.int64], Array] | None = None
        self._begun = False

    def add(self, values: Array) -> None:
        """Examine values (N, C); those not finite are skipped."""
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
        """Increasing indices of the spikes."""
        if not self._begun:
            return np.empty(0, dtype=np.int64)
        # Beyond the end the values are mirrored.
        self._look(None)
        noise = np.percentile(self._noise.rows(), _SPIKE_NOISE_PERCENTILE, axis=0)
        farthest = np.maximum(self._least, _SPIKE_NOISES * noise)
        return _joined([which[np.any(off > farthest, axis=1)] for which, off in self._likely])

    def _look(self, end: int | None) -> None:
        """Examine the samples not yet examined, up to `end`, after which neighbours are still missing."""
        assert self._last is not None  # set by the first samples
        # Slow to import, and most importers read no flight.
        from scipy.ndimage import median_filter

        which, near = self._last
        off = np.abs(near - median_filter(near, size=(_SPIKE_NEIGHBOURS, 1), mode="mirror"))
        new = slice(_SPIKE_NEIGHBOURS // 2 if self._begun else 0, end)
        which, off = which[new], off[new]
        self._noise.add(off)
        likely = np.any(off > self._least, axis=1)
        if np.any(likely):
            self._likely.append((which[likely], off[likely]))


class _Found:
    """Indices of the samples found in a topic that comes in parts; `of` counts all samples."""

    def __init__(self) -> None:
        self.of = 0
        self._parts: list[npt.NDArray[np.int64]] = []

    def add(self, which: npt.NDArray[np.bool_]) -> None:
        """Append a mask (N,) of those found among the next samples."""
        if np.any(which):
            self._parts.append(self.of + np.flatnonzero(which))
        self.of += len(which)

    def samples(self) -> npt.NDArray[np.int64]:
        """Increasing indices of those found."""
        return _joined(self._parts)


def _joined(parts: Sequence[npt.NDArray[np.int64]]) -> npt.NDArray[np.int64]:
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
