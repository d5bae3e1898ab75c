# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a study of a simulation against flights, and the JSON made of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple

from quadpi_core.brief_repr import brief_repr
from quadpi_core.discrepancy.by_condition import Where
from quadpi_core.discrepancy.closure import Gap
from quadpi_core.discrepancy.ranked_evidence import RankedCandidate
from quadpi_core.discrepancy.search import Found
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.discrepancy.unexplained import Inside
from quadpi_core.discrepancy.verdict import Verdict
from quadpi_core.flight import AXES, Flight
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.version import __version__

# Errors of flights that are flown again, by their names in JSON: in words.
ERROR_NAMES = {
    "position_m": "position [m]",
    "velocity_m_s": "velocity [m/s]",
    "attitude_deg": "attitude [deg]",
    "rates_rad_s": "rates [rad/s]",
}

STANDS_OUT = Threshold(
    "parameter of a flight that stands out",
    3.0,
    "of its standard deviations",
    "a chance of three in a thousand for a flight that does not differ",
    CONVENTION,
)


@dataclass(frozen=True)
class FoundParameter:
    """A parameter of an effect, with its interval of 95 %.

    It is that of the posterior, or a wider one where flights that are left out in turn disagree more, or the
    law may be further off; see :meth:`.search.Found.deviation`.
    """

    name: str
    unit: str
    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was named.

    Attributes:
        name: name in the registry.
        probability: probability against every other effect in its place, and none.
        parameters: all parameters of the effect.
        shape: parameters that shape its law, see `simulation.effect_definition.SHAPE`; empty for the law
            itself.
        axes: axes in which it shows.
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


@dataclass(frozen=True)
class FlightCondition:
    """A parameter of an effect of which each flight has its own value: no effect that the simulation lacks.

    Attributes:
        effect: name of the effect.
        parameter, unit: of the parameter.
        cause: what is likely to make it, in words.
        by_flight: by the name of the flight, what it has beside what all share.
    """

    effect: str
    parameter: str
    unit: str
    cause: str
    by_flight: Mapping[str, OfFlight]

    @property
    def sentence(self) -> str:
        """Which flights differ by how much, most first; those of less than half of the most are left out."""
        most = max(abs(own.value) for own in self.by_flight.values())
        far = {name: own for name, own in self.by_flight.items() if abs(own.value) > 0.5 * most}
        told = ", ".join(
            f"{name} {own.value:+.2g} ± {2.0 * own.deviation:.1g}"
            for name, own in sorted(far.items(), key=lambda item: -abs(item[1].value))
        )
        unit = f" {self.unit}" if self.unit else ""
        return f"flights differ in {self.parameter} of {self.effect}: {told}{unit} ({self.cause}?)"


