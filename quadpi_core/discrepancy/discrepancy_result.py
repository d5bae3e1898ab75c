# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a study of a simulation against flights, and the JSON made of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.discrepancy.acceptance import Verdict
from quadpi_core.discrepancy.by_condition import Where
from quadpi_core.discrepancy.closure import Gap, SearchResult
from quadpi_core.discrepancy.effect_regression import Regression
from quadpi_core.discrepancy.effect_response import (
    GAIN_LEAST,
    ROTORS_DIFFER,
    errors_of_speeds,
    scale_is_known,
)
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.discrepancy.whitening import Noise, Part, rows_of
from quadpi_core.flight import AXES, Flight
from quadpi_core.records import CONVENTION, DEVELOPMENT, Threshold, brief_repr
from quadpi_core.version import __version__

GAIN_ALIKE = Threshold(
    "share of the squares of an effect that gains of rotor speeds explain, from which that is said",
    0.8,
    "of the squares",
    "what is left of the effect is then less than half of it",
    DEVELOPMENT,
)
HIDDEN = Threshold(
    "share of the evidence of an effect that errors of rotor speeds take, from which they hide it",
    0.9,
    "of the evidence",
    "the effect would have to be three times as large to be seen as by measured speeds",
    CONVENTION,
)


@dataclass(frozen=True)
class CommandedSpeeds:
    """That rotor speeds of a search are made of commands, how well they are known, and what that hides.

    Attributes:
        flights: names of the flights concerned.
        gain: standard deviation of a gain of all speeds, from flight to flight.
        rotors: standard deviation of a gain of each rotor beside, the largest.
        scale_known: whether other flights or tachometers tell the scale of the speeds.
        hidden: effects of which these speeds hide most of what measured ones would tell.
        alike: of each named effect that errors of speeds resemble, the gains (R) that would look the same.
    """

    flights: tuple[str, ...]
    gain: float
    rotors: float
    scale_known: bool
    hidden: tuple[str, ...] = ()
    alike: tuple[tuple[str, tuple[float, ...]], ...] = ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a reader has to know."""
        told = [
            f"Rotor speeds are made of motor commands: from flight to flight their gain scatters by "
            f"{_percent(self.gain)}, that of single rotors by {_percent(self.rotors)} (standard deviations)."
        ]
        if not self.scale_known:
            told.append(
                "Their scale is that of the thrust of these flights: a mass, a thrust coefficient and a gain "
                "of all speeds cannot be told apart, and none of them is found."
            )
        told += [
            f"{name.replace('_', ' ').capitalize()} looks as if the motors turned by "
            f"{', '.join(f'{100.0 * gain:+.1f}' for gain in gains)} % (rotor 1 to {len(gains)}) off what the "
            "commands tell, in all flights: only its size speaks for it."
            for name, gains in self.alike
        ]
        return tuple(told)

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return {**asdict(self), "alike": dict(self.alike), "text": list(self.sentences)}


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def traces(regression: Regression, noise: Noise) -> dict[str, float]:
    """Evidence [nat] of each effect of the size that is looked for, of its best candidate, in some noise."""
    found: dict[str, float] = {}
    for candidate, block in zip(regression.candidates, regression.blocks, strict=True):
        squares = np.einsum("fkk->k", noise.gram(block.columns, block.columns))
        found[candidate.name] = max(
            found.get(candidate.name, 0.0), 0.5 * float(squares[: len(block.at)].sum())
        )
    return found


def hidden_effects(measured: Mapping[str, float], commanded: Mapping[str, float]) -> tuple[str, ...]:
    """Effects that lose most of their evidence [nat] as speeds are commanded ones."""
    return tuple(
        name for name, evidence in commanded.items() if evidence < (1.0 - HIDDEN.value) * measured[name]
    )


def resembles_gains(share: float) -> bool:
    """Whether gains of rotor speeds explain so much of an effect's squares that this is said."""
    return share >= GAIN_ALIKE.value


def commanded_speeds(found: SearchResult) -> CommandedSpeeds | None:
    """What is to be said of rotor speeds from commands after a search; None where all are measured."""
    regression = found.regression
    by_commands = {own.flight.name: own.flight.motors for own in regression.flights if own.flight.motors}
    if not by_commands:
        return None
    vehicle, measured = regression.flights[0].simulation.vehicle, replace(regression.noise, own=())
    with_measured, with_these = traces(regression, measured), traces(regression, regression.noise)
    alike = []
    for index in found.chosen:
        share, gain = _as_gain(regression, regression.added((index,), found.fit))
        if resembles_gains(share):
            alike.append((regression.candidates[index].name, gain))
    return CommandedSpeeds(
        flights=tuple(by_commands),
        gain=max(GAIN_LEAST.value, *(own.gain for own in by_commands.values())),
        rotors=max(max(own.error, default=ROTORS_DIFFER.value) for own in by_commands.values()),
        scale_known=all(scale_is_known(own, vehicle) for own in by_commands.values()),
        hidden=hidden_effects(with_measured, with_these),
        alike=tuple(alike),
    )


