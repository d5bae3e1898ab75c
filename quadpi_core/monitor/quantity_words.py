# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One name for each quantity, in a pilot's words: on the page, in the topics and in the log."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from quadpi_core.flight import AXES

# Of the wrench; body axes forward-right-down.
AXIS_WORDS = dict(
    zip(
        AXES,
        (
            *("forward force", "force to the right", "downward force"),
            *("roll moment", "pitch moment", "yaw moment"),
        ),
        strict=True,
    )
)

# How the monitor ends what it says of an input: it knows how far that is out, not on which side.
OF_RANGE = "x the training range"


class InputWords(NamedTuple):
    """An input in plain words: its name, what it is where positive and where negative, and its unit."""

    name: str
    positive: str
    negative: str
    unit: str = ""
    angle: str = ""  # of which this is the "sin" or "cos"
    piloted: bool = False  # whether a pilot has a hand on it: such inputs are named first


def _rate(name: str, positive: str, negative: str) -> InputWords:
    return InputWords(name, f"{name} {positive}", f"{name} {negative}", "rad/s", piloted=True)


def _angle(name: str, positive: str, negative: str) -> tuple[InputWords, InputWords]:
    sine = InputWords(name, f"{name} {positive}", f"{name} {negative}", "°", "sin", piloted=True)
    return sine, InputWords(name, name, name, "°", "cos", piloted=True)


def _plain(name: str, unit: str = "") -> InputWords:
    return InputWords(name, name, name, unit)


_ALONG = ("forward or backward speed", "forward speed", "backward speed")
_ACROSS = ("sideways speed", "speed to the right", "speed to the left")
_VERTICAL = ("vertical speed", "downward speed", "upward speed")
_RIGHT_LEFT, _NOSE = ("to the right", "to the left"), ("nose up", "nose down")
_ROLL, _PITCH = _angle("roll angle", *_RIGHT_LEFT), _angle("pitch angle", *_NOSE)
INPUT_WORDS = {
    "u": InputWords(*_ALONG, "m/s", piloted=True),
    "v": InputWords(*_ACROSS, "m/s", piloted=True),
    "w": InputWords(*(f"{words} in body axes" for words in _VERTICAL), "m/s", piloted=True),
    "v_in": _plain("induced velocity", "m/s"),
    "p": _rate("roll rate", *_RIGHT_LEFT),
    "q": _rate("pitch rate", *_NOSE),
    "r": _rate("yaw rate", *_RIGHT_LEFT),
    "omega_avg": _plain("mean rotor speed", "rad/s"),
    "sin_phi": _ROLL[0],
    "cos_phi": _ROLL[1],
    "sin_theta": _PITCH[0],
    "cos_theta": _PITCH[1],
    "U_p": InputWords("roll control", "roll control to the right", "roll control to the left", "rad/s"),
    "U_q": InputWords("pitch control", "pitch control nose up", "pitch control nose down", "rad/s"),
    # Rotors that turn clockwise yaw the body to the left.
    "U_r": InputWords("yaw control", "yaw control to the left", "yaw control to the right", "rad/s"),
    "mu_x": InputWords(*(f"{words} over tip speed" for words in _ALONG)),
    "mu_y": InputWords(*(f"{words} over tip speed" for words in _ACROSS)),
    "mu_z": InputWords(*(f"{words} over tip speed" for words in _VERTICAL)),
    "mu_v_in": _plain("induced velocity over tip speed"),
}


def piloted_first(names: Iterable[str]) -> list[str]:
    """Names of inputs, the first one that a pilot has a hand on in front, the others as they were."""
    names = list(names)
    first = next((name for name in names if INPUT_WORDS[name].piloted), None)
    return names if first is None else [first, *(name for name in names if name != first)]
