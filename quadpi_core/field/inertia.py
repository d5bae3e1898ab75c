# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust of a rotor and moments of inertia from motor commands, gyro and accelerometer, mass and arms known.

    −m f_z = Σ T(u_i) + c_z w + c_h (u² + v²),        T(u) = a u²,
    I_x ṗ = −Σ y_i T(u_i) + d_p p + …,                      I_y q̇ = Σ x_i T(u_i) + d_q q + …,

over commands u_i behind a first-order lag, which is fitted with all the rest: assumed, it would scale the
inertia (at 50 and 100 ms by 1.7). Velocities are those of the air, by the wind that drag tells.
That thrust goes with the square is assumed, and the error counted: left free, it would take up what a
controller answers to gusts. The bias of the accelerometer is what its mean along the vertical lacks of
gravity, but for the change of velocity: in a steady lean that is one along x or y as well, so less of it is
taken for one along z, and the rest counted. Without a state all of it is counted. Yaw is not told: commands
give the torque of the rotors over I_z alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, lfilter, sosfiltfilt

from quadpi_core.field.airborne import Flown, velocity_of
from quadpi_core.field.estimates import PIECES_FEWEST, Estimate, jackknife, not_identified, within
from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.motor_model import GRID_HZ, lacking_for_motors
from quadpi_core.frames import Array, rotate_body_to_world, rotate_world_to_body, rotation_matrix
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold
from quadpi_core.rotor_order import lag_weights
from quadpi_core.vehicle import Vehicle

# Grid of the lag, s: motors of 1 g to 1 kg lag by 10 to 100 ms. Pieces that go together, and their number.
_LAGS_S, _PIECE_S, _PIECES_MOST = tuple(0.005 * step for step in range(31)), 6.0, 40
# Signals change below this; half and twice as much move no inertia of simulated flights by more than 1 %.
_CUTOFF_HZ = 12.0
SHORTEST_S = Threshold(
    "shortest time in the air at once that tells an inertia",
    20.0,
    "s",
    "a take-off and a landing, which are no flight by these equations, take 5 s of it",
    CONVENTION,
)
BIAS_M_S2 = Threshold(
    "bias of an accelerometer, one standard deviation: of an axis as it comes, of what a state of velocity "
    "leaves along the vertical; and the largest that is one",
    (0.15, 0.03, 1.0),
    "m/s²",
    "data sheets say 20 to 40 mg; a velocity that errs by 0.3 m/s over 20 s, a tilt by 3°, leave 0.02; a "
    "tenth of gravity and more is a state or an orientation that is wrong",
    "data sheets of the BMI088 and the ICM-20689",
)
POWER = Threshold(
    "by which share the power of command that thrust goes with may be another than 2, two deviations",
    0.15,
    "",
    "tachometers and accelerometer of that vehicle tell a power of 2.24",
    "imrc_brushless of ../shared/data",
)
WIDEST = Threshold(
    "half width over value beyond which a number is not told",
    0.5,
    "",
    "a wider interval tells its order of magnitude alone, which size and mass do",
    CONVENTION,
)
_SHORT = f"takes {_PIECE_S * PIECES_FEWEST.value:.0f} s in the air, {SHORTEST_S.value:.0f} s or more at once"
_SPEEDS = "hover, and fly at several speeds"
# Columns of thrust: Σu², climb, speed squared, 1; of a moment: that of T(u), rate, product of rates, 1.
_THRUST, _MOMENT = 3, 4
# What a controller answers to gusts is in Σu² and no thrust: 1 stands in for it where errors are to be 0 on
# average, as an instrument (J. Wooldridge, Econometric Analysis of Cross Section and Panel Data, ch. 5).
_INSTRUMENTS = [3, 1, 2]


@dataclass(frozen=True)
class BodyResult:
    """Of one vehicle.

    Attributes:
        thrust: N, of a rotor at the command of hover.
        inertia: kg m², about body x and y.
        lag: s, of the motors.
    """

    thrust: Estimate
    inertia: tuple[Estimate, Estimate]
    lag: Estimate


