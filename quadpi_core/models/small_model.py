# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A model of few parameters, as flight stacks and other simulators have, nearest to an identified one.

Thrust and torque are k ω² of each rotor, as near hover. Drag is PX4's, F = −m (M + ½ ρ |v| / B) v along x and
y, by least squares of what the model predicts for steady flight to and fro, tilted as that takes, at speeds
that its flights have reached. Each is a sum of predictions, and its standard error is that by the covariance
of the model's parameters; drag errs, beside that, as the intervals of these predictions say, which know what
the terms of the model lack. What flights differ by, a covariance of samples does not know: each number is
found again without each of the flights, and where that says more, the error is the jackknife's by flight
(B. Efron, R. Tibshirani, An Introduction to the Bootstrap, 1993, ch. 11).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy import stats
from scipy.special import ndtri

from quadpi_core.field.drag import WIDEST_RATIO
from quadpi_core.field.estimates import Estimate, beyond_zero, not_identified, within
from quadpi_core.flight import AXES
from quadpi_core.frames import Array, from_rotation_vector
from quadpi_core.inputs import INPUT_INDEX, STANDARD_DENSITY, Derivatives, aerodynamic_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.records import CONVENTION, Records, Threshold, record_dtype
from quadpi_core.vehicle import Vehicle

THRUST, TORQUE = "thrust coefficient C_T, hover", "torque over thrust of a rotor"
INERTIAS = {axis: f"inertia {axis}, by arms and thrust" for axis in "xy"}
_SPEED_M_S, _CHANGE = 1.0, 0.1
# Standard errors to the ends of an interval of 95 %.
_ERRORS = 1.96
# Fewest flights for a jackknife.
_FEWEST_FLIGHTS = 3
# Drag of PX4: momentum drag, and the inverses of both ballistic coefficients.
_DRAGS = ("momentum drag", "bluff-body drag along x", "bluff-body drag along y")


class Headline(NamedTuple):
    """A number that says what a model has found.

    Attributes:
        quantity: in words.
        value: in its unit.
        error: its standard error; None where the fit does not know it.
        known: what the vehicle file says; None where it says nothing.
        unit: SI, or ms and mm; empty for a pure number.
        note: what else there is to say; empty for nothing.
        by_air: least and largest share that the density of the air leaves of the value, at that of the file.
    """

    quantity: str
    value: float
    error: float | None
    known: float | None
    unit: str
    note: str = ""
    by_air: tuple[float, float] = (1.0, 1.0)

    def interval(self) -> tuple[float, float] | None:
        """Of 95 %, by standard error and air; None where the error is not known."""
        return None if self.error is None else interval(self.value, self.error, self.by_air)


def interval(value: float, error: float, by_air: tuple[float, float]) -> tuple[float, float]:
    """Ends of an interval of 95 % by a standard error, and by the least and largest share that air leaves."""
    low, high = (
        value + side * np.hypot(_ERRORS * error, value * (share - 1.0))
        for side, share in zip((-1.0, 1.0), by_air, strict=True)
    )
    return float(low), float(high)


def errors_by_flight(model: AerodynamicModel, vehicle: Vehicle) -> dict[str, float]:
    """Jackknife standard errors of the numbers of a small model, by the name of the number.

    Widened by Student's t for the number of flights, as intervals take 1.96 of them. Empty for a model that
    does not hold the fits without each flight.
    """
    each = [_numbers(replace(model, fitted=own, by_flight={}), vehicle) for own in model.left_out]
    if len(each) < _FEWEST_FLIGHTS:
        return {}
    widening = float(stats.t.ppf(0.975, len(each) - 1)) / _ERRORS
    return {
        name: widening * float(np.sqrt((len(own) - 1) * np.var(own)))
        for name in each[0]
        if len(own := [one[name] for one in each if name in one]) == len(each)
    }