def _as_gain(regression: Regression, added: Sequence[Part]) -> tuple[float, tuple[float, ...]]:
    """Share of the squares that an effect adds which gains of rotor speeds explain, and these (R)."""
    (speeds,) = errors_of_speeds(regression.flights)
    weights, rotors = 1.0 / np.sqrt(regression.noise.variance), slice(1, speeds.columns.width - 1)
    of_effect, told, gains = 0.0, 0.0, []
    for place, (rows, band) in enumerate(speeds.columns.spectra):
        weighed = weights[place][:, band]
        effect = (weighed * rows_of(added, place)).ravel()
        columns = (weighed[:, :, np.newaxis] * rows[:, :, rotors]).reshape(len(effect), -1)
        fitted = np.linalg.lstsq(columns, effect, rcond=None)[0]
        of_effect += float(effect @ effect)
        told += float(np.sum(np.square(columns @ fitted)))
        gains.append(fitted)
    return told / of_effect if of_effect else 0.0, tuple(np.mean(gains, axis=0).tolist())


# Errors of flights that are flown again, by their names in JSON: in words.
ERROR_NAMES = {
    "position_m": "position [m]",
    "velocity_m_s": "velocity [m/s]",
    "attitude_deg": "attitude [deg]",
    "rates_rad_s": "rates [rad/s]",
}

STANDS_OUT = Threshold(
    "parameter of a flight that stands out", 3.0, "standard deviations", "a chance of 3 in 1000", CONVENTION
)


