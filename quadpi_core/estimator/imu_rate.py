# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The sample rate of an IMU as its stamps tell it in flight: measured in a second, then watched.

A rate is measured over the first second by :func:`quadpi_core.signals.resample.nominal_rate`, which jitter,
single lost samples and repeated stamps do not change. From then on every span of ten steps is compared with
it. Single spans are longer where samples were lost; that the rate has changed is what nearly all spans say
for :data:`NOTICED_NS`. A pause or a jump of the clock is a new beginning: the driver may have started again.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, NO_STAMP
from quadpi_core.signals.resample import RATE_SPAN

MEASURED_NS = 1_000_000_000
# A low-pass designed for another rate has another cut-off, by as much; so has the noise of the estimator.
RATE_TOLERANCE = 0.1
# Stands in until the rate is known; no sample is used before.
RATE_BEFORE_HZ = 500.0
# A span of ten that lost one sample is longer by a tenth: that much and its jitter is no other rate.
_SPAN_TOLERANCE = 0.12
NOTICED_NS = 200_000_000
# Of another rate hardly any span fits, of a link that loses a seventh of the samples every other does.
_FITS = 4
# A step counts for at most this long: a gap says nothing of the rate.
_STEP_MAX_NS = 20_000_000
# Stamps of a second, at the fastest rate that a node takes and more.
_ROOM = 8192

# Where a meter holds what.
_COUNT, _NEWEST_NS, _JUMPED_NS, _SPAN_NS, _OFF_NS, LOST, CHANGES, _SIZE = range(8)


class ImuRate(NamedTuple):
    """What is known of the rate.

    Attributes:
        measured_hz: by the stamps; 0 while it is being measured.
        given_hz: that a user says it has; 0 where the measured one counts.
        lost: whether it is being measured again, after a pause or a change.
    """

    measured_hz: float = 0.0
    given_hz: float = 0.0
    lost: bool = False

    @classmethod
    def of_span(cls, span_ns: float, given_hz: float, lost: bool) -> ImuRate:
        """From the usual time of ten steps; 0 while that is not known."""
        return cls(1e9 * RATE_SPAN / span_ns if span_ns > 0.0 else 0.0, given_hz, lost)

    @property
    def differs(self) -> bool:
        """Whether the rate that was given is another than the measured one."""
        known = self.given_hz > 0.0 and self.measured_hz > 0.0
        return known and abs(self.measured_hz / self.given_hz - 1.0) > RATE_TOLERANCE

    @property
    def filter_hz(self) -> float:
        """The rate to design filters for; 0 where it is not known, or not the one that was given."""
        if self.measured_hz == 0.0 or self.differs:
            return 0.0
        return self.given_hz or self.measured_hz

    @property
    def begins(self) -> bool:
        """Whether the first second has not passed yet: nothing can be judged, and nothing is wrong."""
        return self.measured_hz == 0.0 and not self.lost

    def __str__(self) -> str:
        if self.differs:
            return f"stamps say {self.measured_hz:.0f} Hz, imu_rate_hz is {self.given_hz:g}"
        return f"{self.filter_hz:.4g} Hz" if self.filter_hz else "being measured"


class Meter(NamedTuple):
    """What is remembered of the stamps; arrays that :func:`follow` changes.

    Attributes:
        numbers: (8,) whole numbers.
        stamps: (8192,) the last ones since the beginning, a ring.
        span: (1,) ns, the usual time of ten steps; 0 while it is not known.
    """

    numbers: npt.NDArray[np.int64]
    stamps: npt.NDArray[np.int64]
    span: npt.NDArray[np.float64]

    @classmethod
    def empty(cls) -> Meter:
        """A meter that has seen nothing."""
        meter = cls(np.zeros(_SIZE, dtype=np.int64), np.zeros(_ROOM, dtype=np.int64), np.zeros(1))
        meter.numbers[_JUMPED_NS] = NO_STAMP
        return meter

    @property
    def changes(self) -> int:
        """Counts how often what :meth:`rate` gives has changed."""
        return int(self.numbers[CHANGES])

    def rate(self, given_hz: float = 0.0) -> ImuRate:
        """The rate as it is known now, beside one that was given."""
        return ImuRate.of_span(float(self.span[0]), given_hz, bool(self.numbers[LOST]))


@njit(cache=True)
def follow_arrays(numbers: Any, stamps: Any, span: Any, time_ns: int) -> None:
    """:func:`follow` for Python, which hands over arrays one by one at half the cost of a tuple."""
    follow(Meter(numbers, stamps, span), time_ns)


@njit(cache=True)
def follow(meter: Any, time_ns: int) -> None:
    """Take the stamp of one IMU sample."""
    numbers = meter.numbers
    if numbers[_COUNT] == 0:
        _begin(meter, time_ns)
        return
    since_ns = time_ns - numbers[_NEWEST_NS]
    if since_ns > MAX_GAP_NS or since_ns < -MAX_JUMP_BACK_NS:
        # One stamp alone may be broken; two that agree are a pause or another clock.
        if 0 < time_ns - numbers[_JUMPED_NS] <= MAX_GAP_NS:
            numbers[LOST] = since_ns > 0 and (meter.span[0] > 0.0 or numbers[LOST])
            _begin(meter, numbers[_JUMPED_NS])
            _append(meter, time_ns)
        else:
            numbers[_JUMPED_NS] = time_ns
        return
    numbers[_JUMPED_NS] = NO_STAMP
    if since_ns <= 0:
        return
    _append(meter, time_ns)
    if meter.span[0] == 0.0:
        count = numbers[_COUNT]
        if time_ns - meter.stamps[0] >= MEASURED_NS or count == _ROOM:
            meter.span[0] = _usual_span(meter.stamps[:count])
            numbers[LOST] = 0
            numbers[CHANGES] += 1
        return
    span_ns = time_ns - meter.stamps[(numbers[_COUNT] - 1 - RATE_SPAN) % _ROOM]
    numbers[_OFF_NS] = off_for(numbers[_OFF_NS], span_ns, meter.span[0], since_ns)
    if numbers[_OFF_NS] > NOTICED_NS:
        numbers[LOST] = 1
        _begin(meter, time_ns)


@njit(cache=True)
def off_for(off_ns: int, span_ns: int, usual_ns: float, step_ns: int) -> int:
    """For how long nearly all spans of ten steps differ from the usual one, after one more sample."""
    step_ns = min(step_ns, _STEP_MAX_NS)
    if abs(span_ns - usual_ns) > _SPAN_TOLERANCE * usual_ns:
        return off_ns + step_ns
    return max(0, off_ns - _FITS * step_ns)


@njit(cache=True)
def _begin(meter: Any, time_ns: int) -> None:
    numbers = meter.numbers
    numbers[_COUNT] = 0
    numbers[_OFF_NS] = 0
    numbers[_JUMPED_NS] = NO_STAMP
    numbers[CHANGES] += 1
    meter.span[0] = 0.0
    _append(meter, time_ns)


@njit(cache=True)
def _append(meter: Any, time_ns: int) -> None:
    numbers = meter.numbers
    meter.stamps[numbers[_COUNT] % _ROOM] = time_ns
    numbers[_COUNT] += 1
    numbers[_NEWEST_NS] = time_ns


@njit(cache=True)
def _usual_span(stamps: Any) -> float:
    """See :func:`quadpi_core.signals.resample.nominal_rate`: the same median."""
    span = min(RATE_SPAN, stamps.size - 1)
    usual = np.median((stamps[span:] - stamps[: stamps.size - span]).astype(np.float64))
    return float(usual * RATE_SPAN / span)
