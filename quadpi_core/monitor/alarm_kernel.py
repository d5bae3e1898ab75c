# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the alarm, see core/include/quadpi/monitor/alarm_state.hpp: its limits, rows and state."""

from __future__ import annotations

from typing import Annotated, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import AXES, NO_STAMP
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.change import Change, ChangeFound, SoundNoise, nothing_found
from quadpi_core.monitor.preparation import MoreFaults
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, Threshold, Vector3, record_dtype
from quadpi_core.results import CAUSES, NO_SAMPLES
from quadpi_core.vehicle import Vehicle

# A rotor at (x, y) that loses the thrust T changes the wrench by (Fz, Mx, My) = (T, y T, −x T). The change is
# that of the measured wrench less the sum of k ω² over the rotors, against its mean of the last half second,
# which takes drag, load and an inexact k with it. Where Fz, Mx and My each show the loss of this rotor's
# thrust, it has stopped, whatever its telemetry says. A rotor that reads 0, or gives no reading, counts with
# the thrust that it had before: if that is still there, its telemetry fails. So do readings that vanish while
# a controller slows rotors down, as in fast turns: the loss then proves nothing.

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


# The rotors count by the second fastest of them, so neither a sensor that reads 0 nor one that reads too much
# decides. What they carry is known from hover on the training flights, and may be wrong: a load is dropped, a
# propeller changed. So they tell alone only at the ends: from :data:`LIFTED` of the weight on it flies, below
# :data:`TURNING` something else carries it, unless it falls. Between these it flies once it moves, and then
# until something else carries it: rotors that slow down in flight are no landing. While that is not yet sure,
# nothing is judged: at a landing rotors leave the training range.

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


WARNING_CHARGE, ROUNDING, STEP_MAX_S = compiled.WARNING_CHARGE, compiled.ROUNDING, compiled.STEP_MAX_S

_PerInput: TypeAlias = Annotated[Array, len(INPUT_NAMES)]
_PerAxis: TypeAlias = Annotated[Array, len(AXES)]
_PerCause: TypeAlias = Annotated[Array, len(CAUSES)]
_WholePerCause: TypeAlias = Annotated[npt.NDArray[np.int64], len(CAUSES)]


class Limits:
    """Limits of the signals, `near_` those of a warning, and the times that the alarm follows them in.

    The distance of an input is from the middle of its training range, in half widths: 1 at the ends.
    """

    lower: _PerInput
    upper: _PerInput
    scale: _PerInput  # width of the training range
    distance: _PerInput
    near_distance: _PerInput
    leverage: _PerAxis
    near_leverage: _PerAxis
    width: _PerAxis
    near_width: _PerAxis
    miscoverage_s: (
        _PerAxis  # of the cumulative sum of misses; infinite for an axis that the model does not hold
    )
    interval_ratio: (
        _PerAxis  # width of the intervals that the limits were calibrated with over that of those used
    )
    allowance: float  # share of misses at which the sum neither rises nor falls
    persistence_s: float
    release_s: float
    hover_square: float  # (rad/s)², squared rotor speed in hover; 0 where unknown
    rotors: RotorGeometry
    period_ns: int  # of the rows between changes
    health_in_flight: int  # ACTIVE, or UNCALIBRATED
    change: SoundNoise


class Row:
    """An alarm row as it is published; its evidence and faults are those since the row before it."""

    time_ns: int
    level: int
    causes: int
    cause_level: _WholePerCause
    cause_health: _WholePerCause
    cause_evidence: _PerCause
    leverage: _PerAxis
    width: _PerAxis
    miscoverage: _PerAxis
    miss_share: _PerAxis
    input_score: _PerInput
    input_excess: _PerInput
    faults: int
    more_faults: MoreFaults
    stopped: int  # bit per rotor
    why_not_judged: int  # of `quadpi_core.results.WHY_NOT_JUDGED`, or JUDGED
    not_judged_share: float  # of the time since the first sample
    change: ChangeFound


class State:
    """All that the alarm remembers."""

    row: Row  # the next one
    # Evidence that has gathered, 0 to 1. Of EXTRAPOLATION there is one more charge, for its warning; that of
    # MISCOVERAGE is its largest score, at most SUM_MOST.
    charge: _PerCause
    near_charge: float
    miss_sum_s: _PerAxis  # cumulative sum of the sequential test
    miss_share: _PerAxis
    silent_s: float  # since the last usable sample
    ground: Ground
    thrust: RotorThrust
    since_first_s: float  # since the first sample
    not_judged_s: float  # of that, for which the model was not judged
    previous_ns: int  # stamp of the last sample; NO_STAMP before the first
    settled: bool  # whether the misses of the last usable sample counted
    wind_unknown: bool  # whether those of the horizontal forces did not, as of a change
    reported_inputs: int  # bits of the inputs outside that rows have reported since the level was last ok
    reported_faults: int  # the same for faults
    reported_more_faults: MoreFaults
    extrapolates: bool  # whether the last usable sample lies beyond a limit of a warning
    thrust_known: bool  # whether the interval of Fz is within its limit all the same
    change: Change


LIMITS, ROW, STATE = record_dtype(Limits), record_dtype(Row), record_dtype(State)


def forget(states: Records) -> None:
    """Empty the state (1,)."""
    states[:] = np.zeros(1, STATE)
    states["previous_ns"] = NO_STAMP
    states["ground"]["why"] = NO_SAMPLES
    states["thrust"]["since_zero_s"] = np.inf
    states["change"]["found"] = states["row"]["change"] = nothing_found(1)
