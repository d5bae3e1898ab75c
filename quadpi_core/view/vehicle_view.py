# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the page knows of one vehicle: its blocks, the words of its state, its alarms and its health."""

from __future__ import annotations

import bisect
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from quadpi_core.flight import AXES, OdometryStream, RotorSpeedStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages.result_messages import DescribedModel
from quadpi_core.monitor.alarm_log import INPUT_WORDS, OF_RANGE
from quadpi_core.results import CAUSE_NAMES, EXTRAPOLATION, AlarmEvent, Predictions, ReportedAlarms
from quadpi_core.view.blocks import PAUSE_NS, BlockStore, FlightClock, Rows, Timeline, Track
from quadpi_core.view.trust import (
    COVERED_S,
    LEAST_COVERED_S,
    SILENCE_S,
    TRAINED,
    State,
    Told,
    is_judged,
    reasons_of,
    states_of,
    too_many_misses,
)

# 20 blocks a second: as fine as a line on a screen, as slow as an eye can follow.
BLOCK_NS = 50_000_000
# Alarms that the page lists, the newest.
EVENTS_SHOWN = 200
# The largest number of models that colours distinguish; further ones are not shown.
MODELS_MAX = 6
# More than any multicopter has: a message that names a million rotors is not to fill the memory.
ROTORS_MAX = 16
# A message's inputs are those of this many blocks before it as well: alarms come at 10 Hz, blocks at 20 Hz.
_BLOCKS_OF_A_MESSAGE = 2
_NANOSECONDS = 1e-9
_SILENCE_NS = round(1e9 * SILENCE_S)


@dataclass
class ShownModel:
    """A model of which predictions come.

    Attributes:
        name: as in its topic.
        number: in the columns of the blocks.
        identity: name and hash; empty until a message says it.
        confidence: nominal coverage of the intervals.
        axes: names of those that it holds.
    """

    name: str
    number: int
    identity: str = ""
    confidence: float = 0.0
    axes: tuple[str, ...] = AXES


