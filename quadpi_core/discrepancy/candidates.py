# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the residual is regressed on: the effects of the registry, and tolerances of an unknown simulation.

A candidate is one effect with its whole-number parameters fixed, such as the number of a weak rotor. Its
other parameters are fitted: about a point of linearisation its contribution is a sum of columns, one for
each. Effects that are linear in their parameters are linearised once, at zero; others, such as wind, again at
the fitted parameters.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.simulations import Column, Tolerances
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.simulation.effect_definition import AERODYNAMIC, Effect
from quadpi_core.simulation.effect_registry import EFFECTS
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.vehicle import Vehicle

# Typical sizes of the registry are those of the Bebop 2.
_TYPICAL_MASS_KG, _TYPICAL_ARM_M = 0.374, 0.1445
PRIOR = Threshold(
    "prior of a parameter",
    1.5,
    "typical sizes, as a standard deviation",
    "an effect may well be three times as large as is typical",
    CONVENTION,
)
TRIED_LENGTHS = Threshold(
    "lengths of a cable that are tried first",
    (0.15, 0.22, 0.33, 0.5, 0.75, 1.1, 1.7, 2.5, 3.8),
    "m",
    "the period of one is 1.2 times that of the one before, and the search converges from a swing away",
    CONVENTION,
)
_STEP, _WIDE_STEP = 1e-3, 0.2
TOGETHER = Threshold(
    "variance of a coefficient that all axes of its law share",
    0.5,
    "of its variance",
    "a law may be wrong as a whole or differ by axis, and nothing says which is more likely",
    CONVENTION,
)
# Laws of an unknown simulation: what is in proportion to the motion, such as the drag of rotors; what stays
# when the motion is reversed, such as lift; and what reverses with its square, as drag of the airframe.
ROTORS, LINEAR, EVEN, SQUARED = "rotors", "the motion", "airspeed, even", "airspeed, squared"
# Axes that one force of the rotors acts on: along their axes, and in their plane.
_SHARED = (("Fz", "Mx", "My"), ("Fx", "Fy", "Mz"))


@dataclass(frozen=True)
class Candidate:
    """One effect to look for.

    Attributes:
        effect: effect of the registry.
        start: (P,) parameters, in the order of the effect: fixed whole numbers, others 0.
        free: (k,) indices of the parameters to fit.
        scale: (k,) prior standard deviation of each.
        centre: (k,) prior mean of each: 0, but for what is no strength of an effect with a state of its own.
        linear: whether one linearisation is enough.
        barred: why it may not be named, though it may be a rival of what is; empty if it may.
    """

    effect: Effect
    start: Array
    free: tuple[int, ...]
    scale: Array
    centre: Array
    linear: bool
    barred: str = ""

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def label(self) -> str:
        """The name with the whole-number parameters, which distinguish the candidates of one effect."""
        pairs = zip(self.effect.parameters, self.start, strict=True)
        whole = ", ".join(f"{p.name} {value:.0f}" for p, value in pairs if p.whole)
        return f"{self.name} ({whole})" if whole else self.name

    @property
    def form(self) -> float:
        """Share by which the contribution of the effect may differ from the computed one."""
        # Wind acts through coefficients that are known within a tolerance, at airspeeds that are not.
        return AERODYNAMIC if self.effect.kind == "wind" else self.effect.form

    def excludes(self, other: Candidate) -> bool:
        """Whether no set contains both: one effect twice, or two of a group on one rotor."""
        group = self.effect.indistinguishable_group
        alike = bool(group) and group == other.effect.indistinguishable_group
        return self.name == other.name or (alike and bool(self.start[0] == other.start[0]))

    def values(self, found: Array) -> Array:
        """All parameters (P,) from fitted ones (k,)."""
        values = self.start.copy()
        values[list(self.free)] = found
        return values

    def within_bounds(self, found: Array) -> Array:
        """Parameters (k,) brought within the bounds of the effect."""
        parameters = [self.effect.parameters[index] for index in self.free]
        return np.clip(found, [p.lowest for p in parameters], [p.highest for p in parameters])


def typical_sizes(effect: Effect, vehicle: Vehicle) -> Array:
    """Typical size (P,) of each parameter on a vehicle; one whose default is 0 has that of its neighbours.

    Forces grow with mass, moments with mass times arm, according to their units.
    """
    mass = vehicle.mass_kg / _TYPICAL_MASS_KG
    arm = float(np.linalg.norm(vehicle.rotor_positions[:, :2], axis=1).mean()) / _TYPICAL_ARM_M
    growth = {"kg m²": mass * arm**2, "Nm": mass * arm, "N": mass, "kg": mass}
    sizes = np.empty(len(effect.parameters))
    for index, own in enumerate(effect.parameters):
        alike = (abs(p.default) for p in effect.parameters if p.unit == own.unit)
        sizes[index] = abs(own.default) or max(alike) or 1.0
        # The first that fits: a moment of inertia is no mass, nor a moment a force.
        sizes[index] *= next((by for unit, by in growth.items() if own.unit.startswith(unit)), 1.0)
    return sizes * arm if effect.size_grows_with_arm else sizes


