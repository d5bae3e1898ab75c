# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The log of alarm events, and the words for what is behind an alarm."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from datetime import datetime, timezone
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core.flight import AXES, NO_STAMP
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.models.envelope import LEVERAGE_HEADROOM, WIDTH_HEADROOM
from quadpi_core.monitor.alarm_kernel import WARNING_CHARGE
from quadpi_core.monitor.preparation import (
    EITHER_MISSING_WORDS,
    ROTORS_MISSING_WORDS,
    STATE_MISSING_WORDS,
    fault_words,
)
from quadpi_core.records import ROTORS_MAX
from quadpi_core.results import (
    BAD_DATA,
    CARRIED,
    CAUSE_NAMES,
    CAUSES,
    CHANGE,
    CHANGED_CENTRE_FORWARD,
    CHANGED_CENTRE_RIGHT,
    CHANGED_FORCE_FORWARD,
    CHANGED_FORCE_RIGHT,
    CHANGED_MASS,
    CHANGED_ROTOR,
    EVENTS_KEPT,
    EXTRAPOLATION,
    JUDGED,
    LEVEL_ALARM,
    MISCOVERAGE,
    SETTLES,
    UNCALIBRATED,
    UNCALIBRATED_WORDS,
    WHY_NOT_JUDGED,
    WIND_UNKNOWN,
    AlarmEvent,
    AlarmRows,
    Alarms,
    Events,
)

# Of the wrench; body axes forward-right-down.
_OF_AXES = "forward force, force to the right, downward force, roll moment, pitch moment, yaw moment"
AXIS_WORDS = dict(zip(AXES, _OF_AXES.split(", "), strict=True))

# How the monitor ends what it says of an input: it knows how far that is out, not on which side.
OF_RANGE = "x the training range"


class InputWords(NamedTuple):
    """An input in plain words: its name, what it is where positive and where negative, and its unit."""

    name: str
    positive: str
    negative: str
    unit: str = ""
    angle: str = ""  # of which this is the "sin" or "cos"


def _unsigned(name: str, unit: str = "", angle: str = "") -> InputWords:
    return InputWords(name, name, name, unit, angle)


INPUT_WORDS = {
    "u": InputWords("forward or backward speed", "forward speed", "backward speed", "m/s"),
    "v": InputWords("sideways speed", "speed to the right", "speed to the left", "m/s"),
    "w": InputWords("vertical body speed", "downward body speed", "upward body speed", "m/s"),
    "v_in": _unsigned("induced velocity", "m/s"),
    "p": InputWords("roll rate", "roll rate to the right", "roll rate to the left", "rad/s"),
    "q": InputWords("pitch rate", "pitch rate nose up", "pitch rate nose down", "rad/s"),
    "r": InputWords("yaw rate", "yaw rate to the right", "yaw rate to the left", "rad/s"),
    "omega_avg": _unsigned("mean rotor speed", "rad/s"),
    "sin_phi": InputWords("roll angle", "roll angle to the right", "roll angle to the left", "°", "sin"),
    "cos_phi": _unsigned("roll angle", "°", "cos"),
    "sin_theta": InputWords("pitch angle", "pitch angle nose up", "pitch angle nose down", "°", "sin"),
    "cos_theta": _unsigned("pitch angle", "°", "cos"),
    "U_p": InputWords("roll control", "roll control to the right", "roll control to the left", "rad/s"),
    "U_q": InputWords("pitch control", "pitch control nose up", "pitch control nose down", "rad/s"),
    # Rotors that turn clockwise yaw the body to the left.
    "U_r": InputWords("yaw control", "yaw control to the left", "yaw control to the right", "rad/s"),
    "mu_x": InputWords(
        *(f"{way} speed over tip speed" for way in ("forward or backward", "forward", "backward"))
    ),
    "mu_y": InputWords(*(f"{way} speed over tip speed" for way in ("sideways", "rightward", "leftward"))),
    "mu_z": InputWords(*(f"{way} body speed over tip speed" for way in ("vertical", "downward", "upward"))),
    "mu_v_in": _unsigned("induced velocity over tip speed"),
}
# What a pilot has a hand on is named first.
_PILOTED = {*"uvwpqr", "sin_phi", "cos_phi", "sin_theta", "cos_theta"}


