# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How wide an interval must be: rules that turn a confidence into a factor on a method's own spread.

Every method gives a centre and a spread at each input; the interval is centre ± factor(confidence) · spread.
The spread of a polynomial is √(1 + κ h + γ V²) with its leverage h and the airspeed V, that of a bootstrap
ensemble the standard deviation of model and noise, that of a quality-driven ensemble half the distance of its
bounds. :class:`HeldOutRule` is the default for all of them; the others are the textbook rules that the paper
uses.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import NotNegative, Numbers, Positive, ReadBy, Real, Within, parse_config
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.signals.resample import interpolate_columns

# Share of new flights whose coverage should reach the nominal one.
FLIGHT_SHARE = 0.9
# Least share of a flight inside the envelope of the others for its held-out errors to count: the corner of a
# flight that the others happen to touch is no sample of flying inside the envelope.
FEWEST_INSIDE = 0.5
# Quantile of a quantity over a flight that counts as its peak: single spikes do not.
PEAK_QUANTILE = 0.999
# Confidence levels at which the held-out flights' quantiles are stored: np.arange(0.50, 0.99, 0.01), then
# np.arange(0.99, 0.9991, 0.001), as they are where a product is rounded before it is added.
LEVELS: Array = np.concatenate(
    [
        start + ((start + step) - start) * np.arange(n)
        for start, step, n in ((0.50, 0.01, 49), (0.99, 0.001, 10))
    ]
)


class Rule(ABC):
    """Base of the rules, each a frozen dataclass of plain numbers and arrays."""

    kind: ClassVar[str]

    @abstractmethod
    def factor(self, confidence: float) -> float:
        """Half width of the interval per spread.

        Raises:
            ModelError: for a confidence that the rule cannot support.
        """

    def to_json(self) -> dict[str, Any]:
        """Plain numbers, as stored with a model."""
        parameters = vars(self).items()
        return {"kind": self.kind, **{name: np.asarray(value).tolist() for name, value in parameters}}


@dataclass(frozen=True)
class ResidualRule(Rule):
    """Noise of the training residuals, taken as independent (van Beers and de Visser, Eq. 13, 16, 17)."""

    kind: ClassVar[str] = "residual"
    std: NotNegative
    freedom: Positive

    def factor(self, confidence: float) -> float:
        """Standard deviation times the quantile of Student's distribution."""
        _check_confidence(confidence, 0.0, 1.0)
        from scipy.special import stdtrit

        return self.std * float(stdtrit(self.freedom, 0.5 + confidence / 2.0))


@dataclass(frozen=True)
class NormalRule(Rule):
    """Errors are normal with the spread as standard deviation (van Beers and de Visser, Eq. 20)."""

    kind: ClassVar[str] = "normal"

    def factor(self, confidence: float) -> float:
        """Quantile of the standard normal distribution."""
        _check_confidence(confidence, 0.0, 1.0)
        from scipy.special import ndtri

        return float(ndtri(0.5 + confidence / 2.0))


@dataclass(frozen=True)
class TrainedRule(Rule):
    """Bounds that were trained for one confidence and hold for no other."""

    kind: ClassVar[str] = "trained"
    confidence: Real

    def factor(self, confidence: float) -> float:
        """One, at the confidence of training."""
        _check_confidence(confidence, 0.0, 1.0)
        if abs(confidence - self.confidence) > 1e-9:
            raise ModelError(
                f"these bounds were trained for a confidence of {self.confidence:g}, not {confidence:g}; "
                f"identify again for another"
            )
        return 1.0