def _untold(reason: str) -> BodyResult:
    none = not_identified("kg m²", reason)
    return BodyResult(not_identified("N", reason), (none, none), not_identified("s", reason))


class _Piece(NamedTuple):
    """What a piece of flight tells: by lag, squares of columns and target (L, C + 1, C + 1), see `_THRUST`.

    Of `hover` sums (3,) over samples: of mean commands, of 1, and of the deviation of the bias along z.
    """

    thrust: Array
    about_x: Array
    about_y: Array
    hover: Array


def identify_body(
    flights: Sequence[tuple[FieldLog, Flown]], vehicle: Vehicle, winds: Sequence[Array]
) -> BodyResult:
    """Thrust and inertia of a vehicle by its flights, or why they are not told.

    Args:
        flights: logs with commands by the rotors of the vehicle file, and when each was in the air.
        vehicle: for mass and places of the rotors.
        winds: of each flight, to the north and east, m/s.
    """
    found = [_pieces(log, flight, vehicle, wind) for (log, flight), wind in zip(flights, winds, strict=True)]
    pieces = [piece for own in found if not isinstance(own, str) for piece in own]
    if len(pieces) < PIECES_FEWEST.value:
        reasons = [own for own in found if isinstance(own, str)]
        return _untold(reasons[0] if reasons else _SHORT)
    if len(pieces) > _PIECES_MOST:
        cuts = np.linspace(0, len(pieces), _PIECES_MOST + 1).astype(int).tolist()
        pieces = [_joined(pieces[begin:end]) for begin, end in pairwise(cuts)]
    whole = _solved(pieces)
    if isinstance(whole, str):
        return _untold(whole)
    without = []
    for place in range(len(pieces)):
        own = _solved(pieces[:place] + pieces[place + 1 :])
        if isinstance(own, str):
            return _untold("one piece of the flight tells it alone")
        without.append(own)
    told = np.array(
        [[one.hover[1], one.about_x[0, 0, 0], one.about_y[0, 0, 0], one.hover[1]] for one in pieces]
    )
    low, high = jackknife(whole, np.array(without), told)
    half = 0.5 * (high - low)
    _, count, deviations = _joined(pieces).hover
    half[0] = np.hypot(half[0], 2.0 * deviations / count * vehicle.mass_kg / vehicle.rotor_count)
    half[1:3] = np.hypot(half[1:3], POWER.value * whole[1:3])
    thrust = _estimate(whole[0], half[0], "N", _SPEEDS)
    flown_so = "roll and pitch quickly, to and fro" if thrust.value else "thrust is not told"
    inertia = [_estimate(whole[1 + axis], half[1 + axis], "kg m²", flown_so) for axis in range(2)]
    lag = within((whole[3], whole[3] - half[3], whole[3] + half[3]), "s")
    return BodyResult(thrust, (inertia[0], inertia[1]), lag)


def _estimate(value: float, half: float, unit: str, advice: str) -> Estimate:
    ends = float(value), float(value - half), float(value + half)
    if half > WIDEST.value * abs(value):
        return not_identified(unit, f"its interval is too wide: {advice}", *ends[1:])
    return within(ends, unit)


def _pieces(log: FieldLog, flight: Flown, vehicle: Vehicle, wind: Array) -> list[_Piece] | str:
    if why := lacking_for_motors(log, vehicle):
        return why
    pieces: list[_Piece] = []
    for one in flight.stretches:
        found = _of_stretch(log, one.begin, one.end, vehicle, wind)
        if isinstance(found, str):
            return found
        pieces += found
    return pieces or _SHORT


