# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Topics that come too seldom: their rate, the rate that is needed and for what, and what to set.

Said by `import` and `info`, and the reason of the refusal where such a topic is needed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from quadpi_core.flight import MAX_GAP_NS, Recording, Stream
from quadpi_core.signals.resample import nominal_rate
from quadpi_core.thresholds import CONVENTION, Threshold

# So many poses within this time give a velocity by a line; of a slower source the estimator takes several.
START_POSES, START_NS = 5, 200_000_000
SELDOM = Threshold(
    name="rate below which pauses of a topic are its rate, over that at which it has none",
    value=1.2,
    unit="1",
    reason="stamps jitter by a tenth of the step and more; a topic that is faster and pauses loses samples",
    data=CONVENTION,
)
# Of what corrects the estimator, the lowest rate; of topics that are interpolated, one without a pause.
CORRECTED_HZ, BRIDGED_HZ = 0.9, SELDOM.value * 1e9 / MAX_GAP_NS
_BRIDGED = "nothing is interpolated across 0.1 s"
_CORRECTS = "in longer pauses an estimate drifts by more than a model could use"
_USES = "identification, prediction and replay"


def seldom(topic: str, rate_hz: float, needed_hz: float, reason: str, remedies: Mapping[str, str]) -> str:
    """The sentence on a topic that comes too seldom.

    Args:
        topic: its name.
        rate_hz: at which it comes.
        needed_hz: at which it must.
        reason: for that, in words.
        remedies: what to set, by topic.
    """
    remedy = f"; {remedies[topic]}" if remedies.get(topic) else ""
    needed = f"which need {needed_hz:g} Hz or more ({reason}){remedy}"
    return f"{topic} at {rate_hz:.3g} Hz: rules out {_USES}, {needed}"


def is_slow_state(stream: Stream) -> bool:
    """Whether states come too seldom to be interpolated; those that are no slower correct the estimator."""
    return len(stream) > 1 and nominal_rate(stream.time_ns) < BRIDGED_HZ


def seldom_topics(recording: Recording) -> Iterator[str]:
    """On topics that come too seldom for a model: rotor speeds, and the state or motion capture."""
    mocap = recording.pose or recording.twist
    if mocap is not None and len(mocap) > 1:
        yield from _seldom_state(mocap, recording.remedies)
    speeds, state = recording.rotor_speeds, None if mocap is not None else recording.odometry
    if speeds is not None and np.any(np.diff(speeds.time_ns) > MAX_GAP_NS):
        rate_hz = nominal_rate(speeds.time_ns)
        if rate_hz < BRIDGED_HZ:
            yield seldom(speeds.topic, rate_hz, BRIDGED_HZ, _BRIDGED, recording.remedies)
    if state is not None and len(state) > 1:
        yield from _seldom_state(state, recording.remedies)


def _seldom_state(stream: Stream, remedies: Mapping[str, str]) -> Iterator[str]:
    rate_hz = nominal_rate(stream.time_ns)
    if rate_hz < CORRECTED_HZ:
        yield seldom(stream.topic, rate_hz, CORRECTED_HZ, _CORRECTS, remedies)


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

    def seldom(self) -> Iterator[str]:
        """On topics that come too seldom, by their mean rates."""
        mocap = [topic for topic in self._spans if topic.startswith("mocap/")][:1]
        needs = dict.fromkeys([*mocap, *([] if mocap else ["odometry"])], (CORRECTED_HZ, _CORRECTS))
        needs["rotor_speeds"] = BRIDGED_HZ, _BRIDGED
        for topic, (needed_hz, reason) in needs.items():
            first_ns, last_ns, count = self._spans.get(topic, (0, 0, 0))
            if count > 1 and last_ns > first_ns:
                rate_hz = 1e9 * (count - 1) / (last_ns - first_ns)
                if rate_hz < needed_hz:
                    yield seldom(topic, rate_hz, needed_hz, reason, self._remedies)