@dataclass(frozen=True)
class HeldOutRule(Rule):
    """Calibration on flights that the model never saw, each left out in turn.

    Errors of flight data are autocorrelated, so neither their training variance nor N − p degrees of
    freedom say how wide an honest interval is. The exchangeable unit is the flight: per flight, the quantile
    of |error| / spread is an interval factor that would have covered that flight. Of the F flights' factors
    the ⌈0.9 (F + 1)⌉-th smallest is used, or the largest while F is too small for that rank (split conformal
    prediction by group).

    Only errors inside the envelope of the other flights, where every input lies in their range, count for
    the factor, and only of flights that lie mostly inside. Outside, the interval widens by its spread,
    and the alarm warns that it may not hold. A flight's factor also covers its errors in the
    final fit, whose spread is smaller than that of the model without the flight.

    Attributes:
        flight_factors: (F, len(LEVELS)), each flight's own, at the confidence :data:`LEVELS`.
        flights_inside: number of flights that lie mostly inside the envelope of the others; only their
            held-out errors count. With 0 the factors come from training residuals alone.
    """

    kind: ClassVar[str] = "held-out"
    flight_factors: Annotated[Array, Numbers(len(LEVELS), rows=True)]
    flights_inside: Annotated[int, Within(0)]

    def factor(self, confidence: float) -> float:
        """The factor that covers FLIGHT_SHARE of the flights; all of them while they are few."""
        require_confidence(confidence, calibrated=True)
        return _ranked_factor(self.flight_factors, confidence)

    def held_out_coverage(self, held_out: Sequence[FlightErrors], confidence: float) -> Array:
        """Coverage (F,) of each flight by the model and the factors of the others.

        All samples count, those outside the envelope of the others too.
        """
        return np.array([1.0 - np.mean(missed) for missed in self.held_out_misses(held_out, confidence)])

    def held_out_misses(
        self, held_out: Sequence[FlightErrors], confidence: float
    ) -> list[npt.NDArray[np.bool_]]:
        """Whether each error (N,) of a flight lies outside the interval that the others give."""
        factors = [
            _ranked_factor(np.delete(self.flight_factors, k, axis=0), confidence)
            for k in range(len(held_out))
        ]
        return [flight.scores() > factor for flight, factor in zip(held_out, factors, strict=True)]

    def covering(self, held_out: Sequence[FlightErrors]) -> HeldOutRule:
        """The rule whose factors cover these held-out errors of the same flights as well."""
        factors = self.flight_factors.copy()
        for k, flight in enumerate(held_out):
            if flight.usual:
                factors[k] = np.maximum(factors[k], flight.factors())
        return HeldOutRule(factors, self.flights_inside)


@dataclass(frozen=True)
class LevelSupport:
    """What a confidence means that was calibrated on flights, each of which counts once.

    Attributes:
        confidence: nominal coverage.
        flights: left out in turn that calibrated the intervals.
        level: n / (n + 1), the chance that the next flight errs by no more than the worst of n (split
            conformal prediction).
        flight_share: of flights to come that the rule is to hold, its rank over n + 1.
    """

    confidence: float
    flights: int
    level: float
    flight_share: float

    @classmethod
    def from_flights(cls, confidence: float, flights: int) -> LevelSupport:
        """What flights left out support."""
        return cls(confidence, flights, flights / (flights + 1), conformal_rank(flights) / (flights + 1))

    @property
    def is_supported(self) -> bool:
        """Whether as many flights could show the confidence at all."""
        return self.confidence <= self.level

    def sentence(self) -> str:
        """In one line."""
        asked, level, share = (
            f"{100.0 * of:.4g} %" for of in (self.confidence, self.level, self.flight_share)
        )
        if self.flights == 0:
            return f"no flight left out calibrated the intervals: they support no level, {asked} is nominal"
        but = "" if self.is_supported else f", not {asked}"
        several = f"{self.flights} flights, each counted once, support"
        flights = "1 flight supports" if self.flights == 1 else several
        return (
            f"{flights} a level of {level} (n / (n + 1)){but}: "
            f"about {share} of flights to come reach {asked} of their samples"
        )


_RULES: dict[str, type[Rule]] = {
    rule.kind: rule for rule in (ResidualRule, NormalRule, TrainedRule, HeldOutRule)
}


def rule_from_json(data: Any) -> Rule:
    """Read what `to_json` gave.

    Raises:
        ModelError: for an unknown kind, or numbers that no fit gives.
    """
    kind = data.get("kind") if isinstance(data, dict) else None
    if kind not in _RULES:
        raise ModelError(f"unknown kind of interval rule {kind!r}")
    return parse_config(_RULES[kind], data, f"{kind} rule", ModelError)