def piloted_first(names: Iterable[str]) -> list[str]:
    """Names of inputs, the first one that a pilot has a hand on in front, the others as they were."""
    names = list(names)
    first = next((name for name in names if name in _PILOTED), None)
    return names if first is None else [first, *(name for name in names if name != first)]


# Stamps from here on [s] are those of a clock that knows the day: the year 2001.
_OF_A_CLOCK_S = 1e9


class _Words(NamedTuple):
    """A sentence about a size, one where it is negative, and a factor to its unit."""

    positive: str
    negative: str
    unit: str
    factor: float


_WORDS = {
    CHANGED_MASS: _Words(
        "{} heavier, or less thrust of all rotors", "{} lighter, or more thrust of all rotors", "g", 1e3
    ),
    CHANGED_FORCE_FORWARD: _Words("something pushes forward, {}", "something pushes backward, {}", "N", 1.0),
    CHANGED_FORCE_RIGHT: _Words(
        "something pushes to the right, {}", "something pushes to the left, {}", "N", 1.0
    ),
    CHANGED_CENTRE_FORWARD: _Words(
        "centre of gravity {} farther forward", "centre of gravity {} farther back", "mm", 1e3
    ),
    CHANGED_CENTRE_RIGHT: _Words(
        "centre of gravity {} farther right", "centre of gravity {} farther left", "mm", 1e3
    ),
    CHANGED_ROTOR: _Words(
        "rotor {rotor} gives {} less thrust than its speed says",
        "rotor {rotor} gives {} more thrust than its speed says",
        "%",
        1e2,
    ),
}


def change_words(alarms: AlarmRows, row: int) -> list[str]:
    """Such as "12.0 ± 3.0 g heavier, … since 12:41:07 UTC"; none where nothing is named."""
    words = _WORDS.get(int(alarms.changed[row]))
    if words is None:
        return []
    size = words.factor * float(alarms.change_size[row])
    half = 0.5 * words.factor * float(alarms.change_upper[row] - alarms.change_lower[row])
    said = words.positive if size >= 0.0 else words.negative
    start, since = alarms.change_from_start[row], _time(int(alarms.change_since_ns[row]))
    named = said.format(_size(abs(size), half, words.unit), rotor=alarms.changed_rotor[row])
    return [f"{named} since {'this flight is judged' if start else since}"]


def _size(size: float, half: float, unit: str) -> str:
    """With two digits of what it is unsure by, at most."""
    places = max(0, 1 - math.floor(math.log10(half))) if half > 0.0 else 2
    return f"{size:.{places}f} ± {half:.{places}f} {unit}"


def _time(time_ns: int) -> str:
    """Time of the day, or of a clock that does not know it."""
    seconds = 1e-9 * time_ns
    if seconds < _OF_A_CLOCK_S:
        return f"{seconds:.1f} s"
    return f"{datetime.fromtimestamp(time_ns // 10**9, timezone.utc):%H:%M:%S} UTC"


# Inputs or axes named of each kind of evidence, the strongest.
_MOST = 3
# Distance of an input from the middle of its training range, in half widths, from which on it is named:
# below its limits, as leverage and width may come from it.
OUTSIDE_RATIO = 1.05
# Percent of recent samples outside from which on an axis is said to be outside now: intervals that hold have
# 5 to 10 %, and what raised the alarm may have ended.
_MISSES_NOW = 10.0


