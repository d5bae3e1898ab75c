# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Hover throttle, thrust over command, saturation, imbalance, order and battery by the commands.

Thrust over mass is the specific force along body z, so that no mass is needed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.signal import butter, sosfiltfilt

from quadpi_core.field.airborne import HOVER_SPEED, Averages, Flown, Stretch, averages, pieces, velocity_of
from quadpi_core.field.estimates import (
    Estimate,
    beyond_zero,
    chain_of_pieces,
    mean_of_pieces,
    not_identified,
    slope_of_pieces,
    within,
)
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.motor_model import GRID_HZ, lagged
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, STANDARD_GRAVITY, Threshold
from quadpi_core.screening.rotors_in_flight import runs_of

PIECE_S = 5.0
_STEP_S = 0.2
FULL_COMMAND = Threshold(
    "command from which a motor is saturated",
    0.98,
    "of its range",
    "mixers cut at the end of the range; rounding and idle offsets leave the last two per cent",
    "nanobench and rrc_propeller of ../shared/data, the first of which saturates with a low battery",
)
SATURATED = Threshold(
    "share of the time in the air with a saturated motor that is a warning, and an alarm",
    (0.02, 0.2),
    "",
    "attitude control is lost for as long; hard manoeuvres saturate for a hundredth of a flight",
    CONVENTION,
)
IMBALANCE = Threshold(
    "mean command of a motor over that of all that is a warning, and an alarm",
    (0.15, 0.3),
    "",
    "mountings of a battery differ by 4 to 8 %; a propeller short by 6 %, or a nut by a motor, by 20 to 40 %",
    "normal flights of crazypad in ../shared/data, 9 to 14 % of one vehicle",
)
BATTERY_DRIFT = Threshold(
    "change of thrust over command in a flight that is a warning",
    0.1,
    "",
    "a pack of 4.2 to 3.5 V a cell loses a sixth of its voltage and up to a third of its thrust",
    CONVENTION,
)
CHANGED = Threshold(
    "change of the command at hover, at once or along a flight, that is a warning",
    0.06,
    "",
    "a load of a tenth of the weight is 6 % of command; gusts, turns and the ground move 5 s by 2 to 3 %",
    CONVENTION,
)
SURE = Threshold(
    "such a change over the deviation of what it leaves of the pieces, that is one",
    5.0,
    "",
    "noise of six pieces, the fewest, passes it in 3 % of flights, that of eight in 1 %",
    "simulated noise, the same in all pieces; of 15 and more it never did",
)
SLOW = Threshold(
    "speed below which flight near the weight counts as hover, and deviation of thrust over weight from 1",
    (3.0, 0.2),
    "m/s, 1",
    "at 3 m/s a drag of 0.3 1/s leans the vehicle by 5°: 0.4 % of thrust; beyond 0.2 it climbs or turns",
    CONVENTION,
)
LEAST_SPREAD = Threshold(
    "standard deviation of the mean command, over its median, that tells how thrust goes with it",
    0.02,
    "",
    "hovers and lines have 1.0 to 1.7 %, which thrust follows with a correlation of 0 to 0.2",
    "hover_good_1, hover_25mm_1 and line_good_1 of rrc_propeller in ../shared/data",
)
ORDER = Threshold(
    "score of an order and sense of the motors from which on it is told, and its lead on that of the log: "
    "of roll, pitch and yaw the share that commands explain, by the cosine of their levers and the motors'",
    (0.8, 0.2),
    "",
    "of sound logs it is 1.1 to 2.3 and leads any other by 0.37 and more; of yaw alone 0.05 to 0.6",
    "indiflight and imrc_brushless of ../shared/data",
)
# Turns slower than that are the air's, faster ones noise; at once, s; a usual lag of motors, s; mixers' ways.
_TURNS_HZ, _TURNS_S, _USUAL_LAG_S, _WAYS = (1.5, 6.0), 3.0, 0.03, 4
# Pieces on each side of a change; a shorter hover is a turn of the path, s.
_SIDE, HOVER_FEWEST_S, _FEWEST_SAMPLES = 3, 3.0, 20


@dataclass(frozen=True)
class HoverChange:
    """The command at hover is another later in the flight.

    Attributes:
        share: by which it has grown.
        at_s: when, at once; None along the flight.
    """

    share: float
    at_s: float | None


