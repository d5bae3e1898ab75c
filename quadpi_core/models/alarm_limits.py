# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the sequential test and of the flying gate of the alarm, and the flights they come from."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Annotated, Any, TypeAlias

import numpy as np

from quadpi_core.config_schema import (
    Each,
    NotEmpty,
    NotNegative,
    OneOf,
    Positive,
    Real,
    Share,
    Within,
    parse_config,
)
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.records import CONVENTION, Threshold

# False alarms per flight hour that limits are calibrated to by default.
RATE_PER_HOUR = 1.0
# Fewest flights, each left out in turn, from which a rate of false alarms can be stated: of models of four
# flights, an unlucky one raised hundreds of false alarms an hour, none of twelve did.
FEWEST_FLIGHTS = 8
CARRIED = Threshold(
    "how far below the rate that their hours bound without an alarm flights carry a stated rate",
    25.0,
    "",
    "models of eight flights of a minute kept one per hour, 23 below; one 150 below was not kept",
    "16 models of simulated flights, 16.8 h of others (experiments/results/alarm.md, rates)",
)
# Ratio of the share of misses that the sequential test is to detect to the allowed share.
ALTERNATIVE = 5.0
BOUND_CONFIDENCE = Threshold(
    "confidence of the bound of a rate",
    0.95,
    "",
    "of a bound that a person reads; without an alarm it is 3.0 over the time",
    CONVENTION,
)
# Limit [s] of the sequential test where no flights could calibrate it.
UNCALIBRATED_S = 2.0


def allowance(confidence: float) -> float:
    """Share k of misses at which the sequential test neither rises nor falls.

    It is the reference value of a cumulative sum of Bernoulli trials (Page 1954; Reynolds and Stoumbos 1999)
    between p₀ = 1 − confidence and an alternative p₁ = min(:data:`ALTERNATIVE` · p₀, (1 + p₀) / 2):

        k = ln((1−p₀)/(1−p₁)) / ln(p₁(1−p₀)/(p₀(1−p₁)))
    """
    low = 1.0 - confidence
    high = min(ALTERNATIVE * low, 0.5 * (1.0 + low))
    fall = np.log((1.0 - low) / (1.0 - high))
    return float(fall / (fall + np.log(high / low)))


def bound_per_hour(hours: float) -> float:
    """Bound of the rate of alarms that hours show without a single one (Poisson)."""
    return float(-np.log1p(-BOUND_CONFIDENCE.value)) / hours


def least_carried(hours: float) -> float:
    """Least rate per hour that can be stated of flights of so many hours, see :data:`CARRIED`."""
    return bound_per_hour(hours) / CARRIED.value


