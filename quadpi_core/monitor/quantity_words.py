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


def _of(words: InputWords, what: str) -> InputWords:
    """The name of something of an input, such as its ratio to another."""
    name, positive, negative = (f"{one} {what}" for one in words[:3])
    return InputWords(name, positive, negative)


_ALONG = InputWords("forward or backward speed", "forward speed", "backward speed", "m/s", piloted=True)
_ACROSS = InputWords("sideways speed", "speed to the right", "speed to the left", "m/s", piloted=True)
_VERTICAL = InputWords("vertical speed", "downward speed", "upward speed")
_INDUCED = _plain("induced velocity", "m/s")
_TO_TIPS = "over tip speed"
_RIGHT_LEFT, _NOSE = ("to the right", "to the left"), ("nose up", "nose down")
_ROLL, _PITCH = _angle("roll angle", *_RIGHT_LEFT), _angle("pitch angle", *_NOSE)
INPUT_WORDS = {
    "u": _ALONG,
    "v": _ACROSS,
    "w": _of(_VERTICAL, "in body axes")._replace(unit="m/s", piloted=True),
    "v_in": _INDUCED,
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
    "mu_x": _of(_ALONG, _TO_TIPS),
    "mu_y": _of(_ACROSS, _TO_TIPS),
    "mu_z": _of(_VERTICAL, _TO_TIPS),
    "mu_v_in": _of(_INDUCED, _TO_TIPS),
}


def piloted_first(names: Iterable[str]) -> list[str]:
    """Names of inputs, the first one that a pilot has a hand on in front, the others as they were."""
    names = list(names)
    first = next((name for name in names if INPUT_WORDS[name].piloted), None)
    return names if first is None else [first, *(name for name in names if name != first)]
