# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates of the search: the effects of the simulation's registry, as columns of wrench.

A candidate is one effect with its whole-number parameters fixed, such as the number of a weak rotor. Its
other parameters are fitted: about a point of linearisation its contribution is a sum of columns, one for
each. Effects that are linear in their parameters are linearised once, at zero; others, such as wind, again at
the fitted parameters.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.errors import DiscrepancyError
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
    """

    effect: Effect
    start: Array
    free: tuple[int, ...]
    scale: Array
    centre: Array
    linear: bool

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def label(self) -> str:
        """The name with the whole-number parameters, which distinguish the candidates of one effect."""
        whole = [
            f"{p.name} {value:.0f}"
            for p, value in zip(self.effect.parameters, self.start, strict=True)
            if p.whole
        ]
        return f"{self.name} ({', '.join(whole)})" if whole else self.name

    @property
    def form(self) -> float:
        """Share by which the contribution of the effect may differ from the computed one."""
        # Wind acts through coefficients that are known within a tolerance, at airspeeds that are not.
        return AERODYNAMIC if self.effect.kind == "wind" else self.effect.form

    @property
    def step(self) -> float:
        """Half the step of a difference quotient, in prior standard deviations."""
        # Wind reverses the airspeed of a hover: a small step would see only the cusp at rest. What has a
        # state of its own is smooth, and its phase turns over a wide one.
        return _STEP if self.linear or self.effect.at_rest else _WIDE_STEP

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
    sizes = np.array([abs(parameter.default) for parameter in effect.parameters])
    units = [parameter.unit for parameter in effect.parameters]
    for index in map(int, np.flatnonzero(sizes == 0.0)):
        alike = [size for size, unit in zip(sizes, units, strict=True) if unit == units[index]]
        sizes[index] = max(alike, default=0.0) or 1.0
    for index, unit in enumerate(units):
        if unit == "kg m²":
            sizes[index] *= mass * arm * arm
        elif unit.startswith("Nm"):
            sizes[index] *= mass * arm
        elif unit.startswith(("N", "kg")):
            sizes[index] *= mass
    return sizes * arm if effect.size_grows_with_arm else sizes


def candidates(vehicle: Vehicle, names: Sequence[str] | None = None) -> list[Candidate]:
    """The candidates for a vehicle, in the order of the registry.

    Args:
        vehicle: vehicle with whose mass and arm the typical sizes scale.
        names: names of effects; unless given, all that a search looks for.

    Raises:
        DiscrepancyError: for a name that no effect has.
    """
    if names is not None:
        for name in names:
            if name not in EFFECTS:
                raise DiscrepancyError(f"unknown effect `{name}`; known: {', '.join(EFFECTS)}")
    found = []
    for effect in EFFECTS.values():
        if effect.shown_by and (names is None or effect.name in names):
            found += _variants(effect, vehicle)
    return found


def _variants(effect: Effect, vehicle: Vehicle) -> list[Candidate]:
    sizes = typical_sizes(effect, vehicle)
    free = tuple(index for index, parameter in enumerate(effect.parameters) if not parameter.whole)
    choices = [range(int(p.lowest), int(p.highest) + 1) if p.whole else (0.0,) for p in effect.parameters]
    return [
        Candidate(
            effect=effect,
            start=np.array(start, dtype=float),
            free=free,
            scale=PRIOR.value * sizes[list(free)],
            centre=_centre(effect)[list(free)],
            linear=effect.kind in ("wrench", "vehicle") and effect.composable,
        )
        for start in itertools.product(*choices)
    ]


def _centre(effect: Effect) -> Array:
    """Prior mean (P,) of the parameters."""
    centre = np.zeros(len(effect.parameters))
    if effect.at_rest:
        centre[1:] = [parameter.default for parameter in effect.parameters[1:]]
    return centre


def first_point(candidate: Candidate, flights: Sequence[Compared]) -> Array:
    """Free parameters (k,) about which a candidate is linearised first.

    No effect; for one with a state of its own the second parameter, on which that depends most, that explains
    the most of the flights, with the strength that does so.
    """
    if not candidate.effect.at_rest:
        return np.zeros(len(candidate.free))
    best, at = -1.0, candidate.centre
    for value in TRIED_LENGTHS.value:
        values = candidate.values(candidate.centre)
        values[1] = value
        starts = [flight.started(candidate.effect, values) for flight in flights]
        explained = float(np.mean([start.explained for start in starts]))
        if explained > best:
            values[0] = float(np.median([start.strength for start in starts]))
            best, at = explained, values[list(candidate.free)]
    return at


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
    result = []
    for flight in flights:
        here = flight.added(candidate.effect, candidate.values(at))
        columns = np.empty((*here.shape, len(at)))
        for index, step in enumerate(np.diag(candidate.step * candidate.scale)):
            difference = flight.added(candidate.effect, candidate.values(at + step))
            difference -= flight.added(candidate.effect, candidate.values(at - step))
            columns[:, :, index] = difference / (2.0 * candidate.step)
        result.append((here, columns))
    return result
