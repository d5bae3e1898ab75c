# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a rotor has stopped, or only its telemetry: the measured wrench tells whether its thrust is gone.

A rotor at (x, y) that loses the thrust T changes the wrench by (Fz, Mx, My) = (T, y T, −x T). The change is
that of the measured wrench less the sum of k ω² over the rotors, against its mean of the last half second,
which takes drag, load and an inexact k with it. Where Fz, Mx and My each show the loss of this rotor's
thrust, it has stopped, whatever its telemetry says. A rotor that reads 0, or gives no reading, counts with
the thrust that it had before: if that is still there, its telemetry fails. So do readings that vanish while
a controller slows rotors down, as in fast turns: the loss then proves nothing.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, Threshold, Vector3, record_dtype
from quadpi_core.vehicle import Vehicle

_CUTS = "simulated motor cuts of the Bebop 2, and 70 real flights without any"
_TAKEN_AWAY = "simulated motor cuts, and 14 INDIflight flights of up to 10 m/s, readings taken away"
LOST_SHARE = Threshold(
    "least loss of a rotor that has stopped",
    compiled.LOST_SHARE,
    "of its thrust, in each of Fz, Mx and My",
    "the arms of a vehicle file may be a third too long, and a rotor that spins down has lost most of it",
    _CUTS,
)
LOST_MOST = Threshold(
    "largest loss of a rotor that has stopped",
    compiled.LOST_MOST,
    "of its thrust, in each of Fz, Mx and My",
    "a rotor loses no more than its thrust, but inertia and arms are not exact",
    _CUTS,
)
LOST_S = Threshold(
    "time for which a rotor's thrust is gone until it is called stopped",
    compiled.LOST_S,
    "s",
    "three times the delay of the low-pass",
    _CUTS,
)
SILENT_LOST_S = Threshold(
    "the same for a rotor that gives no reading",
    compiled.SILENT_LOST_S,
    "s",
    "rotors that the controller slows down lose their thrust too, most often for less time",
    _TAKEN_AWAY,
)
STEADY_SHARE = Threshold(
    "spread of a rotor's thrust up to which its loss tells without a reading",
    compiled.STEADY_SHARE,
    "of its mean over half a second",
    "in fast turns a controller lets rotors idle; one that stops reads less for a while, which makes it 0.3",
    _TAKEN_AWAY,
)
TOGETHER_SHARE = Threshold(
    "thrust of the other rotors from which on the loss of one tells without a reading",
    compiled.TOGETHER_SHARE,
    "of their mean over half a second",
    "where they slow down, so may it; after a stop they go on carrying",
    _TAKEN_AWAY,
)
UNDECIDED_S = Threshold(
    "time for which a rotor reads 0 until its telemetry is called wrong",
    compiled.UNDECIDED_S,
    "s",
    "a rotor that stops is found within 0.15 s",
    _CUTS,
)
# Rotors that carry less than this share of their part of the weight are not judged: their loss is too small.
_LEAST_SHARE = 0.3


class RotorGeometry:
    """What is known of the rotors."""

    rotors: int
    thrust_per_square: float  # N/(rad/s)², from hover; 0 where unknown: then no rotor is called stopped
    least_square: float  # (rad/s)², below which a rotor's thrust is too small to be missed
    lever: Annotated[Array, ROTORS_MAX, 3]  # change of Fz, Mx, My per newton that a rotor loses: 1, m, m


class RotorThrust:
    """What is remembered of the samples."""

    stopped: int  # bit per rotor
    mean_squares: PerRotor  # (rad/s)², while it reads more than 0
    variances: PerRotor  # of the squares, about their means
    mean_rest: Vector3  # Fz, Mx, My that the rotors do not explain
    known_s: float  # since the means began
    lost_s: PerRotor  # for which its thrust has been gone, less the time for which it was not
    back_s: PerRotor  # for which the thrust of a stopped rotor has been back
    zero_s: PerRotor  # since readings of 0, or none, began
    since_zero_s: PerRotor  # since the last one
    zeros: int  # bit per rotor whose last such reading was a 0


def geometry_record(vehicle: Vehicle, hover_rotor_speed: float) -> Records:
    """The :class:`RotorGeometry` (1,) of a vehicle, whose rotors carry it at a speed of hover, rad/s."""
    record = np.zeros(1, record_dtype(RotorGeometry))
    record[0] = rotor_geometry(vehicle, hover_rotor_speed)
    return record


def rotor_geometry(vehicle: Vehicle, hover_rotor_speed: float) -> tuple[int, float, float, Array]:
    """The fields of :class:`RotorGeometry`."""
    square, rotors = hover_rotor_speed * hover_rotor_speed, vehicle.rotor_count
    thrust = vehicle.mass_kg * vehicle.gravity_m_s2 / (rotors * square) if square > 0.0 else 0.0
    lever = np.zeros((ROTORS_MAX, 3))
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    lever[:rotors] = np.stack((np.ones(rotors), y, -x), axis=1)
    return rotors, thrust, _LEAST_SHARE * square, lever