class EventLog:
    """When each cause was raised and cleared, its peak and why; holds the last :data:`EVENTS_KEPT` events."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all events."""
        self._open: dict[int, AlarmEvent] = {}
        self._closed: deque[AlarmEvent] = deque(maxlen=EVENTS_KEPT)
        self._count = 0

    @property
    def events(self) -> Events:
        """The last events, the oldest first; those still raised come last."""
        return [*self._closed, *self._open.values()][-EVENTS_KEPT:]

    def take(self, alarms: Alarms) -> Events:
        """Take the rows of a block; returns every event that opened or closed, in order."""
        changed: Events = []
        if not self._open and not (alarms.level == LEVEL_ALARM).any():
            return changed
        for row in range(len(alarms)):
            now = int(alarms.time_ns[row])
            for column, cause in enumerate(CAUSES):
                level = alarms.cause_level[row, column]
                evidence = float(alarms.cause_evidence[row, column])
                event = self._open.get(cause)
                if event is None and level == LEVEL_ALARM:
                    self._count += 1
                    why = reasons(alarms, row, cause)
                    self._open[cause] = AlarmEvent(self._count, cause, now, now, 0, evidence, why)
                    changed.append(self._open[cause])
                elif event is not None and level != LEVEL_ALARM:
                    self._closed.append(replace(self._open.pop(cause), time_ns=now, end_ns=now))
                    changed.append(self._closed[-1])
                elif event is not None and evidence > event.peak_evidence:
                    why = reasons(alarms, row, cause)
                    self._open[cause] = replace(event, peak_evidence=evidence, reasons=why)
        return changed


def reasons(alarms: Alarms, row: int, causes: int | None = None) -> tuple[str, ...]:
    """Why the causes are not ok in one row, and why the model is not judged; never empty where one is not ok.

    Bad data come first, as the other causes may follow from them, and last what is over.

    Args:
        alarms: of the monitor.
        row: its index.
        causes: bits of the causes to explain; those of the row unless given.
    """
    raised = int(alarms.causes[row])
    wanted = raised if causes is None else causes
    words, over = list[str](), list[str]()
    for cause, (said, ends) in WORDS.items():
        found = said(alarms, row) if wanted & cause else []
        words += found
        if wanted & cause & raised and not found:
            judged = alarms.cause_evidence[row, CAUSES.index(cause)] > 0.0
            over.append(ends if judged else f"{CAUSE_NAMES[cause]} when last judged")
    words += over
    # Of the others the model says it once for all flights.
    if wanted & CHANGE or causes is None:
        health = alarms.cause_health[row, CAUSES.index(CHANGE)]
        words += [UNCALIBRATED_WORDS] if health == UNCALIBRATED else []
    why = int(alarms.why_not_judged[row])
    if causes is None and why != JUDGED:
        of_what = "coverage not judged" if why in (SETTLES, WIND_UNKNOWN) else "not judged"
        share = 100.0 * alarms.not_judged_share[row]
        words = [text for text in words if text != WHY_NOT_JUDGED[why]]
        words.append(f"{of_what}: {WHY_NOT_JUDGED[why]} ({share:.0f} % of the time so far)")
    return tuple(words)


def _extrapolation(alarms: Alarms, row: int) -> list[str]:
    """Inputs beyond their training range, what a pilot controls first, then leverage and width.

    Inputs are given by their distance from the middle of their training range over half of that range.
    """
    ratio = 1.0 + 2.0 * alarms.input_excess[row]
    beyond = piloted_first([INPUT_NAMES[k] for k in _beyond(ratio, OUTSIDE_RATIO, len(ratio))])[:_MOST]
    words = [f"{INPUT_WORDS[name].name} {ratio[INPUT_INDEX[name]]:.1f} {OF_RANGE}" for name in beyond]
    for says, ratios, scores, headroom in (
        ("leverage {:.1f} x its peak", alarms.leverage_ratio[row], alarms.leverage[row], LEVERAGE_HEADROOM),
        ("interval {:.1f} x its widest", alarms.width_ratio[row], alarms.width[row], WIDTH_HEADROOM),
    ):
        # Beyond the limit of the warning, or that of the alarm where it is nearer.
        far = np.where((ratios > headroom) | (scores > 1.0), ratios, 0.0)
        words += [f"{AXIS_WORDS[AXES[k]]}: {says.format(far[k])} in training" for k in _beyond(far, 0.0)]
    return words