def _numbers(model: AerodynamicModel, vehicle: Vehicle) -> dict[str, float]:
    """Values by name, PX4's drag in the parameters that it is linear in."""
    found = {line.quantity: line.value for line in headlines(model, vehicle) if line.error is not None}
    flown, _ = _drag_flown(model, vehicle)
    if flown:
        sums = _least_squares(flown, vehicle, (), {})
        found |= dict(zip(_DRAGS, (value for value, _ in sums), strict=True))
    return found


def headlines(model: AerodynamicModel, vehicle: Vehicle) -> list[Headline]:
    """Thrust, drag, torque, inertia and delay, as far as the model holds the axes and was flown near hover.

    Args:
        model: of any kind.
        vehicle: of the model.
    """
    lines = [
        line._replace(error=max(line.error, model.by_flight.get(line.quantity, 0.0)))
        if line.error is not None
        else line
        for line in (_near_hover(model, vehicle) if model.alarm_limits.hover_rotor_speed > 0.0 else ())
    ]
    if (delay := model.fitted.rotor_delay) is not None:
        low, high = (1e3 * bound for bound in delay.range_s or (delay.used_s, delay.used_s))
        note = f"not ruled out: {low:g} to {high:g}" if high > low else ""
        lines.append(Headline("delay of the rotor speeds", 1e3 * delay.used_s, None, None, "ms", note))
    return lines


def _near_hover(model: AerodynamicModel, vehicle: Vehicle) -> Iterator[Headline]:
    speed = model.alarm_limits.hover_rotor_speed
    squares = vehicle.rotor_count * speed**2
    x, y, _ = vehicle.rotor_positions.T
    by_air = model.share_of_air()

    def of(axis: str, *weighted: _Weighted) -> tuple[float, float | None] | None:
        return _weighted_sum(model, vehicle, axis, weighted)

    lift = of("Fz", (-1.0 / squares, "", 0.0))
    if lift is not None:
        value, error = lift
        disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
        coefficient, by = value / disc, None if error is None else error / disc
        yield Headline(THRUST, coefficient, by, vehicle.thrust_coefficient, "", by_air=by_air)
    for axis, name in (("Fx", "x"), ("Fy", "y")):
        half = 0.5 / _SPEED_M_S
        drag = of(axis, (half, name, -_SPEED_M_S), (-half, name, _SPEED_M_S))
        if drag is not None:
            yield Headline(f"drag near hover, {name}", *drag, None, "N s/m", by_air=by_air)
    if lift is None or not lift[0] > 0.0:
        return
    thrust, thrust_error = lift
    for axis, name, sign, stated in (("My", "x", 1.0, x), ("Mx", "y", -1.0, y)):
        moment = of(axis, (1e3 * sign / (squares * thrust), "", 0.0))
        if moment is not None:
            yield Headline(f"middle of thrust from CG, {name}", *moment, 1e3 * float(stated.mean()), "mm")
    # Moments of the change of thrusts, by the arms of the file and per torque of a rotor.
    for axis, name, levers, known in (
        ("Mx", "x", -y, float(vehicle.inertia[0, 0])),
        ("My", "y", x, float(vehicle.inertia[1, 1])),
        ("Mz", "z", -vehicle.rotor_spins, None),
    ):
        half = 0.5 / _CHANGE
        moment = of(axis, (half, f"turn {name}", _CHANGE), (-half, f"turn {name}", -_CHANGE))
        if moment is None or not moment[0] > 0.0:
            continue
        value, error = moment
        arms = speed**2 * float(np.abs(levers).sum())
        quantity, estimate, unit = TORQUE, 1e3 * value / (arms * thrust), "mm"
        if known is not None:
            quantity, unit = INERTIAS[name], "kg m²"
            estimate = known * thrust * arms / value
        by = None
        if error is not None and thrust_error is not None:
            by = estimate * float(np.hypot(error / value, thrust_error / thrust))
        yield Headline(quantity, estimate, by, known, unit)


# Weight of a prediction at a steady state: hover, or hover but for a velocity along an axis, or a share of
# the squares of the rotor speeds that turns the vehicle about one.
_Weighted: TypeAlias = tuple[float, str, float]


