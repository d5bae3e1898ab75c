# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The sample rate of an IMU from the stamps of its samples in flight: measured in a second, then watched.

A rate is measured over the first second by :func:`quadpi_core.signals.resample.nominal_rate`, which jitter,
single lost samples and repeated stamps do not change. From then on every span of ten steps is compared with
it. Single spans are longer where samples were lost; the rate has changed when nearly all spans differ for
:data:`NOTICED_NS`. After a pause or a jump of the clock the rate is measured again: the driver may have
restarted.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import MAX_GAP_NS, MAX_JUMP_BACK_NS, NO_STAMP, Stamps
from quadpi_core.records import Records, record_dtype
from quadpi_core.signals.resample import RATE_SPAN

MEASURED_NS = 1_000_000_000
# Largest difference from a given rate, as a share of it: the cut-off of a low-pass designed for that rate,
# and the noise of the estimator, are off by as much.
RATE_TOLERANCE = 0.1
# Used until the rate is known; no sample is judged before.
RATE_BEFORE_HZ = 500.0
# Largest difference of a span from the usual one, as a share of it. A span of ten that lost one sample is
# longer by a tenth: that and its jitter are no other rate.
_SPAN_TOLERANCE = 0.12
# Time for which spans differ before the rate counts as another one.
NOTICED_NS = 200_000_000
# A span that fits outweighs this many that do not: of another rate hardly any span fits, of a link that
# loses a seventh of the samples every other does.
_FITS = 4
# A step counts for at most this long: a gap says nothing about the rate.
_STEP_MAX_NS = 20_000_000
# Stamps of a second, at the fastest rate that a node takes and more.
_ROOM = 8192


class ImuRate(NamedTuple):
    """What is known of the rate.

    Attributes:
        measured_hz: by the stamps; 0 while it is being measured.
        given_hz: by the user; 0 where the measured one counts.
        lost: whether it is being measured again, after a pause or a change.
    """

    measured_hz: float = 0.0
    given_hz: float = 0.0
    lost: bool = False

    @classmethod
    def of(cls, meters: Records, given_hz: float) -> ImuRate:
        """The rate as a :class:`Meter` (1,) knows it now, beside the one given by the user."""
        span_ns = float(meters["span_ns"][0])
        return cls(1e9 * RATE_SPAN / span_ns if span_ns > 0.0 else 0.0, given_hz, bool(meters["lost"][0]))

    @property
    def differs(self) -> bool:
        """Whether the configured rate contradicts the measured one."""
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


class Meter:
    """What is remembered of the stamps."""

    span_ns: float  # usual time of ten steps; 0 while it is not known
    lost: bool  # whether the rate is being measured again, after a pause or a change
    changes: int  # how often `span_ns` or `lost` has changed
    count: int  # stamps since the measurement began
    newest_ns: int
    jumped_ns: int  # stamp of the previous sample, where that was far from all before it
    off_ns: int  # for how long nearly all spans have differed from the usual one
    stamps: Annotated[npt.NDArray[np.int64], _ROOM]  # a ring of those since the measurement began


METER = record_dtype(Meter)


@njit(cache=True)
def follow(meter: Meter, time_ns: int) -> None:
    """Take the stamp of one IMU sample."""
    if meter.count == 0:
        _begin(meter, time_ns)
        return
    since_ns = time_ns - meter.newest_ns
    if since_ns > MAX_GAP_NS or since_ns < -MAX_JUMP_BACK_NS:
        # One stamp alone may be broken; two that agree are a pause or another clock.
        if 0 < time_ns - meter.jumped_ns <= MAX_GAP_NS:
            meter.lost = since_ns > 0 and (meter.span_ns > 0.0 or meter.lost)
            _begin(meter, meter.jumped_ns)
            _append(meter, time_ns)
        else:
            meter.jumped_ns = time_ns
        return
    meter.jumped_ns = NO_STAMP
    if since_ns <= 0:
        return
    _append(meter, time_ns)
    if meter.span_ns == 0.0:
        if time_ns - meter.stamps[0] >= MEASURED_NS or meter.count == _ROOM:
            meter.span_ns = _usual_span(meter.stamps[: meter.count])
            meter.lost = False
            meter.changes += 1
        return
    span_ns = time_ns - meter.stamps[(meter.count - 1 - RATE_SPAN) % _ROOM]
    meter.off_ns = off_for(meter.off_ns, span_ns, meter.span_ns, since_ns)
    if meter.off_ns > NOTICED_NS:
        meter.lost = True
        _begin(meter, time_ns)


@njit(cache=True)
def is_known(meter: Meter) -> bool:
    """Whether the rate is known, or was before it changed: False in the first second."""
    return bool(meter.span_ns > 0.0 or meter.lost)


@njit(cache=True)
def off_for(off_ns: int, span_ns: int, usual_ns: float, step_ns: int) -> int:
    """For how long nearly all spans of ten steps have differed from the usual one, after one more sample."""
    step_ns = min(step_ns, _STEP_MAX_NS)
    if abs(span_ns - usual_ns) > _SPAN_TOLERANCE * usual_ns:
        return off_ns + step_ns
    return max(0, off_ns - _FITS * step_ns)


@njit(cache=True)
def _begin(meter: Meter, time_ns: int) -> None:
    meter.count, meter.off_ns, meter.jumped_ns = 0, 0, NO_STAMP
    meter.span_ns = 0.0
    meter.changes += 1
    _append(meter, time_ns)


@njit(cache=True)
def _append(meter: Meter, time_ns: int) -> None:
    meter.stamps[meter.count % _ROOM] = time_ns
    meter.count += 1
    meter.newest_ns = time_ns


@njit(cache=True)
def _usual_span(stamps: Stamps) -> float:
    """See :func:`quadpi_core.signals.resample.nominal_rate`: the same median."""
    span = min(RATE_SPAN, stamps.size - 1)
    usual = np.median((stamps[span:] - stamps[: stamps.size - span]).astype(np.float64))
    return float(usual * RATE_SPAN / span)
