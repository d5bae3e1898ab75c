# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that come too seldom: their rate, the rate that is needed and for what, and what to set.

Said by `import` and `info`, and the reason of the refusal where such a topic is needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from quadpi_core.flight import MAX_GAP_NS, Recording, Stamps, Stream
from quadpi_core.signals.resample import nominal_rate
from quadpi_core.thresholds import CONVENTION, Threshold

# So many poses within this time start the estimator: a line through fewer gives no velocity.
START_POSES, START_NS = 5, 200_000_000
SELDOM = Threshold(
    name="rate below which pauses of a topic are its rate, over that at which it has none",
    value=1.2,
    unit="1",
    reason="stamps jitter by a tenth of the step and more; a topic that is faster and pauses loses samples",
    data=CONVENTION,
)
# Of motion capture, the lowest rate that starts it; of topics that are interpolated, one without a pause.
_START_HZ, _BRIDGED_HZ = 1e9 * (START_POSES - 1) / START_NS, SELDOM.value * 1e9 / MAX_GAP_NS
_BRIDGED = "nothing is interpolated across 0.1 s"
_STARTS = f"the estimator starts with {START_POSES} poses within {1e-9 * START_NS:g} s"
_USES = "identification, prediction and replay"


class Seldom(NamedTuple):
    """A topic that comes too seldom.

    Attributes:
        topic: its name.
        rate_hz: at which it comes.
        needed_hz: at which it must.
        reason: for that, in words.
        remedy: what to set, or empty.
    """

    topic: str
    rate_hz: float
    needed_hz: float
    reason: str
    remedy: str

    def __str__(self) -> str:
        remedy = f"; {self.remedy}" if self.remedy else ""
        return (
            f"{self.topic} at {self.rate_hz:.3g} Hz: rules out {_USES}, which need {self.needed_hz:g} Hz or "
            f"more ({self.reason}){remedy}"
        )


def seldom_topics(recording: Recording) -> Iterator[Seldom]:
    """The topics that come too seldom for a model: rotor speeds, and the state or motion capture."""
    mocap = recording.pose or recording.twist
    if mocap is not None and len(mocap) > 1 and not _starts(mocap.time_ns):
        yield _seldom(mocap, _START_HZ, _STARTS, recording.remedies)
    for stream in (recording.rotor_speeds, None if mocap is not None else recording.odometry):
        if stream is not None and len(stream) > 1 and _is_seldom(stream.time_ns):
            yield _seldom(stream, _BRIDGED_HZ, _BRIDGED, recording.remedies)


def _seldom(stream: Stream, needed_hz: float, reason: str, remedies: Mapping[str, str]) -> Seldom:
    remedy = remedies.get(stream.topic, "")
    return Seldom(stream.topic, nominal_rate(stream.time_ns), needed_hz, reason, remedy)


def _starts(time_ns: Stamps) -> bool:
    """Whether there are enough poses within START_NS anywhere."""
    spans = time_ns[START_POSES - 1 :] - time_ns[: 1 - START_POSES]
    return bool(np.any(spans <= START_NS))


def _is_seldom(time_ns: Stamps) -> bool:
    steps = np.diff(time_ns)
    return bool(np.any(steps > MAX_GAP_NS)) and nominal_rate(time_ns) < _BRIDGED_HZ


class RunningRates:
    """Mean rates of the topics of a recording in blocks, to explain why nothing came of it."""

    def __init__(self) -> None:
        self._spans: dict[str, tuple[int, int, int]] = {}
        self._remedies: Mapping[str, str] = {}

    def add(self, block: Recording) -> None:
        """Take the next block."""
        self._remedies = block.remedies
        for stream in block.streams():
            if len(stream):
                first, _, count = self._spans.get(stream.topic, (int(stream.time_ns[0]), 0, 0))
                self._spans[stream.topic] = first, int(stream.time_ns[-1]), count + len(stream)

    def seldom(self) -> Iterator[Seldom]:
        """The topics that come too seldom, by their mean rates."""
        mocap = [topic for topic in self._spans if topic.startswith("mocap/")][:1]
        bridged = ["rotor_speeds", *([] if mocap else ["odometry"])]
        needs = [(topic, _START_HZ, _STARTS) for topic in mocap]
        needs += [(topic, _BRIDGED_HZ, _BRIDGED) for topic in bridged]
        for topic, needed_hz, reason in needs:
            first_ns, last_ns, count = self._spans.get(topic, (0, 0, 0))
            if count > 1 and last_ns > first_ns:
                rate_hz = 1e9 * (count - 1) / (last_ns - first_ns)
                if rate_hz < needed_hz:
                    yield Seldom(topic, rate_hz, needed_hz, reason, self._remedies.get(topic, ""))