def _miscoverage(alarms: Alarms, row: int) -> list[str]:
    """Rotors that have stopped, and axes outside their intervals; those whose test still remembers it."""
    stopped = [str(k + 1) for k in range(ROTORS_MAX) if alarms.stopped[row] & 1 << k]
    # More than one act on the body alike, and all of them read on.
    words = [f"rotor {' or '.join(stopped)} stopped"] if stopped else []
    for k in _beyond(alarms.miscoverage[row], WARNING_CHARGE):
        share = 100.0 * alarms.miss_share[row, k]
        words.append(
            f"{AXIS_WORDS[AXES[k]]} outside its interval {share:.0f} % of the time"
            if share >= _MISSES_NOW
            else f"{AXIS_WORDS[AXES[k]]} was outside its interval too often a moment ago"
        )
    return words


def _bad_data(alarms: Alarms, row: int) -> list[str]:
    carried = [WHY_NOT_JUDGED[CARRIED]] if alarms.why_not_judged[row] == CARRIED else []
    return [*fault_words(int(alarms.faults[row]), alarms.more_faults[row].tolist()), *carried]


# Of each cause, in the order in which they are said: what it says of a row, the strongest first, and what
# between the last evidence and its end, `release_s` later.
WORDS: dict[int, tuple[Callable[[Alarms, int], list[str]], str]] = {
    BAD_DATA: (_bad_data, "the data are good again: ends if that lasts"),
    CHANGE: (change_words, "the vehicle is not that of the training flights"),
    EXTRAPOLATION: (_extrapolation, "inside what was flown in training again: ends if that lasts"),
    MISCOVERAGE: (_miscoverage, "inside its intervals again: ends if that lasts"),
}
# Begins what is said where a sample lacks what other sensors give.
_OF_A_SENSOR = (STATE_MISSING_WORDS, ROTORS_MISSING_WORDS, EITHER_MISSING_WORDS, "no state")


def naming_sensors(reasons: Sequence[str], lacks: Sequence[str]) -> tuple[str, ...]:
    """Reasons; where a state or speeds are missing, the sensors that lack first, see :func:`.health.lack`."""
    others = tuple(text for text in reasons if not (lacks and text.startswith(_OF_A_SENSOR)))
    return others if len(others) == len(reasons) else (*lacks, *others)


Explain: TypeAlias = Callable[[tuple[str, ...], int], tuple[str, ...]]


class Explained:
    """Reasons of rows and events; those of bad data with what is known of the sensors at their stamps.

    Args:
        explain: makes reasons, at a stamp, those with what is known.
    """

    def __init__(self, explain: Explain = lambda reasons, _: reasons) -> None:
        self._explain = explain
        self._before_ns = NO_STAMP
        # Reasons of the events that stand, by their numbers.
        self._raised: dict[int, tuple[str, ...]] = {}

    def rows(self, alarms: Alarms) -> list[tuple[str, ...]]:
        """Why the causes are not ok, for each row of a block, as :func:`reasons`."""
        by_row = [reasons(alarms, row) for row in range(len(alarms))]
        stamps = [self._before_ns, *alarms.time_ns.tolist()]
        self._before_ns = stamps[-1]
        for row in np.flatnonzero(alarms.causes & BAD_DATA).tolist():
            words = self._explain(by_row[row], stamps[row + 1])
            # What a row says is of all samples since the row before, when a sensor that is back lacked.
            if any(text.startswith(_OF_A_SENSOR) for text in words):
                words = self._explain(by_row[row], stamps[row])
            by_row[row] = words
        return by_row

    def events(self, events: Events) -> Events:
        """Events; of bad data as known when it was raised: of its start later blocks know no more."""
        return [replace(one, reasons=self._event(one)) if one.cause == BAD_DATA else one for one in events]

    def _event(self, event: AlarmEvent) -> tuple[str, ...]:
        if event.end_ns:
            return self._raised.pop(event.number, event.reasons)
        self._raised[event.number] = found = self._explain(event.reasons, event.start_ns)
        return found


def _beyond(scores: np.ndarray, limit: float, most: int = _MOST) -> list[int]:
    """Indices of the largest scores beyond the limit, the largest first."""
    order = np.argsort(-scores, kind="stable")[:most]
    return [int(k) for k in order if scores[k] > limit]