@dataclass(frozen=True)
class AlarmLimits:
    """Limits of an alarm, and what they were calibrated on.

    Attributes:
        allowance: share of misses that the sequential test subtracts, see :func:`allowance`.
        miscoverage_s: (6,) limits of the cumulative sum in seconds of misses beyond it, order as `AXES`.
        hover_rotor_speed: mean speed of the rotors, rad/s, whose thrust carries the vehicle; 0 where
            unknown, and then the vehicle always counts as flying.
        rate_per_hour: of false alarms, both causes together, that the limits were calibrated to: that asked
            for, or the least that the flights carry.
        flights: held out that they were calibrated on; 0 says that the limits are plain fractions.
        hours: that these flights lasted.
        estimate_per_hour: of false alarms, by the form of the tails, and both ends of its interval.
    """

    allowance: float = field(default_factory=lambda: allowance(0.95))
    miscoverage_s: Array = field(default_factory=lambda: np.full(len(AXES), UNCALIBRATED_S))
    hover_rotor_speed: float = 0.0
    rate_per_hour: float = RATE_PER_HOUR
    flights: int = 0
    hours: float = 0.0
    estimate_per_hour: tuple[float, float, float] | None = None

    @property
    def calibrated(self) -> bool:
        """Whether a rate of false alarms can be stated."""
        return self.flights > 0

    @property
    def rate_bound_per_hour(self) -> float | None:
        """Bound of the rate that the hours would show without a single alarm (Poisson); None without any."""
        return bound_per_hour(self.hours) if self.hours > 0.0 else None

    @property
    def rate_extrapolated(self) -> bool:
        """Whether the rate is below what the hours could show, and follows from the form of the tails."""
        bound = self.rate_bound_per_hour
        return bound is not None and bound > self.rate_per_hour

    def sentence(self) -> str:
        """A sentence that says what the limits were calibrated on."""
        bound = self.rate_bound_per_hour
        if not self.calibrated or bound is None:
            return (
                "alarm uncalibrated: its limits are plain fractions beyond training, no rate is claimed; "
                f"that takes {FEWEST_FLIGHTS} flights within each other's ranges"
            )
        time, sure = f"{60.0 * self.hours:.3g} min", f"{100.0 * BOUND_CONFIDENCE.value:g} %"
        estimated = ""
        if math.isclose(self.rate_per_hour, least_carried(self.hours)):
            estimated = ", the least that they carry"
        if self.estimate_per_hour is not None:
            rate, low, high = (f"{value:.2g}" for value in self.estimate_per_hour)
            estimated += f"; estimated: {rate} per hour, {low} to {high} ({sure})"
        shown = f"{time} without an alarm bound it at {bound:.3g} per hour ({sure})"
        rate = f"within what they show: {shown}"
        if self.rate_extrapolated:
            more = self.hours * (bound / self.rate_per_hour - 1.0)
            rate = f"extrapolated: {shown} only, {more:.2g} h more would bound it at that"
        return (
            f"alarm calibrated to {self.rate_per_hour:.3g} false alarms per flight hour on "
            f"{self.flights} flights, each left out in turn ({time}){estimated}; the rate is {rate}"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain numbers for the model file; :meth:`from_json` reads them."""
        return vars(self) | {"miscoverage_s": dict(zip(AXES, self.miscoverage_s.tolist(), strict=True))}

    @classmethod
    def from_json(cls, data: Any) -> AlarmLimits:
        """Limits from what :meth:`to_json` gave.

        Raises:
            ModelError: naming the key that is missing, or whose number no calibration gives.
        """
        stored = parse_config(_Stored, data, "alarm", ModelError)
        misses = np.array([stored.miscoverage_s[axis] for axis in AXES])
        return cls(**vars(stored) | {"miscoverage_s": misses})


@dataclass(frozen=True)
class _Stored:
    """The key `alarm` of a stored model."""

    allowance: Annotated[float, Within(highest=1.0, positive=True)]
    miscoverage_s: Annotated[dict[str, Positive], Each(AXES)]
    hover_rotor_speed: NotNegative
    rate_per_hour: Positive
    flights: Annotated[int, Within(0)]
    hours: NotNegative
    estimate_per_hour: tuple[NotNegative, NotNegative, NotNegative] | None = None


FALSE_FLIGHTS = Threshold(
    "share of sound flights that raise the alarm for a change",
    0.05,
    "",
    "of a flight of any length (Ville's inequality), as the evidence must grow to one over it",
    CONVENTION,
)
# Axes whose residuals are evidence. Mz is not one: what a rotor that weakens does to its torque is not known.
CHANGE_AXES = ("Fx", "Fy", "Fz", "Mx", "My")


@dataclass(frozen=True)
class LeftOnAxis:
    """Statistics of a model's residuals on one axis over sound flights, in N or Nm, by blocks of 0.1 s.

    Attributes:
        mean: of the constants of the flights.
        between: variance of the constant of one more flight.
        walk: variance by which that constant walks in a block.
        keep: share of the process that a block leaves.
        process: variance of the process.
        white: variance of the noise of a block's mean.
        scale: of Student's distribution with 3 degrees of freedom of what the filter cannot foresee, in units
            of its own standard deviation and by how loud it was in the 4 s before.
        loudest: largest mean square of what it cannot foresee in 4 s of any flight.
    """

    mean: Real
    between: NotNegative
    walk: NotNegative
    keep: Share
    process: NotNegative
    white: Positive
    scale: Positive
    loudest: Positive


# Number of block-to-block changes of the inputs that the residual of a block is regressed on.
INPUT_CHANGES = 2
_OfInputs: TypeAlias = Annotated[dict[str, Real], Each(INPUT_NAMES)]


@dataclass(frozen=True)
class RepeatingPart:
    """The residual that repeats in every flight: linear in the changes of the inputs between blocks of 0.1 s.

    With constant inputs it is zero, so it cannot hide a lasting change of the vehicle.

    Attributes:
        lower, upper: by input, its largest fall and rise in the flights; changes beyond count as these.
        slopes: by axis, by input, N or Nm per unit of its last two changes, the latest first.
    """

    lower: _OfInputs
    upper: _OfInputs
    slopes: dict[
        Annotated[str, OneOf(*CHANGE_AXES)],
        Annotated[dict[str, tuple[Real, Real]], Each(INPUT_NAMES)],
    ]

    def of_axis(self, axis: str) -> Array:
        """The slopes (INPUT_CHANGES, 19) of an axis."""
        return np.array([self.slopes[axis][name] for name in INPUT_NAMES]).T


@dataclass(frozen=True)
class ChangeLimits:
    """Statistics of sound flights, each under the model identified without it, for the alarm of change.

    Attributes:
        axes: by axis of CHANGE_AXES, those that the model holds.
        levers: for each rotor, by what the model has Fz, Mx and My change per newton that it gives less.
        flights: number of flights.
        hours: that they lasted.
        largest: evidence that one of them gathered at most, with the limits of the others.
        repeating: what is taken from residuals before they count; None for nothing.
    """

    axes: Annotated[dict[Annotated[str, OneOf(*CHANGE_AXES)], LeftOnAxis], NotEmpty()]
    levers: tuple[tuple[Real, Real, Real], ...]
    flights: Annotated[int, Within(FEWEST_FLIGHTS)]
    hours: Positive
    largest: NotNegative
    repeating: RepeatingPart | None = None

    @property
    def evidence(self) -> float:
        """Evidence at which the alarm is raised: at least the most that any sound flight gathered."""
        return max(1.0 / FALSE_FLIGHTS.value, self.largest)

    def sentence(self) -> str:
        """A sentence that tells what is proven from what is estimated."""
        count, sure = self.flights, BOUND_CONFIDENCE.value
        bound = 1.0 - (1.0 - sure) ** (1.0 / count)
        more = math.ceil(math.log(1.0 - sure) / math.log(1.0 - FALSE_FLIGHTS.value)) - count
        share, load = (f"{100.0 * of:g} %" for of in (FALSE_FLIGHTS.value, 1.0 / compiled.LOAD_EVIDENCE))
        estimated = f"estimated {share} of sound flights raise it at most, {load} more as a load"
        if self.largest > 1.0 / FALSE_FLIGHTS.value:
            estimated = (
                "no share is estimated, as a sound flight left out gathered evidence of "
                f"{self.largest:.2g} to 1, which is the limit"
            )
        asks = f"; {more} sound flights more could bound it at {share}" if more > 0 else ""
        return (
            f"change of the vehicle: {estimated}; loads apart, {count} flights, none of which does, bound it "
            f"at 1 flight in {count + 1} on average, or {100.0 * bound:.2g} % ({100.0 * sure:g} %){asks}"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain numbers for the model file; :meth:`from_json` reads them."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Any) -> ChangeLimits:
        """Limits from what :meth:`to_json` gave.

        Raises:
            ModelError: naming the key that is missing, or whose number no flights give.
        """
        return parse_config(cls, data, "change", ModelError)


def change_sentence(limits: ChangeLimits | None) -> str:
    """Sentence of `identify` and `info`: how a change of the vehicle is judged, or why it is not."""
    if limits is not None:
        return limits.sentence()
    return (
        "change of the vehicle not judged by the size of residuals: that takes "
        f"{FEWEST_FLIGHTS} flights within each other's ranges, and the axis Fz"
    )
