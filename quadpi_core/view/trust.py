# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the model can be trusted now, in one word, and why not, in the words of a pilot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.flight import AXES, MAX_GAP_NS, OdometryStream, RotorSpeedStream, Stamps, WindStream
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, aerodynamic_inputs, relative_to_air
from quadpi_core.messages.result_messages import DescribedModel
from quadpi_core.models.alarm_limits import allowance
from quadpi_core.monitor.alarm_log import AXIS_WORDS, INPUT_WORDS, OF_RANGE, OUTSIDE_RATIO, piloted_first
from quadpi_core.results import (
    ACTIVE,
    BAD_DATA,
    CAUSE_NAMES,
    CAUSES,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_WARNING,
    MISCOVERAGE,
    UNCALIBRATED,
    UNCALIBRATED_WORDS,
    ReportedAlarms,
)
from quadpi_core.vehicle import Vehicle


class State(IntEnum):
    """What the page says first; the codes of the column `state`."""

    TRUSTED = 0
    WARNING = 1
    ALARM = 2
    NO_DATA = 3
    NOT_JUDGED = 4


# An alarm message comes ten times a second (`alarm_rate_hz`): after this long without one, nobody is judging.
SILENCE_S = 1.0
_JUDGED = (ACTIVE, UNCALIBRATED)
# Inputs that a reason names; the envelope's panel shows all.
_MOST = 3
# Share of the training range from which on an input is said to be outside, as of the monitor's own words.
_OUTSIDE = 0.5 * (OUTSIDE_RATIO - 1.0)
TRAINED = ", trained "
# The coverage beside the word is that of so many seconds, once there are so many.
COVERED_S, LEAST_COVERED_S = 10.0, 2.0


def states_of(alarms: ReportedAlarms) -> list[State]:
    """The state that each alarm message says."""
    states = []
    for row, (level, has_sample) in enumerate(zip(alarms.level, alarms.of_samples, strict=True)):
        if not has_sample:
            states.append(State.NO_DATA)
        elif level == LEVEL_ALARM:
            states.append(State.ALARM)
        elif level == LEVEL_WARNING:
            states.append(State.WARNING)
        else:
            states.append(State.TRUSTED if is_judged(alarms, row) else State.NOT_JUDGED)
    return states


def is_judged(alarms: ReportedAlarms, row: int) -> bool:
    """Whether both where the vehicle flies and its intervals are judged: not so while the state settles."""
    return all(alarms.cause_health[row, CAUSES.index(one)] in _JUDGED for one in (EXTRAPOLATION, MISCOVERAGE))


def reasons_of(
    alarms: ReportedAlarms, row: int, training: DescribedModel | None, low: Array, high: Array
) -> tuple[str, ...]:
    """Why one message is not `trusted`, in plain words, what is farthest outside first.

    Args:
        alarms: messages.
        row: of them.
        training: ranges of the model that flies; None where they are not known here.
        low: (19,) smallest inputs around the message, NaN where not known.
        high: (19,) largest inputs.
    """
    if not alarms.of_samples[row]:
        return tuple(alarms.reasons[row]) or ("nothing arrives",)
    given = alarms.reasons[row]
    if alarms.level[row] < LEVEL_WARNING:
        if is_judged(alarms, row):
            return tuple(text for text in given if text == UNCALIBRATED_WORDS)
        return tuple(given) or ("on the ground, or the state settles",)
    words: list[str] = []
    if training is not None and alarms.causes[row] & EXTRAPOLATION:
        words = _outside(alarms.inputs_outside[row], training, low, high)
    if words:
        # In the place of what the monitor says of them.
        first = len(given) if alarms.causes[row] & BAD_DATA else 0
        place = next((k for k, text in enumerate(given) if text.endswith(OF_RANGE)), first)
        rest = [text for text in given[place:] if not text.endswith(OF_RANGE)]
        return (*given[:place], *words, *rest)
    words = list(given)
    if not words:
        named = " and ".join(CAUSE_NAMES[cause] for cause in CAUSES if alarms.causes[row] & cause)
        words = [f"{named or 'no cause'}: the message says no more"]
    return tuple(words)