def _weighted_sum(
    model: AerodynamicModel, vehicle: Vehicle, axis: str, weighted: Sequence[_Weighted]
) -> tuple[float, float | None] | None:
    """Sum of the predictions of an axis, and its standard error where the fit knows it.

    None for an axis that is not held, and states that no training flight has nearly reached.
    """
    if axis not in model.axes:
        return None
    inputs, steady = map(
        np.concatenate,
        zip(*(_steady(vehicle, model, way, amount) for _, way, amount in weighted), strict=True),
    )
    envelope = model.envelope
    if np.any(envelope.input_excess(inputs) > envelope.near.margin):
        return None
    factors = np.array([weight for weight, _, _ in weighted])
    predicted = model.evaluate(inputs, derivatives=steady).predicted[:, AXES.index(axis)]
    error = model.fitted.standard_error(axis, inputs, steady, factors, vehicle)
    return float(factors @ predicted), error


def _steady(vehicle: Vehicle, model: AerodynamicModel, way: str, amount: float) -> tuple[Array, Records]:
    """Input vector (1, 19) and derivatives (1,) of a state."""
    x, y, _ = vehicle.rotor_positions.T
    turns = {"turn x": -np.sign(y), "turn y": np.sign(x), "turn z": -vehicle.rotor_spins}
    velocity, squares = (
        np.zeros((1, 3)),
        np.full(vehicle.rotor_count, model.alarm_limits.hover_rotor_speed**2),
    )
    if way in turns:
        squares = squares * (1.0 + amount * turns[way])
    elif way:
        velocity[0, "xyz".index(way)] = amount
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    speeds, steady = np.sqrt(squares)[np.newaxis], np.zeros(1, record_dtype(Derivatives, vehicle.rotor_count))
    steady["rotor_speeds"] = speeds
    return aerodynamic_inputs(velocity, level, np.zeros((1, 3)), speeds, vehicle), steady


LEAST_SPEED = Threshold(
    "speed to and fro along x and y that flights must have reached to tell of drag",
    3.0,
    "m/s",
    "at less, drag is some hundredths of the weight, as much as a tilt of the IMU by a degree or two",
    CONVENTION,
)
# Of the largest.
_SPEEDS = np.array([0.25, 0.5, 0.75, 1.0])
_NO_ERROR = "this kind of model has no standard errors: identify a physical one"


@dataclass(frozen=True)
class SmallModel:
    """Parameters with 95 % intervals and, in place of a number that flights do not tell, why.

    Attributes:
        vehicle: mass, rotors, and what else flights do not tell.
        identity: of the model.
        thrust: of a rotor at hover over ω², N s².
        torque: of a rotor over its thrust, m.
        hover_speed: of the rotors, rad/s.
        inertia: about x, y and z, kg m²; of the vehicle file where flights do not tell it.
        momentum, ballistic: PX4's MCOEF, 1/s, and BCOEF along x and y, kg/m², at standard density.
    """

    vehicle: Vehicle
    identity: str
    thrust: Estimate
    torque: Estimate
    hover_speed: Estimate
    inertia: tuple[Estimate, Estimate, Estimate]
    momentum: Estimate
    ballistic: tuple[Estimate, Estimate]


def small_model(model: AerodynamicModel, vehicle: Vehicle) -> SmallModel:
    """The small model nearest to an identified one of the vehicle."""
    lines = {line.quantity: line for line in headlines(model, vehicle)}
    disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
    thrust = _estimate(lines.get(THRUST), disc, "N s²", "near hover")
    torque = _estimate(lines.get(TORQUE), 1e-3, "m", "near hover")
    hover = not_identified("rad/s", "thrust is not")
    if thrust.value is not None and thrust.low is not None and thrust.high is not None:
        each = vehicle.mass_kg * vehicle.gravity_m_s2 / vehicle.rotor_count
        speeds = np.sqrt(each / np.array([thrust.value, thrust.high, thrust.low])).tolist()
        hover = within(speeds, "rad/s", f"with {vehicle.mass_kg:g} kg in air of this density")
    about = {
        axis: _estimate(lines.get(name), 1.0, "kg m²", "by arms and mass of the vehicle file")
        for axis, name in INERTIAS.items()
    }
    stated = Estimate(
        float(vehicle.inertia[2, 2]), unit="kg m²", reason="of the vehicle file: flights do not tell it"
    )
    momentum, ballistic = _drag(model, vehicle)
    return SmallModel(
        vehicle, model.identity, thrust, torque, hover, (about["x"], about["y"], stated), momentum, ballistic
    )


