# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How well samples arrive and results go out, for the diagnostics, and whether anything arrives at all."""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from quadpi_core.flight import NO_STAMP, Recording, Stamps
from quadpi_core.frames import Array
from quadpi_core.vehicle import HALF_READING, SILENT_SHARE

# Samples whose latency is kept between two reports.
_LATENCIES_MAX = 4096
# IMU samples that lacked a sensor of which that is kept: more than a block, and a tenth of a second.
_IMU_SAMPLES_KEPT = 8192
# Different reasons for a refusal that are counted; further ones count as "other".
_REASONS_MAX = 16
# A step between stamps longer than this multiple of the nominal or the usual step is a gap.
_GAP_STEPS = 2.5
# Results earlier than their stamps by more than the first [s], or later than the second, show that clocks
# differ.
_CLOCKS_AGREE_S, _OLD_S = 0.01, 5.0

# Without anything to judge for this long [s], an alarm says so: longer than the longest gap that is
# bridged, and than a busy machine holds a message up.
SILENT_S = 0.3
# A sensor whose stamps are further behind than this [s] may as well be stamped by another clock.
_LONG_S = 60.0
# Period in which to call :meth:`Silence.follow` [s]. Longer ones count as two, as then this process was
# held up and not the sensors.
WATCH_S = 0.1
_STEP_MAX_S = 2.0 * WATCH_S


@dataclass(frozen=True)
class TopicReport:
    """The samples of one topic since the previous report.

    Attributes:
        samples: their number.
        total: their number since the start.
        rate_hz: by arrival; 0 without samples.
        stamp_rate_hz: by the usual step of the stamps; None for fewer than two samples.
        gaps: number of steps of the stamps beyond 2.5 times the usual one.
        longest_gap_s: the longest of them; 0 without one.
        newest_ns: stamp of the newest sample; None before the first.
        refused_now: number of samples that could not be used.
        refused: those since the start, by reason.
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
        rate_hz: nominal rate; None takes the rate of the previous period.
        refused: number of refused samples by reason.
        latest: the last of the reasons; empty before the first.
        newest_ns: stamp of the newest sample; None before the first.
    """

    rate_hz: float | None = None
    latest: str = ""
    refused: Counter[str] = field(default_factory=Counter)
    _refused_before: int = 0
    _total: int = 0
    newest_ns: int | None = None
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
        if self.newest_ns is not None:
            step_ns = time_ns - self.newest_ns
            if step_ns > self._gap_ns:
                self._gaps += 1
                self._gap_span_ns += step_ns
                self._longest_ns = max(self._longest_ns, step_ns)
            elif step_ns > 0:
                self._steps += 1
                self._span_ns += step_ns
        self.newest_ns = time_ns

    def refuse(self, reason: str, count: int = 1) -> None:
        """Count samples that cannot be used."""
        self.latest = reason
        known = reason in self.refused or len(self.refused) < _REASONS_MAX
        self.refused[reason if known else "other"] += count

    @property
    def silent(self) -> bool:
        """Whether nothing arrived since the previous report."""
        return self._samples == 0 and self.refused.total() == self._refused_before

    @property
    def unread(self) -> bool:
        """Whether messages arrived since the previous report and every one was refused."""
        return self._samples == 0 and not self.silent

    def report(self, period_s: float) -> TopicReport:
        """Sum up the `period_s` since the previous report."""
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
            newest_ns=self.newest_ns,
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
    """How long results took since the previous report.

    Attributes:
        arrival: from the arrival of the sample to the publication of its result.
        stamp: from the stamp of the sample; None if stamps and results are by clocks that cannot be compared.
    """

    arrival: Percentiles
    stamp: Percentiles | None