def too_many_misses(inside: Array, held: Sequence[str], confidence: float) -> str | None:
    """Which axis lay outside its interval too often of late for any trust; None if none did.

    Too often is where more misses than allowed are likelier than the allowed ones: the reference value of
    the monitor's own test, which waits for more of them before it warns.

    Args:
        inside: (6,) share of the samples of the last :data:`COVERED_S` inside; NaN where there are too few.
        held: axes of the model.
        confidence: nominal coverage of its intervals.
    """
    least, axis = min((float(inside[AXES.index(axis)]), axis) for axis in held or AXES)
    if not 0.0 < confidence < 1.0 or not least < 1.0 - allowance(confidence):
        return None
    outside = f"{100.0 * (1.0 - least):.0f} % of the last {COVERED_S:.0f} s"
    return f"{AXIS_WORDS[axis]} outside its interval {outside}, {100.0 * (1.0 - confidence):.3g} % allowed"


def _outside(names: Sequence[str], training: DescribedModel, low: Array, high: Array) -> list[str]:
    sentences = []
    for name in piloted_first([name for name in names if name in INPUT_WORDS]):
        k = INPUT_NAMES.index(name)
        sentence = outside_words(name, (low[k], high[k]), (training.lower[k], training.upper[k]))
        if sentence:
            sentences.append(sentence)
    return sentences[:_MOST]


def outside_words(name: str, values: tuple[float, float], training: tuple[float, float]) -> str | None:
    """Such as "forward speed 11.3 m/s, trained up to 5.6"; None for an input that is inside, or nearly.

    Args:
        name: of the input.
        values: smallest and largest of the last moments.
        training: its training range.
    """
    (low, high), margin = training, _OUTSIDE * (training[1] - training[0])
    if not np.isfinite(values).all() or low - margin <= values[0] <= values[1] <= high + margin:
        return None
    words = INPUT_WORDS[name]
    above = values[1] - high >= low - values[0]
    value, limit = (values[1], high) if above else (values[0], low)
    if words.angle:
        value, limit = _angle(value, words.angle), _angle(limit, words.angle)
        # The least cosine is the largest angle.
        above = above != (words.angle == "cos")
    called, other = words.positive, words.negative
    if value < 0.0:
        called, other, value, limit, above = other, called, -value, -limit, not above
    of_number, of_limit = ("°", "°") if words.unit == "°" else (f" {words.unit}".rstrip(), "")
    more = next((k for k in range(3) if float(_number(value, k)) != float(_number(limit, k))), 0)
    trained = f"{'up' if above else 'down'} to {_number(limit, more)}{of_limit}"
    if limit < 0.0:
        trained = f"only {other} {_number(-limit, more)}{of_limit} and more"
    return f"{called} {_number(value, more)}{of_number}{TRAINED}{trained}"


def _angle(value: float, kind: str) -> float:
    clipped = min(1.0, max(-1.0, float(value)))
    return float(np.degrees(np.arccos(clipped) if kind == "cos" else np.arcsin(clipped)))


def _number(value: float, more: int) -> str:
    """Two significant digits or one decimal, whichever says more, and some more of them."""
    return f"{value:.{more + (abs(value) < 100.0)}f}" if abs(value) >= 1.0 else f"{value:.{2 + more}g}"


# The monitor low-passes its inputs; the page draws the mean of 50 ms, which is as smooth.
STRETCH_NS = 50_000_000


