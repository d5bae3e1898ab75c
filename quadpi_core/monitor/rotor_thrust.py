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

from quadpi_core.compiled import njit
from quadpi_core.frames import Array
from quadpi_core.monitor.data_quality import (
    GAP,
    ROTOR_FAULTS,
    ROTOR_FROZEN,
    ROTOR_JUMPS,
    ROTOR_ZERO,
    PerRotor,
)
from quadpi_core.monitor.preparation import Verdict
from quadpi_core.records import Vector3
from quadpi_core.thresholds import Threshold
from quadpi_core.vehicle import ROTORS, Vehicle

_CUTS = "simulated motor cuts of the Bebop 2, and 70 real flights without any"
_TAKEN_AWAY = "simulated motor cuts, and 14 INDIflight flights of up to 10 m/s, readings taken away"
LOST_SHARE = Threshold(
    "least loss of a rotor that has stopped",
    0.5,
    "of its thrust, in each of Fz, Mx and My",
    "the arms of a vehicle file may be a third too long, and a rotor that spins down has lost most of it",
    _CUTS,
)
LOST_MOST = Threshold(
    "largest loss of a rotor that has stopped",
    2.0,
    "of its thrust, in each of Fz, Mx and My",
    "a rotor loses no more than its thrust, but inertia and arms are not exact",
    _CUTS,
)
LOST_S = Threshold(
    "time for which a rotor's thrust is gone until it is called stopped",
    0.04,
    "s",
    "three times the delay of the low-pass",
    _CUTS,
)
SILENT_LOST_S = Threshold(
    "the same for a rotor that gives no reading",
    0.06,
    "s",
    "rotors that the controller slows down lose their thrust too, most often for less time",
    _TAKEN_AWAY,
)
STEADY_SHARE = Threshold(
    "spread of a rotor's thrust up to which its loss tells without a reading",
    0.4,
    "of its mean over half a second",
    "in fast turns a controller lets rotors idle; one that stops reads less for a while, which makes it 0.3",
    _TAKEN_AWAY,
)
TOGETHER_SHARE = Threshold(
    "thrust of the other rotors from which on the loss of one tells without a reading",
    0.5,
    "of their mean over half a second",
    "where they slow down, so may it; after a stop they go on carrying",
    _TAKEN_AWAY,
)
UNDECIDED_S = Threshold(
    "time for which a rotor reads 0 until its telemetry is called wrong",
    0.2,
    "s",
    "a rotor that stops is found within 0.15 s",
    _CUTS,
)
_LOST_SHARE, _LOST_MOST, _LOST_S = LOST_SHARE.value, LOST_MOST.value, LOST_S.value
_SILENT_LOST_S, _UNDECIDED_S = SILENT_LOST_S.value, UNDECIDED_S.value
_STEADY_SQUARE, _TOGETHER_SHARE = STEADY_SHARE.value**2, TOGETHER_SHARE.value
# Time constant [s] of the means; a mean of less than this time in flight says nothing.
_MEAN_S, _KNOWN_S = 0.5, 0.2
# A reading of 0 is reported for this long [s] after it: the telemetry fails, though it may come back.
_REPORTED_S = 0.5
# A rotor whose thrust is back for this long [s] turns again.
_BACK_S = 0.5
# Rotors that carry less than this share of their part of the weight are not judged: their loss is too small.
_LEAST_SHARE = 0.3
# Fz, Mx, My of a wrench.
_SHOWN = np.array([2, 3, 4])


class RotorGeometry:
    """What is known of the rotors."""

    thrust_per_square: float  # N/(rad/s)², from hover; 0 where unknown: then no rotor is called stopped
    least_square: float  # (rad/s)², below which a rotor's thrust is too small to be missed
    lever: Annotated[Array, ROTORS, 3]  # change of Fz, Mx, My per newton that a rotor loses: 1, m, m


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


def rotor_geometry(vehicle: Vehicle, hover_rotor_speed: float) -> tuple[float, float, Array]:
    """The fields of :class:`RotorGeometry`."""
    square = hover_rotor_speed**2
    x, y = vehicle.rotor_positions[:, 0], vehicle.rotor_positions[:, 1]
    # A rotor on an axis shows in one moment alone.
    tells = square > 0.0 and bool(np.all(x * y != 0.0))
    thrust = vehicle.mass_kg * vehicle.gravity_m_s2 / (ROTORS * square) if tells else 0.0
    return thrust, _LEAST_SHARE * square, np.stack((np.ones(ROTORS), y, -x), axis=1)


@njit(cache=True)
def forget_thrust(thrust: RotorThrust) -> None:
    """Begin anew, as on the ground."""
    thrust.stopped = 0
    thrust.known_s = 0.0
    thrust.mean_squares[:] = 0.0
    thrust.variances[:] = 0.0
    thrust.lost_s[:] = 0.0
    thrust.back_s[:] = 0.0
    thrust.zero_s[:] = 0.0
    thrust.since_zero_s[:] = np.inf


