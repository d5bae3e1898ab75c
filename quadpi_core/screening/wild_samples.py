# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Outliers of a recording: samples beyond the limits of a flight, and spikes, which are left out.

The limits are those of the live path. Spikes are one or two samples within the limits but far from those
before and after them; the live path cannot detect them, as it does not know what comes after.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from typing import NamedTuple

import numpy as np

from quadpi_core import flight
from quadpi_core.findings import DataQuality, LeftOut
from quadpi_core.frames import Array
from quadpi_core.reading_options import streams_by_field
from quadpi_core.records import (
    AIRSPEED_MAX_M_S,
    MEASURED_SPEED_MAX_M_S,
    POSITION_MAX_M,
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
)
from quadpi_core.screening.rotors_in_flight import RotorScreening
from quadpi_core.screening.sample_order import Mask, Rows, with_rows
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

    samples: Rows
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


class Screening:
    """Compares the samples of a flight, which comes in blocks, with their limits.

    Args:
        vehicle: that flew; without one rotor speeds have no limits.
        readings: whether rotor speeds that are no measurements count, too.
    """

    def __init__(self, vehicle: Vehicle | None, *, readings: bool = True) -> None:
        self._vehicle = vehicle
        self._columns: dict[str, list[_ColumnScreening]] = {}
        self._rotors = RotorScreening() if readings else None

    def add(self, block: flight.Recording) -> None:
        """Examine the next block."""
        if self._rotors is not None:
            self._rotors.add(block)
        for name, stream in streams_by_field(block).items():
            if name not in self._columns:
                self._columns[name] = list(map(_ColumnScreening, _limits(type(stream), self._vehicle)))
            for column in self._columns[name]:
                column.add(stream)

    def finish(self, stamps: Mapping[str, flight.Stamps]) -> dict[str, list[Beyond]]:
        """The samples beyond each limit, by field; no more can be added after this.

        Each sample of the rotor speeds is left out for one reason, readings of 0 before spikes.

        Args:
            stamps: (N,) those of each stream, by its field.
        """
        outliers = {
            name: [one for each in parts for one in each.finish()] for name, parts in self._columns.items()
        }
        if self._rotors is None or "rotor_speeds" not in outliers:
            return outliers
        already = _joined([one.samples for one in outliers["rotor_speeds"] if one.is_left_out])
        unread = list(self._rotors.finish(stamps["rotor_speeds"], stamps["imu"], already))
        told = _joined([samples for samples, _ in unread])
        outliers["rotor_speeds"] = [
            *(one._replace(samples=np.setdiff1d(one.samples, told)) for one in outliers["rotor_speeds"]),
            *(Beyond(samples, self._rotors.samples, words, None, 1.0) for samples, words in unread),
        ]
        return outliers


def screened(recording: flight.Recording, vehicle: Vehicle | None) -> flight.Recording:
    """The recording without outliers; its `quality` says how many were left out, and where.

    Values that are not finite are none. Topics with too many samples beyond a limit are kept whole: their
    unit is wrong, which :func:`quadpi_core.screening.plausibility.check_plausible` reports.

    Args:
        recording: as read.
        vehicle: that flew; without one rotor speeds are not judged.
    """
    screening = Screening(vehicle, readings=not recording.commanded)
    screening.add(recording)
    streams = streams_by_field(recording)
    outliers = screening.finish({name: stream.time_ns for name, stream in streams.items()})
    rows = {name: usable for name in streams if (usable := usable_samples(outliers[name])) is not None}
    if not rows:
        return recording
    summaries = (
        left_out(stream.topic, outliers[name], stream.time_ns, recording.imu.time_ns)
        for name, stream in streams.items()
    )
    quality = recording.quality.joined(DataQuality(left_out=tuple(chain.from_iterable(summaries))))
    return replace(with_rows(recording, rows), quality=quality)


