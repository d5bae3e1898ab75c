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

import numpy as np

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.monitor.data_quality import second_fastest
from quadpi_core.monitor.preparation import Verdict
from quadpi_core.records import Vector3
from quadpi_core.results import CARRIED, IDLES, JUDGED, LANDS, MOVED, PARKED
from quadpi_core.sample_limits import STANDARD_GRAVITY
from quadpi_core.thresholds import Threshold

_FLIGHTS = "imrc_brushless, imrc_brushed, imrc_payload, neurobem and indiflight: 70 real flights"
LIFTED = Threshold(
    "share of the weight that rotors carry in flight",
    0.9,
    "of the square of the rotor speed in hover",
    "at take-off the ground carries the rest, and the measured wrench is not aerodynamic",
    _FLIGHTS,
)
TURNING = Threshold(
    "share of the weight below which rotors do not carry the vehicle",
    0.2,
    "of the square of the rotor speed in hover",
    "rotors idle at 0.07 to 0.17; in hover, speeds that all read half are 0.25",
    _FLIGHTS,
)
RESTING = Threshold(
    "share of the weight below which rotors are at rest, or without telemetry",
    0.01,
    "of the square of the rotor speed in hover",
    "a tenth of the speed of hover: rotors idle at a quarter and more",
    _FLIGHTS,
)
MOVES_M_S = Threshold(
    "speed of a vehicle that moves", 0.3, "m/s", "an estimate at rest drifts by less", _FLIGHTS
)
MOVES_RAD_S = Threshold("rate of a vehicle that turns", 0.5, "rad/s", "hover stays below 0.35", _FLIGHTS)
MOVES_G = Threshold(
    "difference of the specific force from that at rest",
    0.2,
    "g",
    "hover stays within 0.12, rotors that idle shake by less",
    _FLIGHTS,
)
GONE_M = Threshold(
    "way of a vehicle that moves slowly", 0.2, "m", "of 5 s: an estimate at rest drifts by less", _FLIGHTS
)
SUPPORTED_G = Threshold(
    "specific force of a vehicle that something else than its rotors carries",
    0.6,
    "g",
    "a ship's deck heaves by 0.2 g; in a fall, rotors below 0.2 of the weight leave 0.2 g and some drag",
    "none: physics",
)
SUPPORTED_S = Threshold(
    "time for which it is carried until it has landed", 0.3, "s", "longer than a dip of the thrust", _FLIGHTS
)
# Time [s] after which the way is forgotten, and for which a vehicle must move to be called carried.
_WAY_S, _CARRIED_S = 5.0, 0.3

_LIFTED, _TURNING, _RESTING = LIFTED.value, TURNING.value, RESTING.value
_MOVES_M_S, _MOVES_RAD_S, _MOVES_G, _GONE_M = MOVES_M_S.value, MOVES_RAD_S.value, MOVES_G.value, GONE_M.value
_SUPPORTED_G, _SUPPORTED_S = SUPPORTED_G.value, SUPPORTED_S.value


class Ground:
    """What is remembered of the samples."""

    flying: bool
    why: int  # why the vehicle is not judged: of `quadpi_core.results`, JUDGED while it surely flies
    supported_s: float  # for which something else than the rotors has carried it
    moving_s: float  # for which it has moved, up to a limit, less the time at rest
    way: Vector3  # m, gone in the last few seconds, world


@njit(cache=True)
def _length(vector: Array) -> float:
    """Length of a vector (3,), without an array in between."""
    return float(np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]))


@njit(cache=True)
def follow_ground(ground: Ground, hover_square: float, sample: Verdict, step_s: float) -> None:
    """Take a usable sample.

    Args:
        ground: changes.
        hover_square: (rad/s)², of the rotor speed in hover; 0 where unknown: then the vehicle always flies.
        sample: with its filtered signals.
        step_s: since the sample before.
    """
    keep = _WAY_S / (_WAY_S + step_s)
    for k in range(ground.way.size):
        ground.way[k] = keep * (ground.way[k] + step_s * sample.velocity[k])
    force = _length(sample.specific_force) / STANDARD_GRAVITY
    moves = (
        _length(sample.velocity) >= _MOVES_M_S
        or _length(sample.rates) >= _MOVES_RAD_S
        or abs(force - 1.0) >= _MOVES_G
        or _length(ground.way) >= _GONE_M
    )
    ground.moving_s = min(max(ground.moving_s + (step_s if moves else -step_s), 0.0), 2.0 * _CARRIED_S)
    square = second_fastest(sample.rotor_speeds) ** 2
    if not ground.flying:
        ground.flying = square >= (_TURNING if moves else _LIFTED) * hover_square
        ground.supported_s = 0.0
    elif square < _TURNING * hover_square and force >= _SUPPORTED_G:
        ground.supported_s += step_s
        ground.flying = ground.supported_s < _SUPPORTED_S
    else:
        ground.supported_s = 0.0
    if ground.flying:
        ground.why = LANDS if ground.supported_s > 0.0 else JUDGED
    elif square >= _RESTING * hover_square:
        ground.why = MOVED if ground.moving_s >= _CARRIED_S else IDLES
    else:
        ground.why = CARRIED if ground.moving_s >= _CARRIED_S else PARKED