@dataclass(frozen=True)
class MotorUse:
    """What commands and battery tell. What the log does not hold is None, or empty.

    Attributes:
        hover: mean command at hover.
        thrust_gain: change of thrust over weight per change of the mean command, at its median.
        saturated: share of the time in the air with a motor at full command.
        motors: (R) command of each motor over the mean of all, less 1.
        volts: battery at the beginning and the end of the flight, and the lowest.
        drift: change of thrust over command from begin to end of the flight.
        change: of the command at hover; None where it stays, or is not told.
        no_change: why it is not told; empty where it is.
        efforts: what thrust goes with over the specific force it gave, by what tells it.
    """

    hover: Estimate | None = None
    thrust_gain: Estimate | None = None
    saturated: Estimate | None = None
    motors: tuple[Estimate, ...] = ()
    volts: tuple[float, float, float] | None = None
    drift: Estimate | None = None
    change: HoverChange | None = None
    no_change: str = "not in the log"
    efforts: Mapping[str, float] = field(default_factory=dict)


def motor_use(log: FieldLog, flight: Flown) -> MotorUse:
    """What the commands of one flight tell."""
    volts, cut = _volts(log.battery, flight), pieces(flight.stretches, PIECE_S)
    parts = [] if log.commands is None else [log.commands.during(one.begin, one.end) for one in cut]
    if not sum(map(len, parts)):
        return MotorUse(volts=volts)
    commands = np.vstack([part.values for part in parts])
    time = np.concatenate([part.time for part in parts])
    piece = np.concatenate([np.full(len(part), number) for number, part in enumerate(parts)])
    mean = commands.mean(axis=1)
    # Commands of outputs that were off tell nothing, though the vehicle flew.
    if not mean.any():
        return MotorUse(volts=volts)
    gain, hover, drift = _thrust(log, cut, _hover(log, mean, time, piece))
    change = _hover_change(log, mean, time, piece)
    return MotorUse(
        hover=hover,
        thrust_gain=gain,
        saturated=mean_of_pieces((commands.max(axis=1) >= FULL_COMMAND.value) * 1.0, piece, ""),
        motors=tuple(mean_of_pieces(own / mean.mean() - mean / mean.mean(), piece, "") for own in commands.T),
        volts=volts,
        drift=drift,
        change=change if isinstance(change, HoverChange) else None,
        no_change=change if isinstance(change, str) else "",
    )


class Turning(NamedTuple):
    """As what the commands turn the vehicle, or rotor speeds where the log has none.

    Attributes:
        order: of each command the motor, from 1, that it drives; empty for their own.
        is_reversed: whether all rotors turn it the other way about yaw.
        alike: two commands of another order that may as well be exchanged; empty for none.
        no_spins: why it is not told whether they turn the other way; empty where it is.
    """

    order: tuple[int, ...] = ()
    is_reversed: bool = False
    alike: tuple[int, ...] = ()
    no_spins: str = ""