class VehicleView:
    """Takes what comes of one vehicle, at full rate, and gives what a page asks for.

    Args:
        name: its namespace, or that of its flight.
        known: models whose training ranges are known, by identity.
        block_ns: duration of a block.
        capacity: blocks kept.
    """

    def __init__(self, name: str, known: Mapping[str, DescribedModel], block_ns: int, capacity: int) -> None:
        self.name = name
        self.blocks = BlockStore(block_ns, capacity)
        self.models: dict[str, ShownModel] = {}
        self.timeline, self.track = Timeline(), Track()
        # How its sources are: what a row is about, whether that is "ok", "warn" or "error", and what to say.
        self.health: list[tuple[str, str, str]] = []
        # Counts the changes of what `describe` gives.
        self.version = 0
        self.start_ns = 0
        # Time of the page from which on stamps are later by so much: another after each jump.
        self._starts: deque[tuple[int, int]] = deque(maxlen=EVENTS_SHOWN)
        self.state = State.NO_DATA
        self.reasons: tuple[str, ...] = ("nothing has come yet",)
        # What battery, autopilot and link say, by name.
        self.told: dict[str, str] = {}
        # Why what is said now cannot be relied on, whatever it is.
        self.doubts: tuple[str, ...] = ()
        self._known = dict(known)
        self._clock = FlightClock(self._jumped)
        self._events: dict[tuple[int, int], dict[str, Any]] = {}
        # Time and state of the last message, and whether it is of what is judged; none before the first.
        self._said: list[tuple[int, State, bool]] = []
        # Block, words and what is told at every change of them; ends with the blocks.
        self._words: list[tuple[int, tuple[str, ...], dict[str, str]]] = []
        self._coming: deque[Told] = deque()

    @property
    def training(self) -> DescribedModel | None:
        """The first model, if its training ranges are known."""
        first = next(iter(self.models.values()), None)
        return None if first is None else self._known.get(first.identity)

    def learn(self, models: Mapping[str, DescribedModel]) -> None:
        """Take the training ranges of further models, by identity."""
        self._known |= models
        self.version += 1

    def take_predictions(
        self, model: str, predictions: Predictions, identity: str, confidence: float, axes: Sequence[str]
    ) -> None:
        """Take predictions of a model; those of the first one lead the time."""
        if len(predictions.time_ns) == 0:
            return
        shown = self._shown(model, identity, confidence, tuple(axes))
        if shown is None:
            return
        if shown.number == 0:
            if not self._clock.started:
                self.start_ns = int(predictions.time_ns[0])
                self._starts.append((0, self.start_ns))
                self.version += 1
            time_ns = self._clock.advance(predictions.time_ns)
            columns: dict[str, Array] = {"time": _seconds(time_ns), "measured": predictions.measured}
        else:
            time_ns, near = self._clock.place(predictions.time_ns)
            if not near.all():
                time_ns, predictions = time_ns[near], _rows_of(predictions, near)
            columns = {}
        outside = (predictions.measured < predictions.lower) | (predictions.measured > predictions.upper)
        columns |= {
            f"model_{shown.number}__{name}": values
            for name, values in (
                ("count", np.ones(len(time_ns))),
                ("misses", outside.astype(float)),
                ("predicted", predictions.predicted),
                ("lower", predictions.lower),
                ("upper", predictions.upper),
            )
        }
        self.blocks.add(time_ns, **columns)

    def take_inputs(self, time_ns: Stamps, inputs: Array) -> None:
        """Take inputs (K, 19) of the models."""
        times, near = self._clock.place(time_ns)
        self.blocks.add(times[near], inputs=inputs[near])

    def take_states(self, states: OdometryStream) -> None:
        """Take positions, attitudes and velocities."""
        times, near = self._clock.place(states.time_ns)
        near &= np.isfinite(states.position).all(axis=1)
        if not near.any():
            return
        position, velocity = states.position[near], states.velocity[near]
        self.blocks.add(
            times[near],
            position=position,
            attitude=states.attitude[near],
            speed=np.sqrt((velocity * velocity).sum(axis=1)),
        )
        self.track.add(_seconds(times[near]), position)

    def take_rotor_speeds(self, rotors: RotorSpeedStream) -> None:
        """Take rotor speeds (K, rotors); the newest number of rotors counts."""
        times, near = self._clock.place(rotors.time_ns)
        speeds = rotors.speeds[near, :ROTORS_MAX]
        if not len(speeds):
            return
        if speeds.shape[1] != self.blocks.rotors:
            self.blocks.set_rotors(speeds.shape[1])
            self.version += 1
        self.blocks.add(times[near], rotors=speeds)

    def take_alarms(self, alarms: ReportedAlarms) -> None:
        """Take what the monitor says, and put it in plain words."""
        if len(alarms) == 0:
            return
        if not self._clock.started:
            # Silence before the first sample: there is a state, but no time to draw it at.
            self.state = states_of(alarms)[-1]
            self.reasons = reasons_of(alarms, len(alarms) - 1, None, *self._inputs_before(-1))
            return
        times, near = self._clock.place(alarms.time_ns)
        if not near.all():
            alarms, times = alarms.where(near), times[near]
        if len(alarms) == 0:
            return
        states, training = states_of(alarms), self.training
        # A message holds until the next one: they are rarer than blocks.
        judged = [is_judged(alarms, row) for row in range(len(alarms))]
        held = [*self._said, *zip(times.tolist(), states, judged, strict=True)]
        begins = [time_ns for time_ns, *_ in held]
        spans = [
            np.arange(one, other, self.blocks.block_ns) if 0 < other - one <= _SILENCE_NS else np.array([one])
            for one, other in pairwise([*begins, begins[-1] + 1])
        ]
        drawn, of = np.concatenate(spans), np.repeat(np.arange(len(held)), [len(span) for span in spans])
        self.blocks.add(drawn, judged=np.array([one for *_, one in held], dtype=float)[of])
        for row, number in enumerate((times // self.blocks.block_ns).tolist()):
            words = reasons_of(alarms, row, training, *self._inputs_before(number))
            while self._coming and self._coming[0].time_ns <= alarms.time_ns[row]:
                told = self._coming.popleft()
                self.told = {**self.told, told.name: told.words}
            if states[row] is State.TRUSTED and (misses := self._misses(number)):
                words, states[row] = (misses, *words), State.WARNING
            self._note(number, words)
        levels = np.array([*(state for _, state, _ in self._said), *states], dtype=np.uint8)[of]
        self.blocks.add(drawn, state=levels.astype(float))
        self.timeline.add(_seconds(drawn), levels)
        self.state, self.reasons = states[-1], self._words[-1][1]
        self._said = [(int(times[-1]), self.state, judged[-1])]

    def take_events(self, events: Sequence[AlarmEvent]) -> None:
        """Take alarms that were raised or cleared."""
        for event in events:
            start_s = _NANOSECONDS * self._clock.time_of(event.start_ns)
            entry = {
                "number": event.number,
                "cause": CAUSE_NAMES.get(event.cause, str(event.cause)),
                "start": round(start_s, 3),
                "end": round(_NANOSECONDS * self._clock.time_of(event.end_ns), 3) if event.end_ns else None,
                "peak": round(event.peak_evidence, 3),
                "reasons": self._with_values(event),
            }
            self._events[event.number, event.start_ns] = entry
        while len(self._events) > EVENTS_SHOWN:
            del self._events[next(iter(self._events))]

    def _with_values(self, event: AlarmEvent) -> list[str]:
        """Reasons of an event; in the place of ratios the values of inputs, as said when it was raised."""
        number = self._clock.time_of(event.start_ns) // self.blocks.block_ns
        place = bisect.bisect_right(self._words, number, key=lambda entry: entry[0]) - 1
        words_then = self._words[place][1] if place >= 0 and event.cause == EXTRAPOLATION else ()
        values = [words for words in words_then if TRAINED in words]
        return [*values, *(words for words in event.reasons if not (values and words.endswith(OF_RANGE)))]

    def take_told(self, told: Sequence[Told]) -> None:
        """Take what battery, autopilot and link say; it is shown from its stamp on."""
        self.told = {**self.told, **{one.name: one.words for one in told if not one.time_ns}}
        self._coming.extend(one for one in told if one.time_ns)

    def take_missing(self, topics: Sequence[tuple[str, str]]) -> None:
        """Take topics that are missing, with what is not shown for that."""
        self.health += [(topic, "warn", text) for topic, text in topics]

    def silent(self, reasons: tuple[str, ...]) -> None:
        """Say that nothing comes of the vehicle: the last state counts no more."""
        self.state, self.reasons = State.NO_DATA, reasons

    def describe(self) -> dict[str, Any]:
        """What a page has to know before it can draw blocks."""
        training = self.training
        return {
            "id": self.name,
            "block_s": _NANOSECONDS * self.blocks.block_ns,
            "starts": [[_NANOSECONDS * begin, _NANOSECONDS * start] for begin, start in self._starts],
            "columns": self.blocks.columns,
            "models": [
                {
                    "name": one.name,
                    "identity": one.identity,
                    "confidence": one.confidence,
                    "axes": one.axes,
                    "vehicle": known.vehicle if (known := self._known.get(one.identity)) else None,
                }
                for one in self.models.values()
            ],
            "inputs": [
                {
                    "name": name,
                    "words": INPUT_WORDS[name].name,
                    "unit": INPUT_WORDS[name].unit,
                    "angle": INPUT_WORDS[name].angle,
                    "lower": None if training is None else float(training.lower[k]),
                    "upper": None if training is None else float(training.upper[k]),
                }
                for k, name in enumerate(INPUT_NAMES)
            ],
        }

    def summary(self) -> dict[str, Any]:
        """Its state now; where that is in doubt, nothing is trusted."""
        doubted = State.WARNING if self.doubts and self.state is State.TRUSTED else self.state
        return {
            "id": self.name,
            "state": int(doubted),
            "reasons": [*self.doubts, *self.reasons],
            "told": self.told,
            "oldest": self.blocks.oldest,
            "newest": self.blocks.newest,
            "version": self.version,
        }

    def overview(self) -> dict[str, Any]:
        """The whole session, coarsely, with its alarms and the health of its sources."""
        return {
            "id": self.name,
            "bin_s": self.timeline.bin_s,
            "codes": self.timeline.codes,
            "track": self.track.points,
            "events": list(self._events.values()),
            "health": self.health,
        }

    def window(
        self, first: int, last: int
    ) -> tuple[int, Rows, list[tuple[int, tuple[str, ...], dict[str, str]]]]:
        """Blocks of a range: number of the first, rows; words, and what is told, with the block of each."""
        first, rows = self.blocks.get(first, last)
        begin = max(0, bisect.bisect_right(self._words, first, key=lambda entry: entry[0]) - 1)
        words = []
        for entry in self._words[begin:]:
            if entry[0] > last:
                break
            words.append(entry)
        return first, rows, words

    def _shown(self, name: str, identity: str, confidence: float, axes: tuple[str, ...]) -> ShownModel | None:
        shown = self.models.get(name)
        if shown is None:
            if len(self.models) >= MODELS_MAX:
                return None
            shown = self.models[name] = ShownModel(name, self.blocks.add_model())
        if (shown.identity, shown.confidence, shown.axes) != (identity, confidence, axes):
            shown.identity, shown.confidence, shown.axes = identity, confidence, axes
            self.version += 1
        return shown

    def _misses(self, number: int) -> str | None:
        """Why a first model without an alarm is not trusted all the same, in words."""
        first = next(iter(self.models.values()), None)
        if first is None:
            return None
        inside = self.blocks.inside(number, first.number, COVERED_S, LEAST_COVERED_S)
        return too_many_misses(inside, first.axes, first.confidence)

    def _inputs_before(self, number: int) -> tuple[Array, Array]:
        numbers = range(number - _BLOCKS_OF_A_MESSAGE, number + 1)
        values = np.array([self.blocks.value(one, "inputs") for one in numbers], dtype=float)
        return np.fmin.reduce(values), np.fmax.reduce(values)

    def _note(self, number: int, words: tuple[str, ...]) -> None:
        if self._words and self._words[-1][1:] == (words, self.told):
            return
        # One entry per block: the last words of a block are those that it shows.
        while self._words and self._words[-1][0] >= number:
            self._words.pop()
        self._words.append((number, words, self.told))
        if len(self._words) > 2 * self.blocks.capacity:
            del self._words[: self.blocks.capacity]

    def _jumped(self, time_ns: int, step_ns: int) -> None:
        seconds = _NANOSECONDS * step_ns
        self._starts.append((time_ns, self._starts[-1][1] + step_ns - PAUSE_NS))
        self.version += 1
        # The monitor forgets what it was about to clear.
        for event in self._events.values():
            if event["end"] is None:
                event["end"] = round(_NANOSECONDS * time_ns, 3)
        self._events[-1 - len(self._events), time_ns] = {
            "number": 0,
            "cause": "stamps jumped",
            "start": round(_NANOSECONDS * time_ns, 3),
            "end": round(_NANOSECONDS * time_ns, 3),
            "peak": 0.0,
            "reasons": [f"by {seconds:+.1f} s: what follows is drawn 1 s after what came before"],
        }


def _seconds(time_ns: Stamps) -> Array:
    return _NANOSECONDS * time_ns.astype(np.float64)


def _rows_of(predictions: Predictions, chosen: Any) -> Predictions:
    return Predictions(**{name: values[chosen] for name, values in vars(predictions).items()})