@dataclass(frozen=True)
class Discovery:
    """The effects that a simulation lacks.

    Attributes:
        verdict: "none", "effects" or "unknown".
        effects: named effects, largest first.
        unexplained: share of the predictable discrepancy that no effect explains, of all axes together or of
            a loud axis.
        unexplained_by: generic functions that predict each axis that matters.
        gap: gap before and after.
        found: result of the search.
        without_trace: effects that cannot be found: with them, these flights would hardly differ from this
            simulation.
        within_intervals: effects that were not looked for, as they act on axes alone that the intervals of an
            identified model hold.
        checks: tests of the whole result, passed or not.
        candidates: every candidate with its evidence, best first.
        adjusted: whether coefficients are moved with the effects, where flights left out are simulated better
            so.
        rejected: whether flights left out are simulated worse with the effects.
        inside: what the intervals of the simulation hold of the flights; None without intervals.
        conditions: what single flights have of their own.
    """

    __repr__ = brief_repr

    verdict: str
    effects: tuple[FoundEffect, ...]
    unexplained: float
    unexplained_by: Mapping[str, list[str]]
    gap: Gap
    found: Found
    without_trace: tuple[str, ...] = ()
    within_intervals: tuple[str, ...] = ()
    checks: tuple[Verdict, ...] = ()
    candidates: tuple[RankedCandidate, ...] = ()
    adjusted: bool = True
    rejected: bool = False
    inside: Inside | None = None
    conditions: tuple[FlightCondition, ...] = ()

    @property
    def added(self) -> bool:
        """Whether the effects are added to the simulation: those of the verdict "unknown" never are."""
        return self.verdict == "effects"

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences that say why the verdict is "unknown"; empty for any other."""
        return tuple(check.sentence for check in self.checks if not check.passed)


@dataclass(frozen=True)
class BeforeAfter:
    """A root-mean-square error without and with the effects.

    Attributes:
        before: error of the simulation as it is.
        after: error with the effects.
        floor: error of sensors and estimator, the least of any simulation.
    """

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class Rollouts:
    """Errors of open-loop roll-outs at their horizon.

    Attributes:
        horizon_s: duration of each.
        starts: number of roll-outs.
        errors: errors by quantity, with its unit in the name; none where every roll-out was lost.
        lost: number of roll-outs that diverged, `before`, `after` and with the measured wrench, `floor`;
            they are left out of the errors.
    """

    horizon_s: float
    starts: int
    errors: Mapping[str, BeforeAfter]
    lost: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class ClosedLoops:
    """References of flights flown again by the simulation, against the measured flights.

    Attributes:
        flights: number of flights that were flown again.
        missing: reason why none could be; empty where some could.
        lost: reason for each flight that got out of control.
        errors: errors by quantity, with its unit in the name.
        reduction: share of the removable error that the effects remove; None without flights.
    """

    flights: int
    missing: str = ""
    lost: tuple[str, ...] = ()
    errors: Mapping[str, BeforeAfter] = field(default_factory=dict)
    reduction: float | None = None


@dataclass(frozen=True)
class Coverage:
    """Share of samples inside the intervals of a model, without and with the effects in its predictions."""

    before: float
    after: float


@dataclass(frozen=True)
class Reflights:
    """The gap in flight.

    Attributes:
        rollout: open loop.
        closed_loop: with a controller.
        coverage: coverage of a model's intervals by axis; empty for any other simulation.
    """

    rollout: Rollouts
    closed_loop: ClosedLoops
    coverage: Mapping[str, Coverage]


@dataclass(frozen=True)
class Study:
    """A simulation beside flights.

    Attributes:
        simulation: compared simulation.
        flights: flights, in the air.
        discovery: effects that it lacks.
        where: conditions and times in which they show.
        not_flown: manoeuvres that no flight contains.
        seed: seed of all draws.
        flown_again: gap in roll-outs and closed loop; None where no effect was named.
    """

    __repr__ = brief_repr

    simulation: Simulation
    flights: tuple[Flight, ...]
    discovery: Discovery
    where: Where
    not_flown: tuple[str, ...]
    seed: int
    flown_again: Reflights | None

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
        **(reflights_json(study.flown_again) if study.flown_again else {}),
        "not_flown": list(study.not_flown),
    }


def discovery_json(discovery: Discovery) -> dict[str, Any]:
    """What is missing, as JSON holds it."""
    gap = discovery.gap
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
        "gap": {
            **{
                axis: {"before": float(before), "after": float(after), "floor": float(floor)}
                for axis, before, after, floor in zip(AXES, gap.before, gap.after, gap.floor, strict=True)
            },
            "reduction": gap.reduction,
        },
        "intervals": _intervals_json(discovery.inside),
        "conditions": [
            {
                "effect": own.effect,
                "parameter": own.parameter,
                "unit": own.unit,
                "cause": own.cause,
                "flights": {name: value._asdict() for name, value in own.by_flight.items()},
            }
            for own in discovery.conditions
        ],
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


def _intervals_json(inside: Inside | None) -> dict[str, Any] | None:
    """What the intervals of the simulation hold by axis; None without intervals."""
    if inside is None:
        return None
    each = zip(AXES, inside.shares.mean(axis=0).tolist(), inside.held.tolist(), strict=True)
    return {axis: {"inside": share, "stated": inside.confidence, "held": held} for axis, share, held in each}


def reflights_json(flown: Reflights) -> dict[str, Any]:
    """The gap in flight, as JSON holds it."""
    rollout, loop = flown.rollout, flown.closed_loop
    coverage = {axis: asdict(own) for axis, own in flown.coverage.items()}
    closed: dict[str, Any] = {"flights": loop.flights}
    if loop.missing:
        closed["missing"] = loop.missing
    else:
        closed["lost"] = list(loop.lost)
        closed |= {name: asdict(error) for name, error in loop.errors.items()}
    if loop.reduction is not None:
        closed["reduction"] = loop.reduction
    return {
        "rollout": {
            "horizon_s": rollout.horizon_s,
            "starts": rollout.starts,
            **({"lost": dict(rollout.lost)} if any(rollout.lost.values()) else {}),
            **{name: asdict(error) for name, error in rollout.errors.items()},
        },
        "closed_loop": closed,
        **({"coverage": coverage} if coverage else {}),
    }