@njit(cache=True)
def follow_thrust(
    geometry: RotorGeometry, thrust: RotorThrust, sample: Verdict, wrench: Array, step_s: float
) -> int:
    """Take a sample in flight that is usable, or but for absent rotors.

    Returns its faults, with what readings of 0 mean.

    Args:
        geometry: of the vehicle.
        thrust: changes.
        sample: with filtered rotor speeds.
        wrench: (6,) measured.
        step_s: since the sample before.
    """
    faults = sample.faults
    if faults & (ROTOR_JUMPS * 15 | GAP) and sample.usable and thrust.stopped == 0:
        # A reading that was wrong, or is now, or none for long: what the means know is worth nothing.
        thrust.known_s = 0.0
    unknown, now, before = False, 0.0, 0.0
    squares = np.empty(ROTORS)
    for k in range(ROTORS):
        squares[k] = sample.rotor_speeds[k] ** 2
        reads_zero = faults & ROTOR_ZERO << k != 0
        if reads_zero or sample.absent & 1 << k:
            thrust.zeros = thrust.zeros | 1 << k if reads_zero else thrust.zeros & ~(1 << k)
            thrust.zero_s[k] += step_s
            thrust.since_zero_s[k] = 0.0
            unknown |= thrust.zero_s[k] > _UNDECIDED_S
            squares[k] = thrust.mean_squares[k]
        else:
            now += squares[k]
            before += thrust.mean_squares[k]
            thrust.since_zero_s[k] += step_s
            if thrust.since_zero_s[k] > _REPORTED_S:
                thrust.zero_s[k] = 0.0
            elif thrust.zero_s[k] > 0.0:
                thrust.zero_s[k] += step_s
    carries = now >= _TOGETHER_SHARE * before
    _find_stopped(geometry, thrust, squares, wrench, step_s if not unknown else 0.0, carries)
    return _named_faults(thrust, faults)


@njit(cache=True)
def are_stopped(thrust: RotorThrust, rotors: int) -> bool:
    """Whether there are rotors, one bit each, and all of them have stopped."""
    return bool(rotors != 0 and rotors & ~thrust.stopped == 0)


@njit(cache=True)
def _find_stopped(
    geometry: RotorGeometry, thrust: RotorThrust, squares: Array, wrench: Array, step_s: float, carries: bool
) -> None:
    """Compare the wrench with squared rotor speeds (4,), or begin anew where they are not known: step 0.

    A rotor without a reading is judged while its own thrust was steady, and the others carry as before.
    """
    if step_s == 0.0 and thrust.stopped == 0:
        thrust.known_s = 0.0
        thrust.lost_s[:] = 0.0
        return
    change = np.empty(_SHOWN.size)
    for shown in range(_SHOWN.size):
        rest = wrench[_SHOWN[shown]]
        for k in range(ROTORS):
            rest += geometry.thrust_per_square * squares[k] * geometry.lever[k, shown]
        change[shown] = rest - thrust.mean_rest[shown]
    suspected = thrust.stopped != 0
    for k in range(ROTORS):
        least, most = np.inf, -np.inf
        judged = squares[k] >= geometry.least_square > 0.0 and thrust.known_s >= _KNOWN_S
        silent = thrust.since_zero_s[k] == 0.0
        steady = thrust.variances[k] <= _STEADY_SQUARE * thrust.mean_squares[k] ** 2
        judged &= not silent or (steady and carries)
        if judged:
            expected = geometry.thrust_per_square * squares[k]
            for shown in range(_SHOWN.size):
                share = change[shown] / (geometry.lever[k, shown] * expected)
                least, most = min(least, share), max(most, share)
        is_lost = judged and least >= _LOST_SHARE and most <= _LOST_MOST
        thrust.lost_s[k] = max(0.0, thrust.lost_s[k] + (step_s if is_lost else -step_s))
        if thrust.stopped & 1 << k:
            is_back = judged and most < 0.5 * _LOST_SHARE and not silent
            thrust.back_s[k] = thrust.back_s[k] + step_s if is_back else 0.0
            if thrust.back_s[k] >= _BACK_S:
                forget_thrust(thrust)
                return
        elif thrust.stopped == 0 and thrust.lost_s[k] >= (_SILENT_LOST_S if silent else _LOST_S):
            thrust.stopped |= 1 << k
        suspected |= thrust.lost_s[k] > 0.0 or silent
    if suspected:
        return
    share = step_s / (min(thrust.known_s, _MEAN_S) + step_s)
    thrust.known_s += step_s
    for shown in range(_SHOWN.size):
        thrust.mean_rest[shown] += share * change[shown]
    for k in range(ROTORS):
        off = squares[k] - thrust.mean_squares[k]
        thrust.variances[k] += share * (off * off - thrust.variances[k])
        thrust.mean_squares[k] += share * off


@njit(cache=True)
def _named_faults(thrust: RotorThrust, faults: int) -> int:
    """Faults with a reading of 0 reported once it is decided that the thrust is there, and for a while."""
    named = faults & ~(ROTOR_ZERO * 15)
    if thrust.stopped != 0:
        # Rotors are no longer compared: one that is slow may balance the one that stopped.
        named &= ~ROTOR_FAULTS
        for k in range(ROTORS):
            if not thrust.stopped & 1 << k:
                named |= faults & (ROTOR_FROZEN | ROTOR_JUMPS) << k
        return named
    for k in range(ROTORS):
        is_reported = thrust.since_zero_s[k] <= _REPORTED_S and thrust.zero_s[k] >= _UNDECIDED_S
        if is_reported and thrust.zeros & 1 << k:
            named |= ROTOR_ZERO << k
    return named