@dataclass(frozen=True)
class FoundParameter:
    """A parameter of an effect, with its interval of 95 %, see :meth:`.search.SearchResult.deviation`."""

    name: str
    unit: str
    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was named.

    Attributes:
        probability: against every other effect in its place, and none.
        shape: parameters that shape its law, see `effect_definition.SHAPE`; empty for the law itself.
        axes: in which it shows.
        rivals: effects that do about as well in its place.
        shown_by: manoeuvres that distinguish them.
    """

    name: str
    probability: float
    parameters: tuple[FoundParameter, ...]
    shape: Mapping[str, float]
    axes: tuple[str, ...]
    rivals: tuple[str, ...]
    shown_by: tuple[str, ...]


class OfFlight(NamedTuple):
    """A parameter of one flight, and its standard deviation."""

    value: float
    deviation: float

    @property
    def stands_out(self) -> bool:
        """Whether it is more than what may be chance."""
        return abs(self.value) > STANDS_OUT.value * self.deviation


class FlightCondition(NamedTuple):
    """A parameter of an effect of which each flight has its own value: no effect that the simulation lacks.

    It has a likely cause, in words, and by the name of each flight what it has beside what all share.
    """

    effect: str
    parameter: str
    unit: str
    cause: str
    flights: Mapping[str, OfFlight]

    @property
    def sentence(self) -> str:
        """Which flights differ by how much, most first; those of less than half of the most are left out."""
        ranked = sorted(self.flights.items(), key=lambda item: -abs(item[1].value))
        told = ", ".join(
            f"{name} {own.value:+.2g} ± {2.0 * own.deviation:.1g}"
            for name, own in ranked
            if abs(own.value) > 0.5 * abs(ranked[0][1].value)
        )
        unit = f" {self.unit}" if self.unit else ""
        return f"flights differ in {self.parameter} of {self.effect}: {told}{unit} ({self.cause}?)"


@dataclass(frozen=True)
class RankedCandidate:
    """What speaks for and against one candidate.

    Attributes:
        name: name of the effect.
        label: the name with the rotor, where there is one.
        named: whether it is among the effects of the result.
        beside: names of the effects beside which it was judged last.
        gain: evidence that it gained there [nat]; None where it failed an earlier test.
        needed: evidence that it needed there [nat].
        test: name of the test that decided.
        reason: sentence of that test.
        closes: by axis, the share of the gap above the floor that is credited to its contribution, fitted
            beside the named effects and the tolerances, see :class:`Reduction`; negative where the axis gets
            worse. Axes without a gap are left out; empty for a candidate that was not fitted.
        cancels: those of the axes that it makes worse with the coefficients as stated, and better only with
            coefficients that move against it.
        rivals: labels of candidates that do about as well in its place, with their odds against it.
    """

    name: str
    label: str
    named: bool
    beside: tuple[str, ...]
    gain: float | None
    needed: float | None
    test: str
    reason: str
    closes: Mapping[str, float]
    cancels: tuple[str, ...]
    rivals: Mapping[str, float]

    @property
    def over_need(self) -> float:
        """Evidence in multiples of what is needed; negative infinity where it was not weighed."""
        return self.gain / self.needed if self.gain is not None and self.needed else -math.inf

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        named = {"gain": "evidence_nat", "needed": "needed_nat"}
        return {named.get(name, name): value for name, value in asdict(self).items()}


@dataclass(frozen=True)
class Discovery:
    """The effects that a simulation lacks.

    Attributes:
        effects: named effects, largest first.
        unexplained: share of the predictable discrepancy that no effect explains, of all axes or a loud one.
        unexplained_by: generic functions that predict each axis that matters.
        without_trace: effects that cannot be found: these flights would hardly differ with them.
        within_intervals: effects that single flights may have, but none is named, as intervals hold all axes
            that they act on.
        checks: tests of the whole result, passed or not.
        candidates: every candidate with its evidence, best first.
        adjusted: whether coefficients are moved with the effects, which flights left out ask for.
        conditions: what single flights have of their own.
        flown: gap in roll-outs and closed loop; None where no effect was named, and until it is flown.
        commanded: how well rotor speeds from commands are known, and what that hides; None for measured ones.
    """

    __repr__ = brief_repr

    effects: tuple[FoundEffect, ...]
    unexplained: float
    unexplained_by: Mapping[str, list[str]]
    gap: Gap
    found: SearchResult
    without_trace: tuple[str, ...] = ()
    within_intervals: tuple[str, ...] = ()
    checks: tuple[Verdict, ...] = ()
    candidates: tuple[RankedCandidate, ...] = ()
    adjusted: bool = True
    conditions: tuple[FlightCondition, ...] = ()
    flown: Reflights | None = None
    commanded: CommandedSpeeds | None = None

    @property
    def verdict(self) -> str:
        """One of "unknown", where a test of the whole result failed, "effects", and "none" without any."""
        if not all(check.passed for check in self.checks):
            return "unknown"
        return "effects" if self.effects else "none"

    @property
    def added(self) -> bool:
        """Whether the effects are added to the simulation: those of the verdict "unknown" never are."""
        return self.verdict == "effects"

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences that say why the verdict is "unknown"; empty for any other."""
        return tuple(check.sentence for check in self.checks if not check.passed)


class BeforeAfter(NamedTuple):
    """A root-mean-square error without and with the effects, and its floor: that of sensors and estimator."""

    before: float
    after: float
    floor: float

    @property
    def reduction(self) -> float:
        """Share of the error above the floor that the effects remove; 0 without any."""
        removable, kept = (max(error**2 - self.floor**2, 0.0) for error in (self.before, self.after))
        return 1.0 - (kept / removable) ** 0.5 if removable else 0.0


class Rollouts(NamedTuple):
    """Errors at the end of roll-outs from many starts, as `ERROR_NAMES`; none where every one was lost.

    Those that diverged are left out and counted as lost, by the names of :class:`BeforeAfter`. Errors
    `by_chance` are those whose mean growth over flights is not significant.
    """

    horizon_s: float
    starts: int
    errors: Mapping[str, BeforeAfter]
    lost: Mapping[str, int] = MappingProxyType({})
    by_chance: frozenset[str] = frozenset()


class ClosedLoops(NamedTuple):
    """References of so many flights flown again by the simulation, against the measured flights.

    Attributes:
        missing: reason why none could be; empty where some could.
        lost: reason for each flight that got out of control.
        errors: as `ERROR_NAMES`; none without flights.
    """

    flights: int
    missing: str = ""
    lost: tuple[str, ...] = ()
    errors: Mapping[str, BeforeAfter] = MappingProxyType({})

    @property
    def reduction(self) -> float | None:
        """Share of the removable error that the effects remove; None without flights."""
        return float(np.mean([own.reduction for own in self.errors.values()])) if self.errors else None


class Coverage(NamedTuple):
    """Share of samples inside the intervals of a model, without and with the effects in its predictions."""

    before: float
    after: float


class Reflights(NamedTuple):
    """The gap in flight: open loop, with a controller, and coverage by axis of a model with intervals."""

    rollout: Rollouts
    closed_loop: ClosedLoops
    coverage: Mapping[str, Coverage]