def _estimate(line: Headline | None, scale: float, unit: str, condition: str) -> Estimate:
    if line is None:
        return not_identified(unit, "no flight of the model was near hover")
    if line.error is None:
        return not_identified(unit, _NO_ERROR)
    ends = (scale * end for end in (line.value, *(line.interval() or ())))
    return beyond_zero(within(ends, unit, condition))


def _drag(model: AerodynamicModel, vehicle: Vehicle) -> tuple[Estimate, tuple[Estimate, Estimate]]:
    """MCOEF, and BCOEF along x and y."""
    flown, said = _drag_flown(model, vehicle)
    if not flown:
        return not_identified("1/s", said), (not_identified("kg/m²", said),) * 2
    fast = model.share_of_air()
    # Momentum drag goes with the square root of the density.
    slow = (fast[0] ** 0.5, fast[1] ** 0.5)
    without: list[int] = []
    while True:
        sums = _least_squares(flown, vehicle, without, model.by_flight)
        momentum, *squares = (
            beyond_zero(within((value, *interval(value, error, by_air)), "1/s", said))
            for (value, error), by_air in zip(sums, (slow, fast, fast), strict=True)
        )
        ballistic = [_inverse(square, said) for square in squares]
        # A square of no known size would take its part of the drag from the other terms.
        unknown = [axis for axis in (0, 1) if axis not in without and ballistic[axis].value is None]
        if not unknown:
            return momentum, (ballistic[0], ballistic[1])
        without += unknown


def _drag_flown(model: AerodynamicModel, vehicle: Vehicle) -> tuple[list[_ToAndFro], str]:
    """Predictions along x and y with the condition under which they hold; or none, and why."""
    lower, upper = model.envelope.lower, model.envelope.upper
    most = [float(min(-lower[INPUT_INDEX[name]], upper[INPUT_INDEX[name]])) for name in "uv"]
    why = (
        ""
        if {"Fx", "Fy", "Fz"} <= set(model.axes) and model.alarm_limits.hover_rotor_speed > 0.0
        else "no hover"
    )
    if min(most) < LEAST_SPEED.value:
        why = f"flights to and fro reach {min(most):.1f} m/s"
    flown = [] if why else [_flown_to_and_fro(model, vehicle, axis, most[axis]) for axis in (0, 1)]
    told = [one for one in flown if one is not None]
    if len(told) < len(most):
        return [], why or _NO_ERROR
    return told, f"steady flight to {most[0]:.1f} m/s along x and {most[1]:.1f} along y"


def _inverse(square: Estimate, condition: str) -> Estimate:
    """BCOEF of drag with the square of speed."""
    if not square.value or square.low is None or square.high is None:
        reason = "drag that grows with the square of speed is within its error; MCOEF is without it"
        return not_identified("kg/m²", reason)
    if square.high > WIDEST_RATIO.value * square.low:
        return not_identified("kg/m²", "its interval is too wide: fly faster")
    return Estimate(1.0 / square.value, 1.0 / square.high, 1.0 / square.low, "kg/m²", condition)


class _ToAndFro(NamedTuple):
    """Predictions at S speeds along an axis and S against it.

    Attributes:
        along: (S,) m/s, airspeed along the body axis.
        drag: (S,) N, half the difference of the forces.
        deviation: (S,) N, of that by the intervals of the predictions.
        error_of: standard error of a sum with weights (S,), by the covariance of the parameters; None of a
            kind of model that has none.
    """

    along: Array
    drag: Array
    deviation: Array
    error_of: Callable[[Array], float | None]