class Latency:
    """The time from each sample to the publication of its result; both come in the order of the stamps."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, int]] = deque(maxlen=_LATENCIES_MAX)
        # Nanoseconds since the arrival, and since the stamp, the latter between two clocks.
        self._latencies_ns: deque[tuple[int, int]] = deque(maxlen=_LATENCIES_MAX)

    def arrived(self, time_ns: int, now_ns: int) -> None:
        """Note that a sample arrived, by the monotonic clock."""
        self._waiting.append((time_ns, now_ns))

    def published(self, time_ns: int, now_ns: int) -> None:
        """Note that the result for a stamp went out; samples before it have none."""
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
        """Sum up the time since the previous report; None without a result.

        Args:
            clock_ahead_ns: how far the clock of the stamps is ahead of the monotonic one; None if that is
                not known.
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
    return Percentiles(*np.percentile(1e-9 * durations_ns, (50, 99)).tolist())


class Arrived(NamedTuple):
    """The newest stamp of each input, and how many samples have been judged.

    Attributes:
        imu_ns, state_ns, rotors_ns: newest stamps; None before the first.
        judged: IMU samples handed to the monitor so far, complete or not; 0 until the rate of the IMU is
            known.
    """

    imu_ns: int | None
    state_ns: int | None
    rotors_ns: int | None
    judged: int


# What the state comes from, but for odometry.
MOTION_CAPTURE = "motion capture"


def lack(sensor: str, newest_ns: int, now_ns: int) -> list[str]:
    """Such as "no motion capture for 2.1 s" of a sensor whose newest stamp is that far behind; or none."""
    if newest_ns == NO_STAMP:
        return [f"no {sensor} yet"]
    behind_s = 1e-9 * (now_ns - newest_ns)
    if behind_s < SILENT_S:
        return []
    differs = f"{behind_s:.0f} s, or its clock differs"
    return [f"no {sensor} for {differs if behind_s > _LONG_S else f'{behind_s:.1f} s'}"]


class Heard:
    """Newest stamps of the sensors as each of the last IMU samples came, to say which of them lacks.

    Args:
        of_state: what the state comes from, odometry or motion capture.
    """

    def __init__(self, of_state: str) -> None:
        self._sensors = (of_state, "rotor speeds")
        # Of samples that lacked one.
        self._newest_ns: dict[int, tuple[int, ...]] = {}
        # Of a recording, after the last block.
        self._last = [NO_STAMP, NO_STAMP]

    def take_one(self, time_ns: int, *newest_ns: int) -> None:
        """Note that an IMU sample came, and the newest stamps before it, NO_STAMP for none."""
        # A stamp may come again where the clock was set back.
        self._newest_ns.pop(time_ns, None)
        if time_ns - min(newest_ns) >= 1e9 * SILENT_S:
            if len(self._newest_ns) >= 2 * _IMU_SAMPLES_KEPT:
                self._newest_ns = dict(list(self._newest_ns.items())[_IMU_SAMPLES_KEPT:])
            self._newest_ns[time_ns] = newest_ns

    def samples(self, block: Recording) -> list[tuple[int, ...]]:
        """What :meth:`take_one` takes of each IMU sample of the next block of a recording."""
        of_state = [block.pose, block.twist] if self._sensors[0] == MOTION_CAPTURE else [block.odometry]
        columns = [[*block.imu.time_ns.tolist(), 0]]
        for before, streams in zip(self._last, (of_state, [block.rotor_speeds]), strict=True):
            came = [stream for stream in streams if stream is not None]
            arrived = np.concatenate([[0], *(block.arrivals_of(stream) for stream in came)])
            order = np.argsort(arrived, kind="stable")
            stamps = np.concatenate([[before], *(stream.time_ns for stream in came)])[order]
            rows = np.searchsorted(arrived[order], np.arange(len(block.imu) + 1), side="right") - 1
            columns.append(stamps[rows].tolist())
        *samples, (_, *self._last) = zip(*columns, strict=True)
        return samples

    def lacks(self, time_ns: int) -> list[str]:
        """Sensors whose stamps were far behind as the sample of a stamp came, see :func:`lack`."""
        newest = zip(self._sensors, self._newest_ns.get(time_ns, ()), strict=False)
        return [words for sensor, stamp in newest for words in lack(sensor, stamp, time_ns)]


