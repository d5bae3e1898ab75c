# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Thrust of a rotor and moments of inertia from motors, gyro and accelerometer, mass and arms known.

    −m f_z = Σ T(u_i) + c_z w + c_h (u² + v²),        T(u) = a u²,
    I_x ṗ = −Σ y_i T(u_i) + d_p p + …,                      I_y q̇ = Σ x_i T(u_i) + d_q q + …,

over commands u_i behind a first-order lag, which is fitted with all the rest: assumed, it would scale the
inertia (at 50 and 100 ms by 1.7). Velocities are those of the air, by the wind that drag tells.

In closed loop least squares take the controller for the vehicle where disturbances turn it more than commands
do: slowly by moments of the air, which commands balance (the inertia seems larger), quickly by the gyro's
noise, which they answer. In between inertia is one number. So the moments are compared octave by octave,
those count in which commands explain the motion, and by how much their inertias differ is in the interval.
Source: L. Ljung, System Identification (1999), ch. 13, for what direct identification in closed loop tells.

By which power of the command thrust goes is not told, and the error counted: left free, it would take up what
a controller answers to gusts. Measured rotor speeds that explain as much take the place of commands. The bias
of the accelerometer is what its mean along the vertical lacks of gravity, but for the change of velocity: in
a steady lean that is one along x or y as well, so less of it is taken for one along z, and the rest counted.
Without a state all of it is counted. Yaw is not told: commands give the torque of the rotors over I_z alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import butter, sosfiltfilt

from quadpi_core.field.airborne import Flown, velocity_of
from quadpi_core.field.estimates import PIECES_FEWEST, Estimate, jackknife, not_identified, within
from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.motor_model import GRID_HZ, SLOWEST_HZ, lacking_for_motors, lagged, lowest
from quadpi_core.frames import Array, rotate_body_to_world, rotate_world_to_body, rotation_matrix
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold
from quadpi_core.rotor_order import Motor, RotorOrder
from quadpi_core.vehicle import Vehicle