@dataclass(frozen=True)
class Study:
    """A simulation beside flights.

    Attributes:
        not_flown: manoeuvres that no flight contains.
    """

    __repr__ = brief_repr

    simulation: Simulation
    flights: tuple[Flight, ...]
    discovery: Discovery
    where: Where
    not_flown: tuple[str, ...]
    seed: int

    @property
    def in_sample(self) -> tuple[str, ...]:
        """Names of the flights that the simulation was identified on, by their hashes."""
        return tuple(flight.name for flight in self.flights if self.simulation.identified_on(flight))


def study_json(study: Study) -> dict[str, Any]:
    """A study as JSON holds it."""
    return {
        "quadpi_version": __version__,
        "simulation": study.simulation.name,
        "code": study.simulation.code or None,
        "vehicle": study.simulation.vehicle.name,
        "seed": study.seed,
        "flights": {
            flight.name: {
                "duration_s": float(flight.time[-1] - flight.time[0]),
                "data_quality": flight.quality.to_json(),
                "unjudged_samples": study.simulation.unjudged(flight),
                "sha256": flight.sha256,
                "in_sample": flight.name in study.in_sample,
            }
            for flight in study.flights
        },
        **discovery_json(study.discovery),
        "where": [vars(part) | {"text": part.text} for part in study.where.ranges],
        "segments": [vars(segment) for segment in study.where.segments],
        **(reflights_json(study.discovery.flown) if study.discovery.flown else {}),
        "not_flown": list(study.not_flown),
    }


def discovery_json(discovery: Discovery) -> dict[str, Any]:
    """What is missing, as JSON holds it."""
    gap, inside, intervals = discovery.gap, discovery.found.inside, None
    if inside is not None:
        shares = zip(AXES, inside.shares.mean(axis=0).tolist(), inside.held.tolist(), strict=True)
        stated = inside.confidence
        intervals = {axis: {"inside": share, "stated": stated, "held": held} for axis, share, held in shares}
    errors = zip(AXES, np.transpose([gap.before, gap.after, gap.floor]).tolist(), strict=True)
    return {
        "verdict": discovery.verdict,
        "effects": [
            {
                "name": effect.name,
                "probability": effect.probability,
                "parameters": {
                    p.name: {"value": p.value, "lower": p.lower, "upper": p.upper, "unit": p.unit}
                    for p in effect.parameters
                },
                "shape": dict(effect.shape),
                "axes": list(effect.axes),
                "shown_by": list(effect.shown_by),
            }
            for effect in discovery.effects
        ],
        "ambiguous": [[effect.name, *effect.rivals] for effect in discovery.effects if effect.rivals],
        "gap": {axis: BeforeAfter(*own)._asdict() for axis, own in errors} | {"reduction": gap.reduction},
        "intervals": intervals,
        "conditions": [own._asdict() | {"flights": _by_name(own.flights)} for own in discovery.conditions],
        "rotor_speeds_from_commands": discovery.commanded and discovery.commanded.to_json(),
        "without_trace": list(discovery.without_trace),
        "within_intervals": list(discovery.within_intervals),
        "doubts": list(discovery.doubts),
        "checks": [
            {"test": c.test, "passed": c.passed, "value": c.value, "limit": c.threshold, "text": c.sentence}
            for c in discovery.checks
        ],
        "candidates": [candidate.to_json() for candidate in discovery.candidates],
        "unexplained": {"share": discovery.unexplained, "by": dict(discovery.unexplained_by)},
    }


def reflights_json(flown: Reflights) -> dict[str, Any]:
    """The gap in flight, as JSON holds it."""
    rollout, loop = flown.rollout, flown.closed_loop
    open_loop: dict[str, Any] = {"horizon_s": rollout.horizon_s, "starts": rollout.starts}
    if any(rollout.lost.values()):
        open_loop["lost"] = dict(rollout.lost)
    closed: dict[str, Any] = {"flights": loop.flights}
    closed |= {"missing": loop.missing} if loop.missing else {"lost": list(loop.lost)} | _by_name(loop.errors)
    if loop.reduction is not None:
        closed["reduction"] = loop.reduction
    coverage = {"coverage": _by_name(flown.coverage)} if flown.coverage else {}
    return {"rollout": open_loop | _by_name(rollout.errors), "closed_loop": closed, **coverage}


def _by_name(records: Mapping[str, Any]) -> dict[str, Any]:
    return {name: record._asdict() for name, record in records.items()}
