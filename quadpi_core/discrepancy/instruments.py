# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The part of a simulated wrench that the flight explains, for a simulation with noisy inputs of its own.

The residual is the measured wrench less the simulated one, and holds the noise of the simulation's inputs
with a minus. A column in proportion to the simulated wrench, as every tolerance is, holds the same noise:
least squares shrink the simulation to remove it, by half where the noise of the measured wrench is small, and
the lost part is then found as an effect. The remedy is instruments (two-stage least squares; Wooldridge,
Econometric Analysis of Cross Section and Panel Data, chapter 5): columns are replaced by what functions of
the flight's own states, which do not share that noise, explain of them. With many functions they would share
it again, as each explains a little of the noise (the bias of many instruments): only those are used that
explain more than noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.acceptance import FEW_FLIGHTS
from quadpi_core.discrepancy.own_state import INDEPENDENT_HZ
from quadpi_core.discrepancy.uncertain_parts import EVEN, LINEAR, SQUARED
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.vehicle import ROTORS, Vehicle

# Ridge in shares of each function's square, for those that a flight alone excites.
_RIDGE = 1e-4
# Share of a function's square below which it is a sum of those that were chosen before.
_NEW = 1e-6


class Instruments(NamedTuple):
    """Functions of the motion and the rotors of a flight, of the order of 1.

    They span the terms of aerodynamic models: thrust and torque of each rotor; drag, inflow and lift with the
    airspeed; damping with the rates; and their products with the rotor speeds. None uses the specific force.

    Attributes:
        values: (N, J).
        parts: name and law, see :class:`.uncertain_parts.Part`, and range of the functions of each part.
    """

    values: Array
    parts: tuple[tuple[str, str, slice], ...]

    @classmethod
    def of(cls, flight: Flight, vehicle: Vehicle, hover_rotor_speed: float) -> Instruments:
        """Functions of a flight."""
        speeds = flight.rotor_speeds / hover_rotor_speed
        velocity = relative_to_air(flight.velocity, flight.attitude, flight.wind)
        velocity = velocity / vehicle.hover_induced_velocity
        rates = flight.rates / 3.0
        airspeed = np.linalg.norm(velocity, axis=1)[:, None]
        mean = speeds.mean(axis=1)[:, None]
        sums = _sums(vehicle)
        summed = speeds @ sums
        by_airspeed = np.concatenate((_products(velocity), _between(velocity, rates)), axis=1)
        groups = (
            ("rates", LINEAR, (np.ones_like(mean), summed, speeds**2 @ sums, rates, _between(summed, rates),
                                _products(rates), airspeed * rates)),
            ("airspeed", LINEAR, (velocity, _between(summed, velocity))),
            (EVEN, EVEN, (by_airspeed, mean * by_airspeed)),
            (SQUARED, SQUARED, (airspeed * velocity, airspeed**2 * velocity)),
        )  # fmt: skip
        values, parts, first = [], [], 0
        for name, law, functions in groups:
            own = np.concatenate(functions, axis=1)
            parts.append((name, law, slice(first, first + own.shape[1])))
            values.append(own)
            first += own.shape[1]
        return cls(np.concatenate(values, axis=1), tuple(parts))


def learned_weights(wrenches: Sequence[Array], functions: Sequence[Array], rate_hz: float) -> list[Array]:
    """Per flight weights (J, 6) of those functions that explain more of a wrench than noise.

    Functions are taken one after the other, the one that explains most first, as long as Schwarz's criterion
    improves (Schwarz, Estimating the Dimension of a Model, 1978), with as many samples as are independent.
    The weights of a flight are those of all other flights, so that they hold nothing of its own noise
    (jackknife instruments; Angrist, Imbens and Krueger, 1999); of few flights, those of all.

    Args:
        wrenches: per flight (N, 6).
        functions: per flight (N, J).
        rate_hz: samples in a second.
    """
    squares = np.sum([np.square(own).sum(axis=0) for own in functions], axis=0)
    scale = np.sqrt(np.maximum(squares, np.finfo(float).tiny))
    grams = np.stack([(own / scale).T @ (own / scale) for own in functions])
    aims = np.stack([(own / scale).T @ wrench for own, wrench in zip(functions, wrenches, strict=True)])
    samples = sum(map(len, functions)) * min(1.0, INDEPENDENT_HZ.value / rate_hz)
    total = np.sum([np.square(wrench).sum(axis=0) for wrench in wrenches], axis=0)
    weights = np.zeros_like(aims)
    few = len(functions) < FEW_FLIGHTS.value
    for axis, left in enumerate(total):
        chosen = _chosen(grams.sum(axis=0), aims[:, :, axis].sum(axis=0), float(left), samples)
        for place in range(len(functions)):
            others = [flight for flight in range(len(functions)) if few or flight != place]
            gram = grams[others].sum(axis=0)[np.ix_(chosen, chosen)] + _RIDGE * np.eye(len(chosen))
            aim = aims[others, :, axis].sum(axis=0)[chosen]
            weights[place, chosen, axis] = np.linalg.solve(gram, aim) / scale[chosen]
    return list(weights)


def _chosen(gram: Array, aim: Array, left: float, samples: float) -> list[int]:
    """Functions of unit squares whose part of squares `left` is more than noise, best first."""
    gram, aim, chosen = gram.copy(), aim.copy(), list[int]()
    while left > 0.0:
        squares = np.diag(gram)
        new = squares > _NEW
        gains = np.where(new, aim**2 / np.where(new, squares, 1.0), 0.0)
        best = int(np.argmax(gains))
        after = max(left - float(gains[best]), np.finfo(float).tiny)
        if gains[best] <= 0.0 or samples * (np.log(left) - np.log(after)) < np.log(samples):
            break
        chosen.append(best)
        # What is left of the others, orthogonal to the chosen.
        share = gram[best] / gram[best, best]
        aim = aim - share * aim[best]
        gram = gram - np.outer(share, gram[best])
        left = after
    return chosen


def _sums(vehicle: Vehicle) -> Array:
    """Shares (4, 4) of the rotors in their mean thrust, rolling and pitching moment and torque.

    Differences of rotors are small beside what they share: they are functions by themselves, as sums of large
    ones that nearly cancel would be chosen late, and shrunk by the ridge.
    """
    x, y, _ = (vehicle.rotor_positions / np.abs(vehicle.rotor_positions[:, :2]).max()).T
    return np.stack((np.ones_like(x), y, x, vehicle.rotor_spins), axis=1) / ROTORS


def _products(values: Array) -> Array:
    """Products (N, K (K + 1) / 2) of all pairs of columns (N, K), squares included."""
    first, second = np.triu_indices(values.shape[1])
    products: Array = values[:, first] * values[:, second]
    return products


def _between(one: Array, other: Array) -> Array:
    """Products (N, K L) of the columns (N, K) of one with those (N, L) of another."""
    return (one[:, :, None] * other[:, None, :]).reshape(len(one), -1)
