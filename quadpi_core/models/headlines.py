# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What matters first of a model, in numbers that any kind gives near hover, beside those of the vehicle file.

Each is a sum of predictions at a few steady states: hover, hover with 1 m/s along an axis, and hover with the
squares of the rotor speeds changed by 10 % so that they roll, pitch or yaw.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import DERIVATIVES, aerodynamic_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.vehicle import ROTORS, Vehicle

_SPEED_M_S, _CHANGE = 1.0, 0.1


class Headline(NamedTuple):
    """A number that says what a model has found.

    Attributes:
        quantity: in words.
        value: in its unit.
        error: its standard error; None where the fit does not know it.
        known: what the vehicle file says; None where it says nothing.
        unit: SI, or ms and mm; empty for a pure number.
        note: what else there is to say; empty for nothing.
    """

    quantity: str
    value: float
    error: float | None
    known: float | None
    unit: str
    note: str = ""


def headlines(model: AerodynamicModel, vehicle: Vehicle) -> list[Headline]:
    """Thrust, drag, torque, inertia and delay, as far as the model holds the axes and was flown near hover.

    Args:
        model: of any kind.
        vehicle: of the model.
    """
    found = list(_near_hover(model, vehicle)) if model.alarm_limits.hover_rotor_speed > 0.0 else []
    if (delay := model.kind.rotor_delay(model.fitted)) is not None:
        low, high = (1e3 * bound for bound in delay.range_s or (delay.used_s, delay.used_s))
        note = f"not ruled out: {low:g} to {high:g}" if high > low else ""
        found.append(Headline("delay of the rotor speeds", 1e3 * delay.used_s, None, None, "ms", note))
    return found


def _near_hover(model: AerodynamicModel, vehicle: Vehicle) -> Iterator[Headline]:
    speed = model.alarm_limits.hover_rotor_speed
    squares = ROTORS * speed**2
    x, y, _ = vehicle.rotor_positions.T
    probe = _Probe(model, vehicle, speed)
    lift = probe.of("Fz", {(): -1.0 / squares})
    if lift is not None:
        value, error = lift
        disc = vehicle.air_density_kg_m3 * np.pi * vehicle.rotor_radius_m**4
        coefficient, by = value / disc, None if error is None else error / disc
        yield Headline("thrust coefficient C_T, hover", coefficient, by, vehicle.thrust_coefficient, "")
    for axis, name in (("Fx", "x"), ("Fy", "y")):
        drag = probe.of(axis, {(name, -_SPEED_M_S): 0.5 / _SPEED_M_S, (name, _SPEED_M_S): -0.5 / _SPEED_M_S})
        if drag is not None:
            yield Headline(f"drag near hover, {name}", *drag, None, "N s/m")
    if lift is None or not lift[0] > 0.0:
        return
    thrust, thrust_error = lift
    for axis, name, sign, stated in (("My", "x", 1.0, x), ("Mx", "y", -1.0, y)):
        moment = probe.of(axis, {(): 1e3 * sign / (squares * thrust)})
        if moment is not None:
            yield Headline(f"middle of thrust from CG, {name}", *moment, 1e3 * float(stated.mean()), "mm")
    # Moments of the change of thrusts, by the arms of the file and per torque of a rotor.
    for axis, name, levers, known in (
        ("Mx", "x", -y, vehicle.inertia[0, 0]),
        ("My", "y", x, vehicle.inertia[1, 1]),
        ("Mz", "z", -vehicle.rotor_spins, None),
    ):
        way = f"turn {name}"
        moment = probe.of(axis, {(way, _CHANGE): 0.5 / _CHANGE, (way, -_CHANGE): -0.5 / _CHANGE})
        if moment is None or not moment[0] > 0.0:
            continue
        value, error = moment
        stated = speed**2 * float(np.abs(levers).sum())
        share = None
        if error is not None and thrust_error is not None:
            share = float(np.hypot(error / value, thrust_error / thrust))
        if known is None:
            ratio = 1e3 * value / (stated * thrust)
            yield Headline(
                "torque over thrust of a rotor", ratio, None if share is None else ratio * share, None, "mm"
            )
        else:
            inertia = float(known) * thrust * stated / value
            by = None if share is None else inertia * share
            yield Headline(f"inertia {name}, by arms and thrust", inertia, by, float(known), "kg m²")


class _Probe:
    """Sums of predictions at steady states near hover."""

    def __init__(self, model: AerodynamicModel, vehicle: Vehicle, hover: float) -> None:
        self._model, self._vehicle, self._hover = model, vehicle, hover
        x, y, _ = vehicle.rotor_positions.T
        self._ways = {"turn x": -np.sign(y), "turn y": np.sign(x), "turn z": -vehicle.rotor_spins}

    def of(
        self, axis: str, weights: dict[tuple[()] | tuple[str, float], float]
    ) -> tuple[float, float | None] | None:
        """Weighted sum of the predictions of an axis, and its standard error where the fit knows it.

        None for an axis that is not held, and states that no training flight has nearly reached.
        """
        if axis not in self._model.axes:
            return None
        inputs = np.concatenate([self._inputs(state) for state in weights])
        envelope = self._model.envelope
        if np.any(envelope.input_excess(inputs) > envelope.near.margin):
            return None
        factors = np.array(list(weights.values()))
        steady = np.zeros(len(inputs), DERIVATIVES)
        predicted = self._model.evaluate(inputs, derivatives=steady).predicted[:, AXES.index(axis)]
        error = self._model.kind.standard_error(self._model.fitted, axis, inputs, factors, self._vehicle)
        return float(factors @ predicted), error

    def _inputs(self, state: tuple[()] | tuple[str, float]) -> Array:
        velocity, squares = np.zeros((1, 3)), np.full(ROTORS, self._hover**2)
        if state:
            way, amount = state
            if way in self._ways:
                squares = squares * (1.0 + amount * self._ways[way])
            else:
                velocity[0, "xyz".index(way)] = amount
        level = np.array([[1.0, 0.0, 0.0, 0.0]])
        speeds = np.sqrt(squares)[np.newaxis]
        return aerodynamic_inputs(velocity, level, np.zeros((1, 3)), speeds, self._vehicle)
