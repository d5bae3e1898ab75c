# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How well samples come in and results go out, for the diagnostics: O(1) each, summed up once a second."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quadpi_core.flight import Stamps

# Samples whose latency is kept between two reports.
_LATENCIES_MAX = 4096
# Reasons for a refusal that are told apart; what comes after them counts as "other".
_REASONS_MAX = 16
# A longer step between stamps is a gap, as a multiple of the nominal or the usual step.
_GAP_STEPS = 2.5
# Results before their stamps by more than this, or later than that, say that the clocks differ.
_CLOCKS_AGREE_S, _OLD_S = 0.01, 5.0


@dataclass(frozen=True)
class TopicReport:
    """What came on one topic since the report before.

    Attributes:
        samples: how many.
        total: how many since the start.
        rate_hz: by arrival; 0 for none.
        stamp_rate_hz: by the usual steps of their stamps; None below two samples.
        gaps: steps of the stamps beyond 2.5 times the usual one.
        longest_gap_s: the longest of them; 0 without one.
        newest_ns: stamp of the newest sample; None before the first.
        refused_now: how many could not be used.
        refused: the same by reason, since the start.
    """

    samples: int
    total: int
    rate_hz: float
    stamp_rate_hz: float | None
    gaps: int
    longest_gap_s: float
    newest_ns: int | None
    refused_now: int
    refused: dict[str, int]


@dataclass
class TopicHealth:
    """Counts the samples of one topic.

    Attributes:
        rate_hz: nominal rate; None takes the rate of the period before.
    """

    rate_hz: float | None = None
    refused: Counter[str] = field(default_factory=Counter)
    _refused_before: int = 0
    _total: int = 0
    _newest_ns: int | None = None
    _samples: int = 0
    _steps: int = 0
    _span_ns: int = 0
    _gaps: int = 0
    _gap_span_ns: int = 0
    _longest_ns: int = 0
    _gap_ns: float = np.inf

    def __post_init__(self) -> None:
        if self.rate_hz is not None:
            self._gap_ns = _GAP_STEPS * 1e9 / self.rate_hz

    def take(self, time_ns: int) -> None:
        """Count one sample by its stamp; one that does not advance counts as arrived only."""
        self._samples += 1
        if self._newest_ns is not None:
            step_ns = time_ns - self._newest_ns
            if step_ns > self._gap_ns:
                self._gaps += 1
                self._gap_span_ns += step_ns
                self._longest_ns = max(self._longest_ns, step_ns)
            elif step_ns > 0:
                self._steps += 1
                self._span_ns += step_ns
        self._newest_ns = time_ns

    def refuse(self, reason: str, count: int = 1) -> None:
        """Count samples that cannot be used."""
        known = reason in self.refused or len(self.refused) < _REASONS_MAX
        self.refused[reason if known else "other"] += count

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest sample; None before the first."""
        return self._newest_ns

    @property
    def silent(self) -> bool:
        """Whether nothing came since the report before."""
        return self._samples == 0 and self.refused.total() == self._refused_before

    @property
    def unread(self) -> bool:
        """Whether messages came since the report before, and every one was refused."""
        return self._samples == 0 and not self.silent

    def report(self, period_s: float) -> TopicReport:
        """Sum up the time since the report before, `period_s` long."""
        self._total += self._samples
        refused = self.refused.total()
        # Where most steps are gaps, the topic is slower than its nominal rate.
        usual = max((self._steps, self._span_ns), (self._gaps, self._gap_span_ns))
        stamp_rate_hz = 1e9 * usual[0] / usual[1] if usual[0] else None
        report = TopicReport(
            samples=self._samples,
            total=self._total,
            rate_hz=self._samples / period_s,
            stamp_rate_hz=stamp_rate_hz,
            gaps=self._gaps,
            longest_gap_s=1e-9 * self._longest_ns,
            newest_ns=self._newest_ns,
            refused_now=refused - self._refused_before,
            refused=dict(self.refused),
        )
        if self.rate_hz is None and stamp_rate_hz is not None:
            self._gap_ns = _GAP_STEPS * 1e9 / stamp_rate_hz
        self._refused_before = refused
        self._samples = self._steps = self._span_ns = 0
        self._gaps = self._gap_span_ns = self._longest_ns = 0
        return report


class Percentiles(NamedTuple):
    """Median and 99th percentile [s]."""

    median: float
    p99: float


class LatencyReport(NamedTuple):
    """How long results took since the report before.

    Attributes:
        arrival: from the arrival of the sample to the publication of its result.
        stamp: from the stamp of the sample; None if the stamps are of another clock, or one not known.
    """

    arrival: Percentiles
    stamp: Percentiles | None


class Latency:
    """From a sample to the publication of its result, in their order; times of the monotonic clock."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, int]] = deque(maxlen=_LATENCIES_MAX)
        # Since the arrival, and between the two clocks since the stamp.
        self._latencies_ns: deque[tuple[int, int]] = deque(maxlen=_LATENCIES_MAX)

    def arrived(self, time_ns: int, now_ns: int) -> None:
        """A sample of that stamp came."""
        self._waiting.append((time_ns, now_ns))

    def published(self, time_ns: int, now_ns: int) -> None:
        """The result for a stamp went out; samples before it have none."""
        waiting = self._waiting
        while waiting:
            stamp_ns, arrived_ns = waiting[0]
            if stamp_ns > time_ns:
                return
            waiting.popleft()
            if stamp_ns == time_ns:
                self._latencies_ns.append((now_ns - arrived_ns, now_ns - stamp_ns))
                return

    def reset(self) -> None:
        """Forget the samples without a result."""
        self._waiting.clear()

    def report(self, clock_ahead_ns: int | None) -> LatencyReport | None:
        """Sum up the time since the report before; None without a result.

        Args:
            clock_ahead_ns: by how much the clock that stamps should be of is ahead of the monotonic one.
        """
        if not self._latencies_ns:
            return None
        arrival_ns, stamp_ns = np.array(self._latencies_ns, dtype=np.int64).T
        self._latencies_ns.clear()
        stamp = None if clock_ahead_ns is None else _percentiles(stamp_ns + clock_ahead_ns)
        if stamp is not None and not -_CLOCKS_AGREE_S <= stamp.median <= _OLD_S:
            stamp = None
        return LatencyReport(_percentiles(arrival_ns), stamp)


def _percentiles(durations_ns: Stamps) -> Percentiles:
    median, p99 = np.percentile(1e-9 * durations_ns, (50, 99))
    return Percentiles(float(median), float(p99))
