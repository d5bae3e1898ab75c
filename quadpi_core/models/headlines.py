# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What matters first of a model, in numbers that any kind gives near hover, beside those of the vehicle file.

Each is a sum of predictions at a few steady states: hover, hover with 1 m/s along an axis, and hover with the
squares of the rotor speeds changed by 10 % so that they roll, pitch or yaw.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import Derivatives, aerodynamic_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.records import Records, record_dtype
from quadpi_core.vehicle import Vehicle

THRUST, TORQUE = "thrust coefficient C_T, hover", "torque over thrust of a rotor"
INERTIAS = {axis: f"inertia {axis}, by arms and thrust" for axis in "xy"}
_SPEED_M_S, _CHANGE = 1.0, 0.1
# Standard errors to the ends of an interval of 95 %.
_ERRORS = 1.96


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


def headlines(model: AerodynamicModel, vehicle: Vehicle) -> list[Headline]:
    """Thrust, drag, torque, inertia and delay, as far as the model holds the axes and was flown near hover.

    Args:
        model: of any kind.
        vehicle: of the model.
    """
    lines = list(_near_hover(model, vehicle)) if model.alarm_limits.hover_rotor_speed > 0.0 else []
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