def _of_stretch(log: FieldLog, begin: float, end: float, vehicle: Vehicle, wind: Array) -> list[_Piece] | str:
    assert log.commands is not None
    assert log.imu is not None
    if end - begin < SHORTEST_S.value:
        return []
    edges = np.arange(begin, end, 1.0 / GRID_HZ)
    time = 0.5 * (edges[1:] + edges[:-1])
    commands, imu = log.commands.filled_means(edges), log.imu.filled_means(edges)
    motion, velocity, deviation = np.zeros((len(time), 2)), velocity_of(log), BIAS_M_S2.value[0]
    if velocity is not None and log.attitude is not None:
        air, attitude = velocity.at(time), log.attitude.at(time)
        attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
        bias, deviation = _bias_of(time, imu[:, 3:], attitude, air[:, 2])
        if abs(bias) > BIAS_M_S2.value[2]:
            return f"accelerometer and state differ by {bias:.1f} m/s² along the vertical: one is wrong"
        imu[:, 5] -= bias
        air[:, :2] -= wind
        body = rotate_world_to_body(attitude, air)
        motion = np.stack([body[:, 2], body[:, 0] ** 2 + body[:, 1] ** 2], axis=1)
    good = np.flatnonzero(np.isfinite(np.hstack([commands, imu, motion])).all(axis=1))
    if len(good) < SHORTEST_S.value * GRID_HZ:
        return []
    rows = slice(int(good[0]), int(good[-1]) + 1)
    commands, imu, motion = (np.nan_to_num(own[rows]) for own in (commands, imu, motion))
    rates = imu[:, :3]
    smooth = butter(4, _CUTOFF_HZ, fs=GRID_HZ, output="sos")
    turning = np.gradient(rates, 1.0 / GRID_HZ, axis=0)
    targets = sosfiltfilt(smooth, np.column_stack([-vehicle.mass_kg * imu[:, 5], turning[:, :2]]), axis=0)
    others = sosfiltfilt(
        smooth,
        np.column_stack([motion, rates[:, :2], rates[:, 1] * rates[:, 2], rates[:, 0] * rates[:, 2]]),
        axis=0,
    )
    ones = np.full((len(rates), 1), 1.0)
    per_sample = np.column_stack([commands.mean(axis=1), ones, deviation * ones])
    arms = _places(log, vehicle)[:, [1, 0]].T * [[-1.0], [1.0]]
    count = max(int(len(rates) / (_PIECE_S * GRID_HZ)), 1)
    cuts = np.linspace(0, len(rates), count + 1).astype(int)
    parts = [slice(*ends) for ends in pairwise(cuts.tolist())]
    fixed = [
        np.column_stack([*columns, ones, target])
        for *columns, target in (
            (others[:, :2], targets[:, 0]),
            *((others[:, 2 + axis], others[:, 4 + axis], targets[:, 1 + axis]) for axis in range(2)),
        )
    ]
    squares: list[list[list[Array]]] = [[], [], []]
    for lag in _LAGS_S:
        (keep,), (now,), (before,) = lag_weights(np.array([1.0 / GRID_HZ]), lag)
        lagged = lfilter([now, before], [1.0, -keep], commands, axis=0, zi=commands[:1] * (1.0 - now))[0]
        squared = sosfiltfilt(smooth, lagged**2, axis=0)
        driven = (squared.sum(axis=1), *(squared @ arm for arm in arms))
        for own, first, rest in zip(squares, driven, fixed, strict=True):
            table = np.column_stack([first, rest])
            own.append([table[part].T @ table[part] for part in parts])
    sums = [per_sample[part].sum(axis=0) for part in parts]
    by_piece = (np.swapaxes(own, 0, 1) for own in squares)
    return list(map(_Piece, *by_piece, sums))