def beyond_limits(stream: flight.Stream, vehicle: Vehicle | None) -> Iterator[Beyond]:
    """The samples of a topic beyond each of its limits; without a vehicle rotor speeds have none."""
    for column in map(_ColumnScreening, _limits(type(stream), vehicle)):
        column.add(stream)
        yield from column.finish()


def usable_samples(found: Iterable[Beyond]) -> Mask | None:
    """Mask (N,) of the samples of a topic that are not left out; None if none is."""
    outliers = [beyond for beyond in found if beyond.is_left_out]
    if not outliers:
        return None
    usable = np.ones(outliers[0].of, dtype=np.bool_)
    for beyond in outliers:
        usable[beyond.samples] = False
    return usable


def left_out(
    topic: str, found: Iterable[Beyond], time_ns: flight.Stamps, imu_ns: flight.Stamps
) -> Iterator[LeftOut]:
    """A note for each kind of outlier left out of a topic with stamps (N,) ns, in s after the IMU's first."""
    start_ns = int(imu_ns[0]) if len(imu_ns) else 0
    for beyond in found:
        if beyond.is_left_out:
            after_s = (int(time_ns[beyond.first]) - start_ns) * 1e-9
            yield LeftOut(topic, beyond.limit, len(beyond.samples), beyond.of, beyond.first, after_s)


class _Limit(NamedTuple):
    """Limits of a column: its largest value, the smallest spike, and the words for both; some have a sign."""

    column: str
    quantity: str
    largest: float
    spike: float
    words: str
    unit: str
    is_signed: bool = True


def _limit(column: str, quantity: str, largest: float, spike: float, si: str, unit: str) -> _Limit:
    return _Limit(column, quantity, largest, spike, f"beyond {largest:g} {si}", unit)


_RATE = partial(
    _limit, quantity="rate", largest=RATE_MAX_RAD_S, spike=_SPIKE_RATE_RAD_S, si="rad/s", unit="deg/s"
)
_FORCE = _limit(
    "specific_force",
    "specific force",
    SPECIFIC_FORCE_MAX_M_S2,
    _SPIKE_FORCE_M_S2,
    "m/s²",
    "a wrong unit of acceleration",
)
_POSITION = _limit("position", "position", POSITION_MAX_M, _SPIKE_POSITION_M, "m", "millimetres")
_AIRSPEED, _MEASURED_SPEED = (
    _limit("velocity", "velocity", largest, _SPIKE_VELOCITY_M_S, "m/s", "a wrong unit of velocity")
    for largest in (AIRSPEED_MAX_M_S, MEASURED_SPEED_MAX_M_S)
)
_LIMITS: dict[type[flight.Stream], tuple[_Limit, ...]] = {
    flight.ImuStream: (_RATE("angular_velocity"), _FORCE),
    flight.PoseStream: (_POSITION,),
    flight.TwistStream: (_MEASURED_SPEED,),
    flight.OdometryStream: (_POSITION, _AIRSPEED, _RATE("rates")),
    flight.WindStream: (_AIRSPEED,),
}


def _limits(kind: type[flight.Stream], vehicle: Vehicle | None) -> tuple[_Limit, ...]:
    if kind is not flight.RotorSpeedStream or vehicle is None:
        return _LIMITS.get(kind, ())
    highest = vehicle.rotor_speed_max_rad_s
    words, unit = f"above the vehicle's {highest:.0f} rad/s", "rpm, erpm or squared speeds"
    spike = _SPIKE_ROTOR_SHARE * highest
    return (
        _Limit("speeds", "rotor speed", vehicle.rotor_speed_spike_rad_s, spike, words, unit, is_signed=False),
    )


