# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the residual is regressed on: effects, tolerances of a simulation, and errors of the form of laws.

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

from quadpi_core.discrepancy.effect_response import Compared, body_tolerances, share_of_wrench
from quadpi_core.discrepancy.evidence import Block
from quadpi_core.discrepancy.whitening import Columns
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.records import CONVENTION, DEVELOPMENT, Threshold
from quadpi_core.simulation.applied_effects import EFFECTS, state_modulators
from quadpi_core.simulation.effect_definition import AERODYNAMIC, Effect
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
# Smallest standard deviation of a modulator that is divided by: one that is constant has none.
_LEAST_DEVIATION = 1e-9
AXES_OVER_FORM = Threshold(
    "share of a single axis by which a law may be off",
    1.5,
    "shares by which the whole law may be off",
    "two laws of the literature for one effect differ more from axis to axis than in their mean",
    DEVELOPMENT,
)


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
        within: whether the simulation's own intervals hold all axes that it acts on. Flights may have it of
            their own, but it is nothing that the simulation lacks.
    """

    effect: Effect
    start: Array
    free: tuple[int, ...]
    scale: Array
    centre: Array
    linear: bool
    within: bool = False

    @property
    def of_a_flight(self) -> str:
        """What makes it differ from one flight to the next, in words; empty where nothing does."""
        return self.effect.of_a_flight or (
            "an error that the intervals of the model allow for" if self.within else ""
        )

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
        # A whole number is that of a rotor, of all unless its effect is of fewer.
        rotors = vehicle.rotor_count
        choices = [
            range(int(p.lowest), min(int(p.highest), rotors) + 1) if p.whole else (0,)
            for p in effect.parameters
        ]
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


@dataclass(frozen=True)
class Modulators:
    """Quantities that a law may depend on beyond its formula, standardised over all flights.

    Attributes:
        mean, deviation: (C,) over all flights.
        values: (M, C) of each flight, standardised.
    """

    mean: Array
    deviation: Array
    values: tuple[Array, ...]

    @classmethod
    def from_flights(cls, flights: Sequence[Compared]) -> Modulators:
        """Modulators of the states of the flights."""
        raw = [state_modulators(flight.states, flight.record) for flight in flights]
        everything = np.concatenate(raw)
        mean, deviation = everything.mean(axis=0), np.maximum(everything.std(axis=0), _LEAST_DEVIATION)
        return cls(mean, deviation, tuple((own - mean) / deviation for own in raw))

    def form(self, candidate: Candidate, flights: Sequence[Compared], at: Array) -> Columns:
        """Columns for the error of a law: shares of its contribution by axis, then times each modulator.

        Args:
            candidate: with that law.
            flights: beside the simulation that it contributes to.
            at: (k,) its free parameters.
        """
        axes = [AXES.index(name) for name in candidate.effect.axes]
        columns = []
        for flight, values in zip(flights, self.values, strict=True):
            here = flight.added(candidate.effect, candidate.values(at))
            single = AXES_OVER_FORM.value * here[:, :, np.newaxis] * np.eye(len(AXES))[:, axes]
            modulated = here[:, :, np.newaxis] * values[:, np.newaxis]
            columns.append(candidate.form * np.concatenate((single, modulated), axis=2))
        return in_frequency(flights, columns)


class Tolerances(NamedTuple):
    """Columns of what is uncertain in a simulation.

    Attributes:
        coefficients, body: of its own coefficients, and of the body.
        names: of all of them.
        laws: for each the name of the one of what it shares with others; empty without.
        shares: (6, 6, k) share of the wrench of the vehicle's accelerations in each of the body.
    """

    coefficients: Columns
    body: Columns
    names: tuple[str, ...]
    laws: tuple[str, ...]
    shares: Array

    @classmethod
    def from_flights(cls, flights: Sequence[Compared]) -> Tolerances:
        """Those of a simulation, without coefficients that no flight feels."""
        simulation = flights[0].simulation
        each = [flight.uncertain() for flight in flights]
        shares = []
        for effect, deviation in body_tolerances(simulation):
            for values in deviation * np.eye(len(effect.parameters)):
                moved = effect.kind == "vehicle"
                shares.append(
                    share_of_wrench(effect, simulation.vehicle, values) if moved else np.zeros((6, 6))
                )
        first = len(each[0]) - len(shares)
        felt = [k for k in range(first) if any(np.any(own[k].wrench) for own in each)]
        kept = [*felt, *range(first, len(each[0]))]

        def columns(chosen: Sequence[int]) -> Columns:
            none = [np.zeros((*flight.residual.shape, 0)) for flight in flights]
            of_flights = zip(none, each, strict=True)
            return in_frequency(
                flights, [np.dstack([empty, *(own[k].wrench for k in chosen)]) for empty, own in of_flights]
            )

        return cls(
            coefficients=columns(felt),
            body=columns(range(first, len(each[0]))),
            names=tuple(each[0][k].name for k in kept),
            laws=tuple(each[0][k].law for k in kept),
            shares=np.stack(shares, axis=2) if shares else np.zeros((6, 6, 0)),
        )


def block_of(candidate: Candidate, at: Array, flights: Sequence[Compared]) -> Block:
    """Columns of a candidate about free parameters (k,), without its form."""
    # One that is all but linear is so about no effect.
    found = linearise(candidate, flights, np.zeros_like(at) if candidate.linear else at)
    point = (at - candidate.centre) / candidate.scale
    columns = [
        own if candidate.linear else np.dstack((own, (own @ point - here)[:, :, np.newaxis]))
        for here, own in found
    ]
    bounds = [candidate.effect.parameters[free] for free in candidate.free]
    # The free states at the start of flights.
    starts = flights if candidate.effect.at_rest else ()
    cost = sum(flight.started(candidate.effect, candidate.values(at)).cost for flight in starts)
    return Block(
        columns=in_frequency(flights, columns),
        at=point,
        lowest=(np.array([p.lowest for p in bounds]) - candidate.centre) / candidate.scale,
        highest=(np.array([p.highest for p in bounds]) - candidate.centre) / candidate.scale,
        cost=float(cost),
    )


def in_frequency(flights: Sequence[Compared], columns: Sequence[Array]) -> Columns:
    """Columns (M, 6, k) in time of each flight, in frequency."""
    return Columns(tuple(flight.spectrum(own) for flight, own in zip(flights, columns, strict=True)))