def _flown_to_and_fro(model: AerodynamicModel, vehicle: Vehicle, axis: int, most: float) -> _ToAndFro | None:
    """Steady flight along x or y; None for a kind of model that has no standard errors."""
    speeds = most * np.concatenate([_SPEEDS, -_SPEEDS])
    rotors = np.full((len(speeds), vehicle.rotor_count), model.alarm_limits.hover_rotor_speed)
    steady = np.zeros(len(speeds), record_dtype(Derivatives, vehicle.rotor_count))
    weight, tilt = vehicle.mass_kg * vehicle.gravity_m_s2, np.zeros(len(speeds))
    # Tilt and rotor speeds that hold drag and weight at that tilt and speed: a fourth round changes 1e-4.
    for _ in range(3):
        velocity, turn = np.zeros((2, len(speeds), 3))
        velocity[:, axis], velocity[:, 2] = speeds * np.cos(tilt), -np.abs(speeds) * np.sin(tilt)
        # Forward with the nose down, to the right with the right side down.
        turn[:, 1 - axis] = (-1.0, 1.0)[axis] * np.sign(speeds) * tilt
        steady["rotor_speeds"] = rotors
        inputs = aerodynamic_inputs(
            velocity, from_rotation_vector(turn), np.zeros_like(velocity), rotors, vehicle
        )
        evaluation = model.evaluate(inputs, derivatives=steady)
        tilt = np.arcsin(np.clip(np.abs(evaluation.predicted[:, axis]) / weight, 0.0, 0.9))
        lift = np.maximum(-evaluation.predicted[:, 2], 0.1 * weight)
        rotors = rotors * np.sqrt(weight * np.cos(tilt) / lift)[:, np.newaxis]
    count = len(_SPEEDS)
    deviation = 0.5 * (evaluation.upper - evaluation.lower)[:, axis] / ndtri(0.5 + 0.5 * model.confidence)

    def error_of(weights: Array) -> float | None:
        both = 0.5 * np.concatenate([-weights, weights])
        return model.fitted.standard_error(AXES[axis], inputs, steady, both, vehicle)

    if error_of(np.ones(count)) is None:
        return None
    drag = 0.5 * (evaluation.predicted[count:, axis] - evaluation.predicted[:count, axis])
    spread = 0.5 * np.hypot(deviation[:count], deviation[count:])
    return _ToAndFro(velocity[:count, axis], drag, spread, error_of)


def _least_squares(
    flown: Sequence[_ToAndFro], vehicle: Vehicle, without: Sequence[int], by_flight: Mapping[str, float]
) -> list[tuple[float, float]]:
    """MCOEF and the inverses of both BCOEF, each with its standard error; 0 where it is to be `without`."""
    ratio, count = vehicle.air_density_kg_m3 / STANDARD_DENSITY, len(_SPEEDS)
    design = np.zeros((2, count, 3))
    for axis, one in enumerate(flown):
        design[axis, :, 0] = np.sqrt(ratio) * one.along
        if axis not in without:
            design[axis, :, 1 + axis] = 0.5 * vehicle.air_density_kg_m3 * one.along**2
    weights = np.linalg.pinv(design.reshape(2 * count, 3)).reshape(3, 2, count) / vehicle.mass_kg
    found = []
    for name, row in zip(_DRAGS, weights, strict=True):
        value = sum(float(own @ one.drag) for own, one in zip(row, flown, strict=True))
        # Axes share parameters, and neighbouring speeds what terms lack: errors add up at worst.
        error = sum(one.error_of(own) or 0.0 for own, one in zip(row, flown, strict=True))
        spread = sum(float(np.abs(own) @ one.deviation) for own, one in zip(row, flown, strict=True))
        found.append((value, max(float(np.hypot(error, spread)), by_flight.get(name, 0.0))))
    return found