class MotionInputs:
    """Input vectors of one vehicle.

    Args:
        vehicle: as in its vehicle file.

    Attributes:
        problem: why they are not known; empty where they are.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self.problem = ""
        self._wind = np.zeros(3)
        self._vehicle = vehicle
        self._rotor_ns: Stamps = np.empty(0, dtype=np.int64)
        self._speeds = np.empty((0, vehicle.rotor_count))

    def take(
        self, states: OdometryStream | None, rotors: RotorSpeedStream | None, wind: WindStream | None
    ) -> tuple[Stamps, Array]:
        """Stamps (K,) and inputs (K, 19) of stretches of the states that have rotor speeds near them."""
        nothing = np.empty(0, dtype=np.int64), np.empty((0, len(INPUT_NAMES)))
        if wind is not None and len(wind.velocity):
            self._wind = wind.velocity[-1]
        if rotors is not None and len(rotors.time_ns):
            count = self._vehicle.rotor_count
            if rotors.speeds.shape[1] != count:
                self.problem = (
                    f"topic rotor_speeds: {rotors.speeds.shape[1]} rotors, vehicle {self._vehicle.name} has "
                    f"{count}: its inputs are not known"
                )
                return nothing
            # The last of before, for states between it and the first of now.
            self._rotor_ns = np.append(self._rotor_ns[-1:], rotors.time_ns)
            self._speeds = np.append(self._speeds[-1:], rotors.speeds, axis=0)
        if states is None or not len(self._rotor_ns):
            return nothing
        after = np.clip(np.searchsorted(self._rotor_ns, states.time_ns), 1, len(self._rotor_ns)) - 1
        near = np.abs(states.time_ns - self._rotor_ns[after]) <= MAX_GAP_NS
        if not near.any():
            return nothing
        time_ns = states.time_ns[near]
        speeds = [
            np.interp(time_ns, self._rotor_ns, self._speeds[:, rotor])
            for rotor in range(self._speeds.shape[1])
        ]
        first = np.flatnonzero(np.diff(time_ns // STRETCH_NS, prepend=-1))
        last = np.append(first[1:], len(time_ns)) - 1
        rows = np.column_stack((states.velocity[near], states.rates[near], *speeds))
        rows = np.add.reduceat(rows, first) / (last - first + 1)[:, None]
        attitude = states.attitude[near][last]
        velocity_air = relative_to_air(rows[:, :3], attitude, np.tile(self._wind, (len(rows), 1)))
        inputs = aerodynamic_inputs(
            velocity_air,
            attitude,
            np.ascontiguousarray(rows[:, 3:6]),
            np.ascontiguousarray(rows[:, 6:]),
            self._vehicle,
        )
        return time_ns[last], inputs


class Told(NamedTuple):
    """Words for one thing, from a stamp on; 0 is at once."""

    time_ns: int
    name: str
    words: str


# After this long [s] without a message it is said that none comes: an autopilot sends each at 0.5 Hz or more.
TOLD_S = 5.0
NO_MESSAGE = f"no message for {TOLD_S:.0f} s"


class Report(NamedTuple):
    """Fields that are read of a message, with how many numbers each has (0: text), and the words for them."""

    name: str
    fields: dict[str, int]
    words: Callable[[Mapping[str, Any]], str]


def _battery(given: Mapping[str, Any]) -> str:
    voltage, share = float(given["voltage"]), float(given["percentage"])
    # NaN where it is not measured.
    known = [f"{voltage:.1f} V"] if math.isfinite(voltage) else []
    known += [f"{100.0 * share:.0f} %"] if 0.0 <= share <= 1.0 else []
    return ", ".join(known) or "not measured"


def _autopilot(given: Mapping[str, Any]) -> str:
    armed = "armed" if given["armed"] else "not armed"
    link = "" if given["connected"] else ", link lost"
    mode = given["mode"].decode(errors="replace") if isinstance(given["mode"], bytes) else given["mode"]
    return f"{mode or 'unknown'}, {armed}{link}"


REPORTS = {
    "sensor_msgs/msg/BatteryState": Report("battery", {"voltage": 1, "percentage": 1}, _battery),
    "mavros_msgs/msg/State": Report("flight mode", {"connected": 1, "armed": 1, "mode": 0}, _autopilot),
}