def turning_of(log: FieldLog, flight: Flown, places: Array | None) -> Turning | str:
    """As which motors the commands turn the vehicle, or why that is not told.

    Args:
        log: with gyro.
        flight: what was flown.
        places: (R, 3) of the motors as `FieldLog.places` has them; None where not known.
    """
    commands, imu = log.commands or log.rotor_speeds, log.imu
    if commands is None or imu is None or places is None or len(places) != commands.values.shape[1]:
        return "takes commands or rotor speeds, gyro and the places of as many motors"
    if (rate := min(commands.rate_hz, imu.rate_hz)) < 2.0 * _TURNS_HZ[1]:
        return f"motors or gyro are logged at {rate:.0f} Hz: {2.0 * _TURNS_HZ[1]:g} Hz are needed"
    moving, squares = [np.empty((0, 3))], [np.empty((0, len(places)))]
    band = butter(2, _TURNS_HZ, "bandpass", fs=GRID_HZ, output="sos")
    for one in flight.stretches:
        edges = np.arange(one.begin, one.end, 1.0 / GRID_HZ)
        known: Array = np.hstack([commands.filled_means(edges), imu.filled_means(edges)[:, :3]])
        # A filter would hear the edges of a pause as motion.
        for begin, end in runs_of(~np.isnan(known.sum(axis=1))):
            if end - begin > GRID_HZ * _TURNS_S:
                given, moved = known[begin:end, :-3], known[begin:end, -3:]
                late = lagged(given, _USUAL_LAG_S if log.commands else 0.0)
                squares.append(sosfiltfilt(band, late**2, axis=0))
                moving.append(sosfiltfilt(band, np.gradient(moved, 1.0 / GRID_HZ, axis=0), axis=0))
    rates, driven = np.vstack(moving), np.vstack(squares)
    if not len(rates):
        return f"motors and gyro are nowhere without a gap for {_TURNS_S:g} s in the air"
    # Commands move four ways alone, however many there are: within these the lever of each is told.
    power, ways = (own[..., -_WAYS:] for own in np.linalg.eigh(driven.T @ driven))
    together = driven.T @ rates
    told = ways / np.maximum(power, 1e-9 * power[-1] + 1e-30) @ (ways.T @ together)
    share = np.sum(together * told, axis=0) / np.maximum(np.sum(rates**2, axis=0), 1e-30)
    levers = np.stack([-places[:, 1], places[:, 0], -places[:, 2]], axis=1)
    told, levers = (own / np.maximum(np.linalg.norm(own, axis=0), 1e-30) for own in (told, levers))
    rows, scored = np.arange(len(places)), []
    for sense in (1.0, -1.0):
        # Of each command as each motor.
        fit = (told * share * (1.0, 1.0, sense)) @ levers.T
        best = linear_sum_assignment(fit, maximize=True)[1]
        scored += [(float(fit[rows, order].sum()), sense < 0.0, order, fit) for order in (rows, best)]
    least, lead = ORDER.value
    if (most := max(score for score, *_ in scored)) < least:
        return "motors hardly explain how the vehicle turns"
    # Of what does alike the simplest counts: their own order, then other senses, then other orders.
    likely = [scored[place] for place in (0, 2, 1, 3)]
    _, is_reversed, order, fit = next(one for one in likely if one[0] > most - lead)
    as_told = fit[:, order]
    exchanged = np.add.outer(np.diag(as_told), np.diag(as_told)) - as_told - as_told.T
    pair = divmod(int(np.argmin(exchanged + 9.0 * np.eye(len(rows)))), len(rows))
    alike = (pair[0] + 1, pair[1] + 1) if exchanged[pair] < lead else ()
    if order is rows and alike and not is_reversed:
        return "motors {} and {} turn the vehicle alike".format(*alike)
    yawed = 2.0 * abs(share[2] * (told[:, 2] @ levers[order, 2]))
    said = "" if yawed >= lead else "not known, or motors hardly explain how the vehicle yaws"
    return Turning(() if order is rows else tuple((order + 1).tolist()), is_reversed, alike, said)


def _hover_change(log: FieldLog, mean: Array, time: Array, piece: Array) -> HoverChange | str | None:
    """A step, or else a trend, of the mean command of pieces of slow flight near the weight; or why not."""
    velocity = velocity_of(log)
    if velocity is None or log.imu is None:
        return "takes velocity and IMU"
    thrust = -log.imu.at(time)[:, 5] / STANDARD_GRAVITY
    slow = (np.linalg.norm(velocity.at(time), axis=1) < SLOW.value[0]) & (
        np.abs(thrust - 1.0) < SLOW.value[1]
    )
    held = [piece == number for number in np.unique(piece[slow]) if np.mean(slow[piece == number]) > 0.5]
    # At begin and end the vehicle climbs and lands.
    held = held[1:-1]
    if len(held) < 2 * _SIDE:
        return f"takes {2 * _SIDE} pieces of slow flight between climb and landing, {len(held)} are there"
    level, when = (np.array([np.mean(own[one & slow]) for one in held]) for own in (mean, time))
    if level.min() <= 0.0:
        return None
    splits = range(_SIDE, len(held) - _SIDE + 1)
    rests = [np.concatenate([part - part.mean() for part in np.split(level, [split])]) for split in splits]
    line = np.column_stack([np.ones_like(when), when])
    fitted = line @ _curve(line, level)
    best = min(range(len(rests)), key=lambda one: float(np.sum(rests[one] ** 2)))
    before, after = np.split(level, [splits[best]])
    step, trend = float(after.mean() / before.mean() - 1.0), float(fitted[-1] / fitted[0] - 1.0)
    at_once = np.sum(rests[best] ** 2) < 0.5 * np.sum((level - fitted) ** 2)
    share, rest = (step, rests[best]) if at_once else (trend, level - fitted)
    if abs(share) < max(CHANGED.value, SURE.value * float(np.std(rest)) / float(level.mean())):
        return None
    between = float(np.mean(when[splits[best] - 1 : splits[best] + 1]))
    return HoverChange(share, between if at_once else None)