def candidates(vehicle: Vehicle, names: Sequence[str] | None = None) -> list[Candidate]:
    """The candidates for a vehicle, in the order of the registry.

    Args:
        vehicle: vehicle with whose mass and arm the typical sizes scale.
        names: names of effects; unless given, all that a search looks for.

    Raises:
        DiscrepancyError: for a name that no effect has.
    """
    for name in names or ():
        if name not in EFFECTS:
            raise DiscrepancyError(f"unknown effect `{name}`; known: {', '.join(EFFECTS)}")
    found = []
    for effect in EFFECTS.values():
        if not effect.shown_by or (names is not None and effect.name not in names):
            continue
        free = [index for index, parameter in enumerate(effect.parameters) if not parameter.whole]
        # Of what has a state of its own, only the strength may be zero.
        centre = [p.default if index and effect.at_rest else 0.0 for index, p in enumerate(effect.parameters)]
        choices = [range(int(p.lowest), int(p.highest) + 1) if p.whole else (0,) for p in effect.parameters]
        for start in itertools.product(*choices):
            found.append(
                Candidate(
                    effect=effect,
                    start=np.array(start, dtype=float),
                    free=tuple(free),
                    scale=PRIOR.value * typical_sizes(effect, vehicle)[free],
                    centre=np.array(centre)[free],
                    linear=effect.kind in ("wrench", "vehicle") and effect.composable,
                )
            )
    return found


def first_point(candidate: Candidate, flights: Sequence[Compared]) -> Array:
    """Free parameters (k,) about which a candidate is linearised first.

    No effect; for one with a state of its own the second parameter, on which that depends most, that explains
    the most of the flights, with the strength that does so: by their medians, so that no flight decides.
    """
    if not candidate.effect.at_rest:
        return np.zeros(len(candidate.free))
    tried = []
    for length in TRIED_LENGTHS.value:
        values = candidate.values(candidate.centre)
        values[1] = length
        starts = [flight.started(candidate.effect, values) for flight in flights]
        values[0] = np.median([start.strength for start in starts])
        tried.append((float(np.median([start.explained for start in starts])), values))
    return max(tried, key=lambda one: one[0])[1][list(candidate.free)]


def start_cost(candidate: Candidate, flights: Sequence[Compared], at: Array) -> float:
    """Evidence [nat] that the free states at the start of flights take from a candidate at a point (k,)."""
    if not candidate.effect.at_rest:
        return 0.0
    return sum(flight.started(candidate.effect, candidate.values(at)).cost for flight in flights)


def linearise(candidate: Candidate, flights: Sequence[Compared], at: Array) -> list[tuple[Array, Array]]:
    """Contribution and columns of a candidate for each flight, about free parameters (k,).

    Returns:
        Per flight the contribution (M, 6) at that point, and columns (M, 6, k): what one prior standard
        deviation of each parameter adds to first order.
    """
    # Wind reverses the airspeed of a hover: a small step would see only the cusp at rest. What has a state of
    # its own is smooth, and its phase turns over a wide one.
    step = _STEP if candidate.linear or candidate.effect.at_rest else _WIDE_STEP
    result = []
    for flight in flights:

        def added(free: Array, flight: Compared = flight) -> Array:
            return flight.added(candidate.effect, candidate.values(free))

        differences = [added(at + own) - added(at - own) for own in np.diag(step * candidate.scale)]
        # At zero there is no effect.
        here = added(at) if at.any() else np.zeros_like(differences[0])
        result.append((here, np.stack(differences, axis=2) / (2.0 * step)))
    return result


class Part(NamedTuple):
    """Part (N, 6) of a wrench that one law causes; parts of the same law may be wrong together."""

    name: str
    wrench: Array
    law: str


def part_columns(parts: Sequence[Part], tolerances: Tolerances) -> list[Column]:
    """Tolerances of a simulation known by its wrench alone: a column by part and axis, and one by law.

    Nobody can say which coefficients such a simulation has. Its wrench is divided into parts that different
    laws cause, and each axis of a part may be wrong by the tolerance of a coefficient. One law acts on
    several axes: a force of the rotors in their plane on Fx, Fy and Mz, one along their axes on Fz, Mx and
    My. So the axes of a part may be wrong together, as its law is, or one by one.

    The part `ROTORS`, of rotors in still air without rotation, is thrust and torque: its Fz is known as well
    as the thrust is, and its Mx and My, to which arms contribute, as well as the inertia. Every flight has
    the same columns, even one in which a part is zero.
    """
    known = {"Fz": tolerances.thrust, "Mx": tolerances.inertia, "My": tolerances.inertia}
    columns: list[Column] = []
    shared: dict[str, Array] = {}
    for part in parts:
        for axis, unit in zip(AXES, np.eye(len(AXES)), strict=True):
            name, law, share = f"{axis} of {part.name}", "", known.get(axis, tolerances.coefficient)
            if part.law != ROTORS:
                axes = next(axes for axes in _SHARED if axis in axes)
                law, share = f"{', '.join(axes[:-1])} and {axes[-1]} of {part.law}", tolerances.coefficient
                whole = share * np.sqrt(TOGETHER.value) * unit * part.wrench
                shared[law] = shared.get(law, np.zeros_like(whole)) + whole
                share *= np.sqrt(1.0 - TOGETHER.value)
            columns.append(Column(name, share * unit * part.wrench, law))
    return columns + [Column(law, whole) for law, whole in shared.items()]


def of_coefficient(own: float, shared: float) -> float:
    """What a coefficient is wrong by, in its tolerances, from the fit of its own column and of its law's."""
    return float(np.sqrt(1.0 - TOGETHER.value) * own + np.sqrt(TOGETHER.value) * shared)