class _ColumnScreening:
    """Finds samples of a column, which comes in parts, beyond its limit, and spikes within it.

    Spikes are samples far from the median of their neighbours.
    """

    def __init__(self, limit: _Limit) -> None:
        self._limit = limit
        self._count = 0
        self._beyond: list[Rows] = []
        self._negative: list[Rows] = []
        self._noise = EvenRows()
        # Candidates, which are spikes unless the noise is large: their indices and distances from the median.
        self._likely: list[tuple[Rows, Array]] = []
        # Indices and values of the last finite samples, the neighbours of those to come.
        self._last: tuple[Rows, Array] | None = None
        self._begun = False

    def add(self, stream: flight.Stream) -> None:
        values = getattr(stream, self._limit.column)
        largest = np.abs(values).max(axis=1)
        # The maximum of numbers and NaN is NaN, for which both comparisons are false.
        beyond = (largest > self._limit.largest) & (largest < np.inf)
        self._beyond.append(self._count + np.flatnonzero(beyond))
        finite = np.isfinite(values).all(axis=1)
        if not self._limit.is_signed:
            with np.errstate(invalid="ignore"):
                self._negative.append(self._count + np.flatnonzero(np.any(values < 0.0, axis=1) & finite))
        known = np.flatnonzero(finite)
        which, near = self._count + known, values[known]
        self._count += len(values)
        if self._last is not None:
            which, near = np.concatenate((self._last[0], which)), np.concatenate((self._last[1], near))
        self._last = which, near
        if len(near) >= _SPIKE_NEIGHBOURS:
            self._look(which, near, -(_SPIKE_NEIGHBOURS // 2))
            self._last = which[1 - _SPIKE_NEIGHBOURS :], near[1 - _SPIKE_NEIGHBOURS :]
            self._begun = True

    def _look(self, which: Rows, near: Array, end: int | None) -> None:
        """Examine the samples not yet examined, up to `end`, after which neighbours are still missing."""
        off = np.abs(near - _medians_of_five(near))
        new = slice(_SPIKE_NEIGHBOURS // 2 if self._begun else 0, end)
        which, off = which[new], off[new]
        self._noise.add(off)
        likely = np.any(off > self._limit.spike, axis=1)
        if np.any(likely):
            self._likely.append((which[likely], off[likely]))

    def finish(self) -> Iterator[Beyond]:
        limit, of, beyond, spikes = self._limit, self._count, _joined(self._beyond), _joined(())
        if self._begun and self._last is not None:
            # Beyond the end the values are mirrored.
            self._look(*self._last, None)
            noise = np.percentile(self._noise.rows(), _SPIKE_NOISE_PERCENTILE, axis=0)
            farthest = np.maximum(limit.spike, _SPIKE_NOISES * noise)
            spikes = _joined([which[np.any(off > farthest, axis=1)] for which, off in self._likely])
        many = len(np.setdiff1d(beyond, spikes, assume_unique=True)) > OUTLIER_SHARE * of
        within = np.setdiff1d(spikes, beyond, assume_unique=True)
        far = f"whose {limit.quantity} is far from those before and after"
        yield Beyond(beyond, of, limit.words, limit.unit, OUTLIER_SHARE if many else SPIKE_SHARE)
        yield Beyond(within, of, far, None, SPIKE_SHARE)
        if not limit.is_signed:
            signed = "speeds that are signed by the sense of rotation"
            yield Beyond(_joined(self._negative), of, "below zero", signed)


def _medians_of_five(values: Array) -> Array:
    """Median (N, ...) of each row of (N, ...) finite values and two on either side, mirrored beyond the ends.

    By hand, as SciPy's takes half a second to import, which a live node would spend in flight.
    """
    padded = np.concatenate((values[2:0:-1], values, values[-2:-4:-1]))
    first, second, middle, fourth, last = (padded[place : place + len(values)] for place in range(5))
    # Neither the least nor the largest of five is the median; it is that of these two and the middle row.
    low = np.maximum(np.minimum(first, second), np.minimum(fourth, last))
    high = np.minimum(np.maximum(first, second), np.maximum(fourth, last))
    return np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), middle))


def _joined(parts: Sequence[Rows]) -> Rows:
    return np.concatenate(parts) if parts else np.empty(0, dtype=np.int64)