def _volts(battery: Series | None, flight: Flown) -> tuple[float, float, float] | None:
    if battery is None:
        return None
    values = np.vstack([battery.during(one.begin, one.end).values for one in flight.stretches])[:, 0]
    values = values[values > 0.5]
    if not len(values):
        return None
    share = max(1, len(values) // 20)
    return float(np.median(values[:share])), float(np.median(values[-share:])), float(values.min())


def _hover(log: FieldLog, mean: Array, time: Array, piece: Array) -> Estimate | None:
    """Mean command where the vehicle stood in the air; None where it hardly did."""
    velocity = velocity_of(log)
    if velocity is None or log.commands is None:
        return None
    stands = np.linalg.norm(velocity.at(time), axis=1) < HOVER_SPEED
    if np.sum(stands) < HOVER_FEWEST_S * log.commands.rate_hz:
        return None
    return mean_of_pieces(np.where(stands, mean, np.nan), piece, "of the range of command")


def _thrust(
    log: FieldLog, cut: list[Stretch], hover: Estimate | None
) -> tuple[Estimate | None, Estimate | None, Estimate | None]:
    """Gain of thrust at the usual command, the command at which it is the weight, and its drift."""
    samples = _thrust_samples(log, cut)
    if samples is None:
        return None, hover, None
    (loads, (thrust,)), time, piece = [own.T for own in samples.means], samples.time, samples.stretch
    mean, square = loads
    usual, unit = float(np.median(mean)), "per unit of command"
    if np.std(mean) < LEAST_SPREAD.value * usual:
        return not_identified(unit, "the mean command hardly changed: climb and descend"), hover, None
    columns = np.column_stack([np.ones_like(mean), mean, square])
    gain = beyond_zero(slope_of_pieces(columns, thrust, piece, np.array([0.0, 1.0, 2.0 * usual]), unit)[0])
    if gain.value is None:
        return gain, hover, None
    spread, ends = float(np.median(square - mean**2)), (mean.min(), mean.max())

    def crossing(kept: Array) -> float:
        at_rest, slope, curve = _curve(columns[kept], thrust[kept])
        roots = np.roots([curve, slope, at_rest + curve * spread - 1.0])
        near = [float(root.real) for root in roots if root.imag == 0.0 and ends[0] <= root.real <= ends[1]]
        return min(near, key=lambda root: abs(root - usual), default=np.nan)

    if hover is None:
        hover = chain_of_pieces(crossing, piece, "of the range of command")
    # No propeller gives less: thrust is convex in command, and none without any.
    if hover.value is None or gain.value * hover.value < 1.0:
        said = "commands answered to disturbance: climb and descend"
        return not_identified(unit, said, gain.low, gain.high), None if hover.value is None else hover, None
    share = (time - time.mean()) / max(np.ptp(time), 1e-9)
    lines = np.column_stack([np.ones_like(share), share])

    def drift(kept: Array) -> float:
        told = columns @ _curve(columns[kept], thrust[kept])
        # Where thrust is near the weight: elsewhere the curve itself errs.
        kept = kept & (np.abs(thrust - 1.0) < SLOW.value[1]) & (told > 0.5)
        return float(_curve(lines[kept], thrust[kept] / told[kept])[1]) if kept.sum() > 2 else np.nan

    return gain, hover, chain_of_pieces(drift, piece, "of thrust")


def _curve(columns: Array, target: Array) -> Array:
    """Coefficients (P,) by least squares."""
    return np.linalg.lstsq(columns.T @ columns, columns.T @ target, rcond=None)[0].astype(np.float64)


def _thrust_samples(log: FieldLog, cut: list[Stretch]) -> Averages | None:
    """Mean command and mean square (N, 2), thrust over weight (N, 1)."""
    if log.imu is None or log.commands is None:
        return None
    values = log.commands.values
    loads = Series(log.commands.time, np.stack([values.mean(axis=1), np.mean(values**2, axis=1)], axis=1))
    thrust = Series(log.imu.time, -log.imu.values[:, 5:] / STANDARD_GRAVITY)
    (load, force), time, piece = averages(cut, _STEP_S, loads, thrust)
    # Thrust is not known in a step without a sample of the IMU.
    ends = time[:, np.newaxis] + 0.5 * _STEP_S * np.array([-1.0, 1.0])
    kept = np.diff(np.searchsorted(log.imu.time, ends))[:, 0] > 0
    told = Averages((load[kept], force[kept]), time[kept], piece[kept])
    return told if kept.sum() > _FEWEST_SAMPLES else None


#     T / T_max = e u² + (1 − e) u,      e = THR_MDL_FAC = MOT_THST_EXPO,
#
# over the command u of a motor, between the ends of the range in which it turns. The relative slope at hover,
# g = (dT/T) / (du/u), tells e without the thrust of full command: e = (g − 1) / (g (1 − u) + 2 u − 1).
# Source: PX4's FunctionMotors.hpp; ArduPilot's AP_MotorsMulticopter, apply_thrust_curve_and_volt_scaling.

_UNIT = "of full thrust"
# Of an exponent between 0 and 1: a wider interval tells a straight line from a parabola no more.
_WIDEST = 0.6
# By how much an exponent may lie outside 0 to 1: the slope is that at the usual command, not at hover itself.
_BEYOND = 0.1


class ThrustCurve(NamedTuple):
    """Of one vehicle.

    Attributes:
        exponent: e, between 0, thrust linear in command, and 1, quadratic.
        hover: thrust of hover over that of full command.
    """

    exponent: Estimate
    hover: Estimate


def untold_curve(reason: str) -> ThrustCurve:
    """No curve, and why."""
    return ThrustCurve(not_identified("", reason), not_identified(_UNIT, reason))


def thrust_curve(flights: Sequence[tuple[FieldLog, MotorUse]]) -> ThrustCurve:
    """The curve of a vehicle: the mean over its flights, with an interval that holds those of all.

    Args:
        flights: logs, and what their commands tell.
    """
    curves = [_of_flight(log, use) for log, use in flights]
    return ThrustCurve(*(_together([getattr(one, name) for one in curves]) for name in ThrustCurve._fields))


def _together(all_of: Sequence[Estimate]) -> Estimate:
    told = [one for one in all_of if one.value is not None and one.low is not None and one.high is not None]
    if not told:
        return all_of[0]
    values, lows, highs = zip(*((one.value, one.low, one.high) for one in told), strict=True)
    reason = told[0].reason if len(told) == 1 else f"{told[0].reason}; of {len(told)} flights"
    return Estimate(float(np.mean(values)), min(lows), max(highs), told[0].unit, reason)


def _of_flight(log: FieldLog, use: MotorUse) -> ThrustCurve:
    hover, gain = use.hover, use.thrust_gain
    if hover is None or hover.value is None or hover.low is None or hover.high is None:
        said = "commands of no hover in the log" if hover is None else hover.reason or "no interval of hover"
        return untold_curve(said.removeprefix("not identified: "))
    if (present := log.parameters.get("THR_MDL_FAC", 0.0)) != 0.0:
        # PX4 logs commands before that curve, at which they are thrust already.
        said = (
            f"commands in the log are before the present THR_MDL_FAC, {present:g}: set it to 0 and fly again"
        )
        kept = replace(hover, unit=_UNIT, reason=f"with THR_MDL_FAC {present:g} as it is")
        return ThrustCurve(not_identified("", said), kept)
    low = log.parameters.get("MOT_SPIN_MIN", 0.0)
    span = log.parameters.get("MOT_SPIN_MAX", 1.0) - low
    # The ends of hover with the slopes that go with them: both intervals are worst together.
    commands = [(end - low) / span for end in (hover.value, hover.low, hover.high)]
    exponent = _exponent(gain, span, commands)
    if exponent.value is not None and exponent.low is not None and exponent.high is not None:
        pairs = zip(commands, (exponent.value, exponent.high, exponent.low), strict=True)
        thrust = [e * u * u + (1.0 - e) * u for u, e in pairs]
        return ThrustCurve(exponent, within(thrust, _UNIT, "with this exponent, at the logs' weight and air"))
    if "MOT_THST_EXPO" in log.parameters:
        e = log.parameters["MOT_THST_EXPO"]
        thrust = [e * u * u + (1.0 - e) * u for u in commands]
        return ThrustCurve(exponent, within(thrust, _UNIT, f"with MOT_THST_EXPO {e:g} as it is"))
    linear = "with thrust taken as linear in command"
    return ThrustCurve(exponent, replace(hover, unit=_UNIT, reason=linear))


def _exponent(gain: Estimate | None, span: float, commands: Sequence[float]) -> Estimate:
    """Exponent with its interval; values beyond 0 to 1 are of no motor."""
    if gain is None or gain.value is None or gain.low is None or gain.high is None:
        said = "thrust over command" if gain is None else gain.reason.removeprefix("not identified: ")
        return not_identified("", said)
    u = commands[0]
    slopes = np.array([gain.value, gain.low, gain.high]) * span * u
    found = (slopes - 1.0) / (slopes * (1.0 - u) + 2.0 * u - 1.0)
    value, low, high = found.tolist()
    if (
        not (0.0 < u < 1.0 and np.all(slopes * (1.0 - u) + 2.0 * u > 1.0))
        or high < -_BEYOND
        or low > 1.0 + _BEYOND
    ):
        return not_identified("", "no motor gives thrust as these commands say: they answered to disturbance")
    value, low, high = np.clip([value, low, high], 0.0, 1.0).tolist()
    if high - low > _WIDEST:
        return not_identified("", "its interval is too wide: climb and descend", low, high)
    return Estimate(value, low, high, "", "over the range in which the motors turn")
