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
    """An input in plain words: its name, what it is called where negative, and its unit."""

    name: str
    negative: str
    unit: str = ""
    angle: str = ""  # of which this is the "sin" or "cos"
    piloted: bool = False  # whether a pilot has a hand on it: such inputs are named first


INPUT_WORDS = {
    "u": InputWords("forward speed", "backward speed", "m/s", piloted=True),
    "v": InputWords("speed to the right", "speed to the left", "m/s", piloted=True),
    "w": InputWords("speed downward in body axes", "speed upward in body axes", "m/s", piloted=True),
    "v_in": InputWords("induced velocity", "induced velocity", "m/s"),
    "p": InputWords("roll rate to the right", "roll rate to the left", "rad/s", piloted=True),
    "q": InputWords("pitch rate nose up", "pitch rate nose down", "rad/s", piloted=True),
    "r": InputWords("yaw rate to the right", "yaw rate to the left", "rad/s", piloted=True),
    "omega_avg": InputWords("mean rotor speed", "mean rotor speed", "rad/s"),
    "sin_phi": InputWords("roll angle to the right", "roll angle to the left", "°", "sin", piloted=True),
    "cos_phi": InputWords("roll angle", "roll angle", "°", "cos", piloted=True),
    "sin_theta": InputWords("pitch angle nose up", "pitch angle nose down", "°", "sin", piloted=True),
    "cos_theta": InputWords("pitch angle", "pitch angle", "°", "cos", piloted=True),
    "U_p": InputWords("roll control to the right", "roll control to the left", "rad/s"),
    "U_q": InputWords("pitch control nose up", "pitch control nose down", "rad/s"),
    "U_r": InputWords("yaw control to the left", "yaw control to the right", "rad/s"),
    "mu_x": InputWords("forward speed over blade tip speed", "backward speed over blade tip speed"),
    "mu_y": InputWords("speed to the right over blade tip speed", "speed to the left over blade tip speed"),
    "mu_z": InputWords("downward speed over blade tip speed", "upward speed over blade tip speed"),
    "mu_v_in": InputWords("induced velocity over blade tip speed", "induced velocity over blade tip speed"),
}


def piloted_first(names: Iterable[str]) -> list[str]:
    """Names of inputs, the first one that a pilot has a hand on in front, the others as they were."""
    names = list(names)
    first = next((name for name in names if INPUT_WORDS[name].piloted), None)
    return names if first is None else [first, *(name for name in names if name != first)]
