# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Offset between the clock of another computer and this one's: live from exchanges or arrivals, and for logs.

Every number here is in nanoseconds. The offset is this computer's clock minus the other's.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array

# Quartz clocks differ by less.
DRIFT = 100e-6
_EXCHANGES = 64
_WINDOW_NS = 10_000_000_000
_BUCKET_NS = 1_000_000_000
# How often the offset is estimated again.
_ESTIMATE_NS = 10_000_000
# An error beyond these is corrected at once. A smaller one is removed gradually, at a share of the sender's
# time that grows with the error (size in ns, share), so that stamps keep rising.
_EARLY_NS, _LATE_NS = 50_000_000, 1_000_000_000
_SLEWS = ((5_000_000, 0.5), (500_000, 0.05), (0, 1e-3))
# Answers with a longer round trip are ignored.
_ROUND_TRIP_MAX_NS = 1_000_000_000


class Offset(NamedTuple):
    """Estimate of a clock offset.

    Attributes:
        offset_ns: to be added to the other clock's stamps.
        uncertainty_ns: bound of its error; None for an estimate from arrivals alone, which includes the
            unknown delay of the link.
        exchanged: whether it comes from exchanges.
    """

    offset_ns: int
    uncertainty_ns: int | None
    exchanged: bool


class _Exchange(NamedTuple):
    """Bounds of the offset: the other clock was read after sending and before receiving."""

    at_ns: int
    low_ns: int
    high_ns: int


class _Arrival(NamedTuple):
    """Upper bound of the offset: the stamp was made before its message arrived."""

    at_ns: int
    high_ns: int


class ClockOffset:
    """Estimator of the offset to a sender's clock, from exchanges of stamps or from arrivals alone.

    An exchange bounds the offset on both sides, an arrival from above. The estimate is the centre of the
    intersection of the bounds of the last ten seconds, each widened by the largest drift since. Without an
    exchange it is the smallest arrival minus stamp, which includes the smallest delay of the link. The
    applied offset follows slowly, so that stamps keep the sender's spacing; O(1) per call.
    """

    def __init__(self) -> None:
        self._exchanges: deque[_Exchange] = deque(maxlen=_EXCHANGES)
        self._arrivals: deque[_Arrival] = deque(maxlen=_WINDOW_NS // _BUCKET_NS)
        self._goal = 0
        self._estimated_ns = 0
        self._applied: int | None = None
        self._slewed_ns = 0
        self._last_remote_ns: int | None = None
        self.restarts = 0

    def exchange(self, sent_ns: int, remote_ns: int, received_ns: int) -> None:
        """Add an exchange: sent and received by this clock, stamped by the other in between."""
        round_trip = received_ns - sent_ns
        if not 0 <= round_trip <= _ROUND_TRIP_MAX_NS:
            return
        self._exchanges.append(_Exchange(received_ns, sent_ns - remote_ns, received_ns - remote_ns))

    def arrival(self, remote_ns: int, arrival_ns: int) -> None:
        """Add the stamp of a message and the time of its arrival."""
        if self._last_remote_ns is not None and remote_ns < self._last_remote_ns - _BUCKET_NS:
            self._forget()
        self._last_remote_ns = remote_ns
        offset = arrival_ns - remote_ns
        newest = self._arrivals[-1] if self._arrivals else None
        if newest is None or arrival_ns - newest.at_ns >= _BUCKET_NS:
            self._arrivals.append(_Arrival(arrival_ns, offset))
        elif offset < newest.high_ns:
            self._arrivals[-1] = newest._replace(high_ns=offset)

    def _forget(self) -> None:
        """Start again after a restart of the sender."""
        self._exchanges.clear()
        self._arrivals.clear()
        self._applied = None
        self._slewed_ns = 0
        self.restarts += 1

    def estimate(self, now_ns: int) -> Offset | None:
        """Best estimate at a time, without slewing; None before the first message."""
        exchanges = [known for known in self._exchanges if now_ns - known.at_ns <= _WINDOW_NS]
        if not exchanges:
            highs = [known.high_ns for known in self._arrivals]
            return Offset(min(highs), None, exchanged=False) if highs else None
        low = max(known.low_ns - _drifted(now_ns - known.at_ns) for known in exchanges)
        highs = [known.high_ns + _drifted(now_ns - known.at_ns) for known in exchanges]
        highs += [first.high_ns + _drifted(now_ns - first.at_ns) for first in self._arrivals]
        high = min(highs)
        if high < low:  # one of the clocks was set
            _, low, high = exchanges[-1]
        return Offset((low + high) // 2, (high - low + 1) // 2, exchanged=True)

    def to_local(self, remote_ns: int, now_ns: int) -> int:
        """Convert a sender's stamp to this computer's clock, after a call of `arrival` or `exchange`."""
        # Of either sign: this computer's clock may be set back.
        if abs(now_ns - self._estimated_ns) > _ESTIMATE_NS or self._applied is None:
            estimate = self.estimate(now_ns)
            self._goal = self._goal if estimate is None else estimate.offset_ns
            self._estimated_ns = now_ns
        error = 0 if self._applied is None else self._goal - self._applied
        if self._applied is None or not -_LATE_NS < error < _EARLY_NS:
            self._applied = self._goal
        elif error:
            slew = next(share for size, share in _SLEWS if abs(error) > size)
            most = round(slew * max(0, remote_ns - self._slewed_ns))
            self._applied += min(max(error, -most), most)
        self._slewed_ns = max(self._slewed_ns, remote_ns)
        return remote_ns + self._applied


def _drifted(age_ns: int) -> int:
    return round(DRIFT * max(0, age_ns))


class Line(NamedTuple):
    """local = remote + offset + slope · (remote − origin)."""

    origin_ns: int
    offset_ns: float
    slope: float

    def to_local(self, remote_ns: Stamps) -> Stamps:
        """Convert stamps (N,) of the other clock to this one."""
        return remote_ns + np.rint(self.offset_ns + self.slope * (remote_ns - self.origin_ns)).astype(
            np.int64
        )


def line_below(remote_ns: Stamps, arrival_ns: Stamps) -> Line:
    """Clock offset and drift: the highest line below all arrivals.

    Args:
        remote_ns: (N,) stamps of the sender, N > 0.
        arrival_ns: (N,) times of arrival; the distance above the line is the variable delay.
    """
    origin = int(remote_ns[0])
    elapsed = (remote_ns - origin).astype(np.float64)
    excess: Array = (arrival_ns - remote_ns).astype(np.float64)
    slope = 0.0
    hull = _lower_hull(elapsed, excess)
    if len(hull) > 1:
        middle = float(elapsed.mean())
        edge = int(np.clip(np.searchsorted(elapsed[hull], middle), 1, len(hull) - 1))
        left, right = hull[edge - 1], hull[edge]
        slope = float((excess[right] - excess[left]) / (elapsed[right] - elapsed[left]))
    slope = float(np.clip(slope, -DRIFT, DRIFT))
    return Line(origin, float(np.min(excess - slope * elapsed)), slope)


def _lower_hull(x: Array, y: Array) -> list[int]:
    """Indices of the lower convex hull of points, x rising along it (Andrew's monotone chain)."""
    hull: list[int] = []
    order = np.lexsort((y, x))
    for index in order.tolist():
        if hull and x[index] == x[hull[-1]]:
            continue
        while len(hull) > 1:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (x[index] - x[b]) < (y[index] - y[b]) * (x[b] - x[a]):
                break
            hull.pop()
        hull.append(index)
    return hull