# Grid of the lag, s: motors of 1 g to 1 kg lag by 10 to 100 ms. Pieces that go together, and their number.
_LAGS_S, _PIECE_S, _PIECES_MOST = tuple(0.005 * step for step in range(31)), 6.0, 40
# Thrust changes below this; moments are compared in these octaves.
_CUTOFF_HZ, _OCTAVES_HZ = 12.0, ((0.75, 1.5), (1.5, 3.0), (3.0, 6.0), (6.0, 12.0))
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
    "power of command that thrust goes with, and two deviations; of measured rotor speed",
    (1.7, 0.5, 2.0, 0.3),
    "",
    "tachometers tell 1.2 to 1.36, 1.4 to 1.9, 1.8 to 2.2, a bench 1.5, simulators 2; inflow takes "
    "5 to 15 % of that of speeds",
    "indiflight, imrc_payload, imrc_brushless and arpl of ../shared/data",
)
COHERENT = Threshold(
    "share of an octave of the angular acceleration that motors explain, from which on it tells inertia; "
    "by how much the inertia by one octave alone may err",
    (0.85, 0.14),
    "",
    "measured rotor speeds tell the inertia of three vehicles within 14 % by such octaves; by lower ones 1.3 "
    "to 30 times as much",
    "indiflight, imrc_payload and imrc_brushless of ../shared/data",
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
_QUICKLY = "roll and pitch quickly, to and fro"
# Columns of thrust: Σu², climb, speed squared, 1; of a moment: that of T(u), rate, product of rates.
_THRUST = 3
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
    """What a piece of flight tells: squares of columns and target, see `_THRUST`.

    Of `thrust` by lag (L, C + 1, C + 1), of `moments` by axis and octave too (L, 2, O, C + 1, C + 1). Of
    `hover` sums (3,) over samples: of mean commands, of 1, and of the deviation of the bias along z.
    """

    thrust: Array
    moments: Array
    hover: Array


def identify_body(
    flights: Sequence[tuple[FieldLog, Flown]], vehicle: Vehicle, winds: Sequence[Array]
) -> BodyResult:
    """Thrust and inertia of a vehicle by its flights, or why they are not told.

    Args:
        flights: logs with commands by the rotors of the vehicle file, or rotor speeds, which are taken as
            right, and when each was in the air.
        vehicle: for mass and places of the rotors.
        winds: of each flight, to the north and east, m/s.
    """
    given = [(log, flight, wind) for (log, flight), wind in zip(flights, winds, strict=True)]
    fast = [
        (replace(log, commands=log.rotor_speeds), flight, wind)
        for log, flight, wind in given
        if log.rotor_speeds is not None and log.rotor_speeds.rate_hz >= SLOWEST_HZ
    ]
    told = _identified(fast, vehicle, by_speed=True)
    sure = all(one.value is not None for one in told.inertia)
    return told if sure else _identified(given, vehicle, by_speed=False)


def _identified(
    flights: Sequence[tuple[FieldLog, Flown, Array]], vehicle: Vehicle, *, by_speed: bool
) -> BodyResult:
    """By what the logs have as commands."""
    found = [_pieces(*one, vehicle) for one in flights]
    pieces = [piece for own in found if not isinstance(own, str) for piece in own]
    if len(pieces) < PIECES_FEWEST.value:
        reasons = [own for own in found if isinstance(own, str)]
        return _untold(reasons[0] if reasons else _SHORT)
    if len(pieces) > _PIECES_MOST:
        cuts = np.linspace(0, len(pieces), _PIECES_MOST + 1).astype(int).tolist()
        pieces = [_joined(pieces[begin:end]) for begin, end in pairwise(cuts)]
    told = _joined(pieces)
    shares = _explained(told.moments, _fitted(told.moments)).max(axis=0)
    heard = shares >= COHERENT.value[0]
    solved = _solved(told, heard, by_speed=by_speed)
    if isinstance(solved, str):
        return _untold(solved)
    whole, spread = solved
    without = []
    for place in range(len(pieces)):
        own = _solved(_joined(pieces[:place] + pieces[place + 1 :]), heard, by_speed=by_speed)
        if isinstance(own, str):
            return _untold("one piece of the flight tells it alone")
        without.append(own[0])
    levers = np.array([one.moments[0, :, :, 0, 0] for one in pieces])
    share = np.sum(levers / np.maximum(levers.sum(axis=0), 1e-300) * heard, axis=2)
    hovers = np.array([one.hover[1] for one in pieces])
    low, high = jackknife(whole, np.array(without), np.column_stack([hovers, share, hovers]))
    half = 0.5 * (high - low)
    _, count, deviations = told.hover
    thrust, *_, lag = whole
    error = np.hypot(half[0], 2.0 * deviations / count * vehicle.mass_kg / vehicle.rotor_count)
    thrust = _estimate(thrust, error, "N", _SPEEDS)
    inertia = []
    power, unsure = POWER.value[2:] if by_speed else POWER.value[:2]
    grows = f"thrust taken to grow with the power {power - unsure:.1f} to {power + unsure:.1f} of"
    condition = f"{grows} {'rotor speed' if by_speed else 'command'}"
    for axis, value in enumerate(0.5 * power * whole[1:3]):
        if not heard[axis].any():
            said = f"motors explain {100.0 * shares[axis].max():.0f} % of how it turns"
            needed = f"{said}, of {100.0 * COHERENT.value[0]:.0f} needed: {_QUICKLY}"
            inertia.append(not_identified("kg m²", needed))
            continue
        errors = [0.5 * power * half[1 + axis], unsure / power * value, spread[axis] * value]
        flown_so = _QUICKLY if thrust.value else "thrust is not told"
        inertia.append(_estimate(value, float(np.linalg.norm(errors)), "kg m²", flown_so, condition))
    if by_speed or not heard.any():
        lag = not_identified("s", "inertia is by measured rotor speeds" if by_speed else _QUICKLY)
    else:
        lag = within((lag, lag - half[3], lag + half[3]), "s")
    return BodyResult(thrust, (inertia[0], inertia[1]), lag)


def _estimate(value: float, half: float, unit: str, advice: str, condition: str = "") -> Estimate:
    ends = float(value), float(value - half), float(value + half)
    if half > WIDEST.value * abs(value):
        return not_identified(unit, f"its interval is too wide: {advice}", *ends[1:])
    return within(ends, unit, condition)


def _pieces(log: FieldLog, flight: Flown, wind: Array, vehicle: Vehicle) -> list[_Piece] | str:
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
    thrust = sosfiltfilt(smooth, np.column_stack([motion, -vehicle.mass_kg * imu[:, 5]]), axis=0)
    others = np.column_stack([rates[:, :2], rates[:, 1] * rates[:, 2], rates[:, 0] * rates[:, 2], turning])
    octaves = [butter(2, ends, "bandpass", fs=GRID_HZ, output="sos") for ends in _OCTAVES_HZ]
    heard = [sosfiltfilt(own, others[:, :-1], axis=0) for own in octaves]
    ones = np.full((len(rates), 1), 1.0)
    per_sample = np.column_stack([commands.mean(axis=1), ones, deviation * ones])
    arms = rotors_of(log, vehicle)[:, [1, 0]].T * [[-1.0], [1.0]]
    count = max(int(len(rates) / (_PIECE_S * GRID_HZ)), 1)
    cuts = np.linspace(0, len(rates), count + 1).astype(int)
    parts = [slice(*ends) for ends in pairwise(cuts.tolist())]
    lifts, moments = [], []
    for lag in _LAGS_S:
        squares = lagged(commands, lag) ** 2
        total = sosfiltfilt(smooth, squares.sum(axis=1))
        lifts.append(_squares(np.column_stack([total, thrust[:, :2], ones, thrust[:, 2]]), parts))
        driven, own = squares @ arms.T, []
        for octave, rest in zip(octaves, heard, strict=True):
            moved = sosfiltfilt(octave, driven, axis=0)
            own.append([np.column_stack([moved[:, axis], rest[:, axis::2]]) for axis in range(2)])
        moments.append([[_squares(table, parts) for table in axis] for axis in zip(*own, strict=True)])
    sums = [per_sample[part].sum(axis=0) for part in parts]
    return list(map(_Piece, np.moveaxis(np.array(lifts), 1, 0), np.moveaxis(np.array(moments), 3, 0), sums))


def _squares(table: Array, parts: Sequence[slice]) -> Array:
    """Sums of products of columns (P, C, C) over each part of rows (N, C)."""
    return np.array([table[part].T @ table[part] for part in parts])


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


def rotors_of(log: FieldLog, vehicle: Vehicle) -> Array:
    """Places and spins (R, 3) of a vehicle's rotors, as the log orders its motors where places tell that."""
    rotors = np.column_stack([vehicle.rotor_positions[:, :2], vehicle.rotor_spins])
    motors = [Motor(*own) for own in (() if log.places is None else log.places.tolist())]
    order = RotorOrder.by_place(vehicle, motors)
    return rotors if order is None else rotors[np.argsort(order.controllers)]


def _joined(pieces: Sequence[_Piece]) -> _Piece:
    """What several pieces tell together."""
    return _Piece(*(np.sum(own, axis=0) for own in zip(*pieces, strict=True)))


def _fitted(squares: Array) -> Array:
    """Coefficients (..., C) of the columns by squares of columns and target (..., C + 1, C + 1)."""
    scale = np.maximum(np.sqrt(np.diagonal(squares, axis1=-2, axis2=-1)[..., :-1]), 1e-12)
    gram = squares[..., :-1, :-1] / (scale[..., :, np.newaxis] * scale[..., np.newaxis, :])
    found: Array = np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ (
        squares[..., :-1, -1:] / scale[..., np.newaxis]
    )
    return found[..., 0] / scale


def _explained(squares: Array, coefficients: Array) -> Array:
    """Share (...) of the target that the columns explain with coefficients."""
    errs = np.concatenate([-coefficients, np.ones((*coefficients.shape[:-1], 1))], axis=-1)
    left = np.einsum("...i,...ij,...j->...", errs, squares, errs)
    return 1.0 - left / np.maximum(squares[..., -1, -1], 1e-300)


def _solved(told: _Piece, heard: npt.NDArray[np.bool_], *, by_speed: bool) -> tuple[Array, Array] | str:
    """Thrust at hover, both inertias, lag (4,), and how octaves heard (2, O) differ (2,); or why not."""
    total, count, _ = told.hover
    power = np.maximum(told.moments[..., -1:, -1:], 1e-300)
    octaves = told.moments / power * heard[..., np.newaxis, np.newaxis]
    found = _fitted(octaves.sum(axis=2))
    errors = np.sum((1.0 - _explained(octaves, found[:, :, np.newaxis])) * heard, axis=(1, 2))
    best, is_heard = int(np.argmin(errors)), heard.any(axis=1)
    if (found[best, is_heard, 0] <= 0.0).any():
        return "commands turn the vehicle the other way: are the motors in the vehicle file's order?"
    squares = told.thrust[best, _INSTRUMENTS]
    scale = np.maximum(np.sqrt(np.diag(squares)), 1e-12)
    gram = squares[:, :_THRUST] / np.outer(scale, scale)
    solved, _, rank, _ = np.linalg.lstsq(gram, squares[:, -1] / scale, rcond=1e-10)
    # Where columns other than 0 say the same, the smallest would be as good.
    if rank < np.count_nonzero(scale > 1e-12):
        return f"flown at one speed: {_SPEEDS}"
    gain = float(solved[0] / scale[0])
    rest = np.einsum("laoj,laj->lao", octaves[..., 0, 1:-1], found[..., 1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        inertia = np.where(is_heard, gain / found[..., 0], 0.0)
        unequal = np.abs(found[..., :1] * octaves[..., 0, 0] / (octaves[..., 0, -1] - rest) - 1.0)
    most = np.max(np.where(heard, unequal, 0.0), axis=2)
    spread = np.where(heard.sum(axis=1) > 1, most, COHERENT.value[1])
    if is_heard.any() and not 0 < best < len(_LAGS_S) - 1 and not (by_speed and best == 0):
        return f"the lag of the motors is beyond {_LAGS_S[1]:.3f} to {_LAGS_S[-2]:.2f} s"
    lag = lowest(_LAGS_S, errors) if is_heard.any() and best > 0 else _LAGS_S[best]
    at_lag = [np.interp(lag, _LAGS_S, column) for column in inertia.T]
    return np.array([gain * (total / count) ** 2, *at_lag, lag]), spread[best]