class Silence:
    """Watches, by a clock that no sensor can stop, whether samples arrive and are judged.

    Attributes:
        reasons: why nothing has been judged for :data:`SILENT_S`, in plain words; empty while samples are
            judged.
        elapsed_s: since the newest IMU stamp arrived, or since the beginning.
    """

    def __init__(self) -> None:
        self.reasons: tuple[str, ...] = ()
        self._arrived = Arrived(None, None, None, 0)
        self._since_s = dict.fromkeys(Arrived._fields, 0.0)
        self._now_s = 0.0
        self._asked_s: float | None = None

    @property
    def elapsed_s(self) -> float:
        """See the class."""
        return self._now_s - self._since_s["imu_ns"]

    def follow(self, clock_s: float, arrived: Arrived) -> None:
        """Take what has arrived by an instant of a steady clock."""
        if self._asked_s is not None:
            self._now_s += min(clock_s - self._asked_s, _STEP_MAX_S)
        self._asked_s = clock_s
        for name, before, after in zip(Arrived._fields, self._arrived, arrived, strict=True):
            if before != after:
                self._since_s[name] = self._now_s
        self._arrived = arrived
        silent_s = {name: self._now_s - since_s for name, since_s in self._since_s.items()}
        self.reasons = () if silent_s["judged"] < SILENT_S else tuple(self._missing(silent_s))

    def _missing(self, silent_s: dict[str, float]) -> list[str]:
        missing: list[str] = []
        for name, what in (("imu_ns", "imu"), ("state_ns", "state"), ("rotors_ns", "rotor speeds")):
            if what == "state" and missing:
                continue  # The estimator makes it from the IMU's samples.
            if getattr(self._arrived, name) is None:
                missing.append(f"no {what} yet")
            elif silent_s[name] >= SILENT_S:
                missing.append(f"no {what} for {silent_s[name]:.1f} s")
        if not missing and self._arrived.judged == 0:
            return ["no sample is complete yet"]
        return missing or ["no sample is complete: imu, state and rotor speeds share no time"]


# Speeds are compared over about this long, so that lags and single samples do not count.
_MEMORY_S = 1.0
_FEWEST_S = 1.0


class TachometerWatch:
    """Compares rotor speeds as measured with those by the commands."""

    def __init__(self) -> None:
        self._measured: Array | None = None
        self._commanded: Array | None = None
        self._began_ns = self._last_ns = 0

    def take(self, time_ns: int, measured: Array, commanded: Array) -> None:
        """Take the speeds (R,) rad/s at an instant, where the rotors are commanded to turn."""
        if not (np.all(commanded > 0.0) and np.all(np.isfinite(measured))):
            return
        if self._measured is None or self._commanded is None or time_ns < self._last_ns:
            self._measured, self._commanded = measured.copy(), commanded.copy()
            self._began_ns = time_ns
        share = 1.0 - math.exp(-1e-9 * (time_ns - self._last_ns) / _MEMORY_S) if self._last_ns else 0.0
        self._measured += share * (measured - self._measured)
        self._commanded += share * (commanded - self._commanded)
        self._last_ns = time_ns

    def found(self, alarm: bool) -> tuple[str, ...]:
        """A sentence for each tachometer that does not read what the others do at their commands.

        Args:
            alarm: whether the model's alarm is raised: a rotor that stands changes the wrench, a sensor none.
        """
        if self._measured is None or self._commanded is None:
            return ()
        if self._last_ns - self._began_ns < 1e9 * _FEWEST_S:
            return ()
        gains = self._measured / self._commanded
        low, high = HALF_READING.value
        told = []
        for rotor, gain in enumerate(gains.tolist()):
            # Of four that are all silent none is odd: they are judged by the commands alone.
            others = float(np.median(np.delete(gains, rotor)))
            ratio = gain / others if others > SILENT_SHARE.value else gain
            if ratio < SILENT_SHARE.value:
                why = (
                    "it stands, the alarm is raised"
                    if alarm
                    else "it is silent, the vehicle flies as commanded"
                )
                told.append(f"the tachometer of rotor {rotor + 1} reads nothing: {why}")
            elif not low < ratio < high:
                told.append(
                    f"the tachometer of rotor {rotor + 1} reads {ratio:.2f} of what its command gives"
                )
        return tuple(told)