# Key of a fitted axis in a stored model.
StoredRule: TypeAlias = Annotated[Rule, ReadBy(rule_from_json)]


@dataclass(frozen=True)
class FlightErrors:
    """Errors of a model on one flight.

    Attributes:
        error: (N,) measured − centre of the interval.
        spread: (N,) of that model, positive.
        inside: (N,) whether every input lies in the range of the samples that the model was fitted to.
        width: (N,) spread over its peak on the flights of the fit; None where not known.
        leverage: (N,) leverage over its peak on the flights of the fit; None where not known.
    """

    error: Array
    spread: Array
    inside: npt.NDArray[np.bool_]
    width: Array | None = None
    leverage: Array | None = None

    @property
    def usual(self) -> bool:
        """Whether the flight lies mostly inside the envelope of the others."""
        return len(self.inside) > 0 and float(np.mean(self.inside)) >= FEWEST_INSIDE

    def factors(self) -> Array:
        """Factors (len(LEVELS),) that would have covered the errors inside the envelope, by confidence."""
        factors: Array = np.quantile(self.scores()[self.inside], LEVELS, method="higher")
        return factors

    def scores(self) -> Array:
        """Smallest factor (N,) that covers each error: |error| / spread."""
        scores: Array = np.abs(self.error) / self.spread
        return scores


def calibrate(held_out: Sequence[FlightErrors], trained: Sequence[FlightErrors]) -> HeldOutRule:
    """Calibrate a rule on the errors of each flight, under the model without it and under the final one.

    Args:
        held_out: per flight, under the model fitted without it.
        trained: per flight, under the final model.
    """
    factors = [flight.factors() for flight in trained]
    inside = [k for k, flight in enumerate(held_out) if flight.usual]
    for k in inside:
        factors[k] = np.maximum(factors[k], held_out[k].factors())
    return HeldOutRule(np.stack(factors), len(inside))


def inside_interval(values: Any, lower: Any, upper: Any) -> Any:
    """Whether values lie in the closed intervals [lower, upper]: arrays or, in kernels, single numbers."""
    return (lower <= values) & (values <= upper)


def inside_range(inputs: Array, of: Array) -> npt.NDArray[np.bool_]:
    """Which samples (N,) of inputs (N, D) lie in the range of others (M, D) in every input."""
    inside: npt.NDArray[np.bool_] = np.all(inside_interval(inputs, of.min(axis=0), of.max(axis=0)), axis=1)
    return inside


def flights_peak(values: Iterable[Array]) -> float:
    """Largest over the flights of the 99.9 % quantile of their values (N,)."""
    return max(float(np.quantile(flight, PEAK_QUANTILE)) for flight in values)


def conformal_rank(flights: int) -> int:
    """Rank of the flights' factor that is used, 1 for the smallest: ⌈0.9 (F + 1)⌉, at most F."""
    return min(int(np.ceil(FLIGHT_SHARE * (flights + 1))), flights)


def _ranked_factor(flight_factors: Array, confidence: float) -> float:
    factors = np.sort(interpolate_columns(LEVELS, flight_factors.T, np.array([confidence]))[0])
    return float(factors[conformal_rank(len(factors)) - 1])


def require_confidence(confidence: float, *, calibrated: bool) -> None:
    """Refuse a confidence for which no intervals can be identified.

    Raises:
        ModelError: naming the range, which is narrower where intervals are calibrated on flights.
    """
    _check_confidence(confidence, *((float(LEVELS[0]), float(LEVELS[-1])) if calibrated else (0.0, 1.0)))


def _check_confidence(confidence: float, lowest: float, highest: float) -> None:
    if not 0.0 < confidence < 1.0:
        raise ModelError(f"confidence {confidence} is not between 0 and 1")
    if not lowest <= confidence <= highest:
        raise ModelError(
            f"confidence {confidence} is outside {lowest:g} to {highest:g}, which can be calibrated"
        )