def _bias_of(time: Array, force: Array, attitude: Array, down: Array) -> tuple[float, float]:
    """Likeliest bias along body z of specific force (N, 3), m/s², and its deviation.

    By attitude (N, 4) and velocity down (N,) at times (N,): the mean along the vertical has the biases of
    all axes in it, by how they lean on average, and each is as likely as any other (Kalman's update).
    """
    alone, told, _ = BIAS_M_S2.value
    vertical = rotate_body_to_world(attitude, force)[:, 2]
    known = np.flatnonzero(np.isfinite(vertical + down))
    if len(known) < 2:
        return 0.0, alone
    gained = np.diff(down[known[[0, -1]]])[0] / np.diff(time[known[[0, -1]]])[0]
    axes = rotation_matrix(attitude[known])[:, 2].mean(axis=0)
    share = alone**2 * axes[2] / (alone**2 * axes @ axes + told**2)
    lacking = vertical[known].mean() + STANDARD_GRAVITY - gained
    return float(share * lacking), float(alone * np.sqrt(1.0 - share * axes[2]))


def _places(log: FieldLog, vehicle: Vehicle) -> Array:
    """Places (R, 3) of the rotors in the order of the log's motors, by their corners where it knows them."""
    places = vehicle.rotor_positions
    if log.corners is None or log.corners.shape != (len(places), 2):
        return places
    alike = (np.sign(places[:, :2]) == log.corners[:, np.newaxis]).all(axis=2)
    is_sure = (alike.sum(axis=0) == 1).all() and (alike.sum(axis=1) == 1).all()
    return places[np.argmax(alike, axis=1)] if is_sure else places


def _joined(pieces: Sequence[_Piece]) -> _Piece:
    """What several pieces tell together."""
    return _Piece(*(np.sum(own, axis=0) for own in zip(*pieces, strict=True)))


def _solved(pieces: Sequence[_Piece]) -> Array | str:
    """Thrust at hover, both moments of inertia and the lag (4,), or why they are not told."""
    thrust, *moments, (total, count, _) = _joined(pieces)
    hover = total / count
    values, errors = np.empty((len(_LAGS_S), 3)), np.zeros(len(_LAGS_S))
    for place in range(len(_LAGS_S)):
        own = thrust[place]
        gain = _least_squares(own[_INSTRUMENTS, :_THRUST], own[_INSTRUMENTS, -1])[0]
        if np.isnan(gain):
            return f"flown at one speed: {_SPEEDS}"
        values[place, 0] = gain * hover**2
        for axis, own in enumerate(moments):
            squares = own[place]
            gram, pull = squares[:_MOMENT, :_MOMENT], squares[:_MOMENT, _MOMENT]
            found = _least_squares(gram, pull)
            values[place, 1 + axis] = gain / found[0] if found[0] > 0.0 else np.nan
            errors[place] += (squares[-1, -1] - found @ pull) / squares[-1, -1]
    best = int(np.argmin(errors))
    if not np.isfinite(values[best]).all():
        return "commands turn the vehicle the other way: are the motors in the vehicle file's order?"
    if not 0 < best < len(_LAGS_S) - 1:
        return f"the lag of the motors is beyond {_LAGS_S[1]:.3f} to {_LAGS_S[-2]:.2f} s"
    around = slice(best - 1, best + 2)
    bend = np.polyfit((-1.0, 0.0, 1.0), errors[around], 2)
    shift = float(np.clip(-0.5 * bend[1] / max(bend[0], 1e-300), -1.0, 1.0))
    told = [np.polyval(np.polyfit((-1.0, 0.0, 1.0), column, 2), shift) for column in values[around].T]
    return np.array([*told, _LAGS_S[best] + shift * (_LAGS_S[1] - _LAGS_S[0])])


def _least_squares(gram: Array, pull: Array) -> Array:
    """Coefficients; NaN where columns other than 0 say the same, of which the smallest would be as good."""
    scale = np.maximum(np.sqrt(np.diag(gram)), 1e-12)
    solved, _, rank, _ = np.linalg.lstsq(gram / np.outer(scale, scale), pull / scale, rcond=1e-10)
    return solved / scale if rank == np.count_nonzero(scale > 1e-12) else np.full(len(pull), np.nan)
