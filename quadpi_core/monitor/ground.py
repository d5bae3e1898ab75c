# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether the vehicle flies, from rotors, motion and specific force together; where they disagree, it flies.

The rotors count by the second fastest of them, so neither a sensor that reads 0 nor one that reads too much
decides. What they carry is known from hover on the training flights, and may be wrong: a load is dropped, a
propeller changed. So they tell alone only at the ends: from :data:`LIFTED` of the weight on it flies, below
:data:`TURNING` something else carries it, unless it falls. Between these it flies once it moves, and then
until something else carries it: rotors that slow down in flight are no landing. While that is not yet sure,
nothing is judged: at a landing rotors leave the training range.
"""

from __future__ import annotations

from quadpi_core.core import compiled
from quadpi_core.records import Threshold, Vector3

_FLIGHTS = "imrc_brushless, imrc_brushed, imrc_payload, neurobem and indiflight: 70 real flights"
LIFTED = Threshold(
    "share of the weight that rotors carry in flight",
    compiled.LIFTED,
    "of the square of the rotor speed in hover",
    "at take-off the ground carries the rest, and the measured wrench is not aerodynamic",
    _FLIGHTS,
)
TURNING = Threshold(
    "share of the weight below which rotors do not carry the vehicle",
    compiled.TURNING,
    "of the square of the rotor speed in hover",
    "rotors idle at 0.07 to 0.17; in hover, speeds that all read half are 0.25",
    _FLIGHTS,
)
RESTING = Threshold(
    "share of the weight below which rotors are at rest, or without telemetry",
    compiled.RESTING,
    "of the square of the rotor speed in hover",
    "a tenth of the speed of hover: rotors idle at a quarter and more",
    _FLIGHTS,
)
MOVES_M_S = Threshold(
    "speed of a vehicle that moves", compiled.MOVES_M_S, "m/s", "an estimate at rest drifts by less", _FLIGHTS
)
MOVES_RAD_S = Threshold(
    "rate of a vehicle that turns", compiled.MOVES_RAD_S, "rad/s", "hover stays below 0.35", _FLIGHTS
)
MOVES_G = Threshold(
    "difference of the specific force from that at rest",
    compiled.MOVES_G,
    "g",
    "hover stays within 0.12, rotors that idle shake by less",
    _FLIGHTS,
)
GONE_M = Threshold(
    "way of a vehicle that moves slowly",
    compiled.GONE_M,
    "m",
    "of 5 s: an estimate at rest drifts by less",
    _FLIGHTS,
)
SUPPORTED_G = Threshold(
    "specific force of a vehicle that something else than its rotors carries",
    compiled.SUPPORTED_G,
    "g",
    "a ship's deck heaves by 0.2 g; in a fall, rotors below 0.2 of the weight leave 0.2 g and some drag",
    "none: physics",
)
SUPPORTED_S = Threshold(
    "time for which it is carried until it has landed",
    compiled.SUPPORTED_S,
    "s",
    "longer than a dip of the thrust",
    _FLIGHTS,
)


class Ground:
    """What is remembered of the samples."""

    flying: bool
    why: int  # why the vehicle is not judged: of `quadpi_core.results`, JUDGED while it surely flies
    supported_s: float  # for which something else than the rotors has carried it
    moving_s: float  # for which it has moved, up to a limit, less the time at rest
    way: Vector3  # m, gone in the last few seconds, world
