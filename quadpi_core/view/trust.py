# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the model can be trusted now, in one word, and why not, in the words of a pilot."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.messages.model_description import DescribedModel
from quadpi_core.results import (
    ACTIVE,
    CAUSES,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_WARNING,
    MISCOVERAGE,
    UNAVAILABLE,
    UNCALIBRATED,
    ReportedAlarms,
)


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


class InputWords(NamedTuple):
    """An input in plain words: its name, what it is where positive and where negative, and its unit."""

    name: str
    positive: str
    negative: str
    unit: str
    angle: str = ""  # of which this is the "sin" or "cos"


INPUT_WORDS = {
    "u": InputWords("longitudinal speed", "forward speed", "backward speed", "m/s"),
    "v": InputWords("lateral speed", "speed to the right", "speed to the left", "m/s"),
    "w": InputWords(
        "vertical speed in body axes", "speed downward in body axes", "speed upward in body axes", "m/s"
    ),
    "v_in": InputWords("induced velocity", "induced velocity", "induced velocity", "m/s"),
    "p": InputWords("roll rate", "roll rate to the right", "roll rate to the left", "rad/s"),
    "q": InputWords("pitch rate", "pitch rate nose up", "pitch rate nose down", "rad/s"),
    "r": InputWords("yaw rate", "yaw rate to the right", "yaw rate to the left", "rad/s"),
    "omega_avg": InputWords("mean rotor speed", "mean rotor speed", "mean rotor speed", "rad/s"),
    "sin_phi": InputWords("roll angle", "roll angle to the right", "roll angle to the left", "°", "sin"),
    "cos_phi": InputWords("roll angle", "roll angle", "roll angle", "°", "cos"),
    "sin_theta": InputWords("pitch angle", "pitch angle nose up", "pitch angle nose down", "°", "sin"),
    "cos_theta": InputWords("pitch angle", "pitch angle", "pitch angle", "°", "cos"),
    "U_p": InputWords("roll control", "roll control to the right", "roll control to the left", "rad/s"),
    "U_q": InputWords("pitch control", "pitch control nose up", "pitch control nose down", "rad/s"),
    "U_r": InputWords("yaw control", "yaw control", "yaw control, negative", "rad/s"),
    "mu_x": InputWords("longitudinal advance ratio", "forward advance ratio", "backward advance ratio", ""),
    "mu_y": InputWords(
        "lateral advance ratio", "advance ratio to the right", "advance ratio to the left", ""
    ),
    "mu_z": InputWords("vertical advance ratio", "downward advance ratio", "upward advance ratio", ""),
    "mu_v_in": InputWords("induced inflow ratio", "induced inflow ratio", "induced inflow ratio", ""),
}


def states_of(alarms: ReportedAlarms) -> list[State]:
    """The state that each alarm message says."""
    extrapolation = alarms.cause_health[:, CAUSES.index(EXTRAPOLATION)]
    states = []
    for row, (level, has_sample) in enumerate(zip(alarms.level, alarms.of_samples, strict=True)):
        if not has_sample:
            states.append(State.NO_DATA)
        elif level == LEVEL_ALARM:
            states.append(State.ALARM)
        elif level == LEVEL_WARNING:
            states.append(State.WARNING)
        else:
            states.append(State.TRUSTED if extrapolation[row] in _JUDGED else State.NOT_JUDGED)
    return states


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
        health = alarms.cause_health[row]
        if health[CAUSES.index(EXTRAPOLATION)] not in _JUDGED:
            return tuple(given) or ("on the ground, or the state settles",)
        settles = health[CAUSES.index(MISCOVERAGE)] not in (*_JUDGED, UNAVAILABLE)
        if not settles:
            return ()
        return tuple(given) or ("coverage is judged once the state has settled",)
    words: list[str] = []
    if training is not None and alarms.causes[row] & EXTRAPOLATION:
        words = _outside(alarms.inputs_outside[row], training, low, high)
    said = INPUT_NAMES if words else ()
    words += [plain(text) for text in given if text.partition(" ")[0] not in said]
    return tuple(words)


def plain(reason: str) -> str:
    """A reason of a message with the words of an input behind its symbol."""
    symbol, _, rest = reason.partition(" ")
    if symbol not in INPUT_WORDS:
        return reason
    return f"outside: {INPUT_WORDS[symbol].name} ({symbol}) {rest}"


def _outside(names: Sequence[str], training: DescribedModel, low: Array, high: Array) -> list[str]:
    sentences = []
    for name in names:
        if name not in INPUT_WORDS:
            continue
        k = INPUT_NAMES.index(name)
        sentence = outside_words(name, (low[k], high[k]), (training.lower[k], training.upper[k]))
        if sentence:
            sentences.append(sentence)
    return sentences[:_MOST]


def outside_words(name: str, values: tuple[float, float], training: tuple[float, float]) -> str | None:
    """Such as "outside: forward speed 9.8 of 8.1 m/s flown in training"; None for an input inside.

    Args:
        name: of the input.
        values: smallest and largest of the last moments.
        training: its training range.
    """
    low, high = training
    if not np.isfinite(values).all() or low <= values[0] <= values[1] <= high:
        return None
    words = INPUT_WORDS[name]
    above = values[1] - high >= low - values[0]
    value, limit = (values[1], high) if above else (values[0], low)
    if words.angle:
        value, limit = _angle(value, words.angle), _angle(limit, words.angle)
        # The least cosine is the largest angle.
        above = above != (words.angle == "cos")
    called = words.positive if value >= 0.0 else words.negative
    unit = words.unit if words.unit in ("", "°") else f" {words.unit}"
    if limit != 0.0 and (limit > 0.0) == above:
        return f"outside: {called} {_number(abs(value))} of {_number(abs(limit))}{unit} flown in training"
    side = "above" if above else "below"
    return f"outside: {called} {_number(value)}{unit}, {side} the {_number(limit)}{unit} flown in training"


def _angle(value: float, kind: str) -> float:
    clipped = min(1.0, max(-1.0, float(value)))
    return float(np.degrees(np.arccos(clipped) if kind == "cos" else np.arcsin(clipped)))


def _number(value: float) -> str:
    """Two significant digits or one decimal, whichever says more."""
    return f"{value:.0f}" if abs(value) >= 100.0 else f"{value:.1f}" if abs(value) >= 1.0 else f"{value:.2g}"
