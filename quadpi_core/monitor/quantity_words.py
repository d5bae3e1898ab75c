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
