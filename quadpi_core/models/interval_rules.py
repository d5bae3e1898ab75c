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

from quadpi_core.config_schema import (
    NotEmpty,
    NotNegative,
    Numbers,
    OneOf,
    Positive,
    ReadBy,
    Real,
    Within,
    parse_config,
)
from quadpi_core.core import exponential
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.signals.chain import interpolate_columns

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
        """The support that a number of flights left out gives."""
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
        return np.quantile(self.scores()[self.inside], LEVELS, method="higher")

    def scores(self) -> Array:
        """Smallest factor (N,) that covers each error: |error| / spread."""
        return np.abs(self.error) / self.spread


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
    return np.all(inside_interval(inputs, of.min(axis=0), of.max(axis=0)), axis=1)


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


# Errors of a model last: a flight has a constant of its own, and an effect that the model lacks acts for a
# while. The centre moves by a regression of the error on running means of those before it,
#
#     m_k ← m_k + (1 − exp(−1/(τ_k f))) (e − m_k),      centre = model + Σ_k b_k m_k,
#
# with f the sample rate. Means of short and of long memories together foresee a slope. As the memories τ are
# times, the coefficients b hold at any rate. They are learned from errors on flights left out, as the live
# path would make them. Among rivals of the literature: experiments/results/intervals-raced.md.

# Memories [s] of the running means: from less than the delay of the low-pass to most of a short flight.
MEMORIES_S = (0.004, 0.01, 0.02, 0.04, 0.1, 0.3, 1.0, 5.0)
# Shortest memory, in samples, of a mean that is learned: a shorter one is the last error, as the next is.
_SHORTEST = 0.4
# An error counts once it is as old as this: the low-pass, which all signals pass, delays by as much.
DELAY_S = 0.014
# Ridge of the regression, in variances of each mean: they are much alike.
_RIDGE = 1e-3
# Shares of the regression's coefficients that are tried.
_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class MovedAxis:
    """How the interval of an axis moves.

    Attributes:
        coefficients: (8,) of the running means.
        narrower: half width that covers as often about the centre that moves, over the model's own.
    """

    coefficients: Annotated[Array, Numbers(len(MEMORIES_S))]
    narrower: Positive


@dataclass(frozen=True)
class MovingCentre:
    """How the intervals of a model move, by axis."""

    axes: Annotated[dict[Annotated[str, OneOf(*AXES)], MovedAxis], NotEmpty()]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers for the model file; :meth:`from_json` reads them."""
        return {
            "axes": {
                axis: {"coefficients": own.coefficients.tolist(), "narrower": own.narrower}
                for axis, own in self.axes.items()
            }
        }

    @classmethod
    def from_json(cls, data: Any) -> MovingCentre:
        """What :meth:`to_json` gave.

        Raises:
            ModelError: naming the key that is missing, or whose numbers no flights give.
        """
        return parse_config(cls, data, "moving centre", ModelError)


def shares(rate_hz: float) -> Array:
    """Share (8,) of a new error in each running mean."""
    return 1.0 - exponential(-1.0 / (np.array(MEMORIES_S) * rate_hz))


def usable(rate_hz: float) -> npt.NDArray[np.bool_]:
    """Which running means (8,) errors at a rate can teach."""
    return np.array(MEMORIES_S) * rate_hz >= _SHORTEST


def delay(rate_hz: float) -> int:
    """Samples after which an error is known; of a rate that is none, one."""
    return max(int(np.ceil(DELAY_S * rate_hz - 0.1)), 1)


def delayed(errors: Array, samples: int) -> Array:
    """The errors (T, ...) that have become known at each sample, zero before the first and for NaN."""
    known = np.zeros_like(errors)
    known[samples:] = np.nan_to_num(errors[:-samples])
    return known


def means_of(errors: Array, rate_hz: float) -> Array:
    """Running means (T, ..., 8) of errors (T, ...), each with the error of its sample."""
    # Slow to import, and no model in flight needs it.
    from scipy.signal import lfilter

    return np.stack(
        [lfilter([share], [1.0, share - 1.0], errors, axis=0) for share in shares(rate_hz)], axis=-1
    )


def regressed(flights: Sequence[tuple[Array, Array]]) -> tuple[Array, list[Array]]:
    """Coefficients (8,) of running means, by least squares in which each flight counts the same.

    They are shrunk to the share that is best for each flight by the others: where errors do not repeat
    themselves from flight to flight, the centre stays.

    Args:
        flights: errors (N,) of an axis, and the means (N, 8) that were known at each.

    Returns:
        The coefficients, and by how much those of the others move the centre (N,) of each flight.
    """
    squares = [means.T @ means / len(means) for _, means in flights]
    products = [means.T @ error / len(means) for error, means in flights]
    square, product = (np.sum(each, axis=0) for each in (squares, products))
    moved = [
        means @ _solved(square - own, product - mine)
        for (_, means), own, mine in zip(flights, squares, products, strict=True)
    ]
    # Sums of |error| over those about a centre that stays, which all flights have alike.
    costs = [
        sum(
            float(np.sum(np.abs(error - share * by)) / max(np.sum(np.abs(error)), np.finfo(float).tiny))
            for (error, _), by in zip(flights, moved, strict=True)
        )
        for share in _SHARES
    ]
    share = _SHARES[int(np.argmin(costs))] if len(flights) > 1 else 0.0
    return share * _solved(square, product), [share * by for by in moved]


def _solved(square: Array, product: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(square), 0.0))
    # Of errors that are all zero.
    scale[scale == 0.0] = 1.0
    penalised = square / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    return np.linalg.solve(penalised, product / scale) / scale


# A model's intervals hold what both did to them.

# What motion capture never exceeds once a filter has settled: see buffer.hpp for the velocity; a pose errs by
# half of this angle.
_VELOCITY_M_S, _ATTITUDE_RAD = 0.05, 0.02


@dataclass(frozen=True, kw_only=True)
class StateDeviation:
    """Standard deviations of the states that a monitor had, root mean squares over the axes.

    Attributes:
        velocity_m_s: of the velocity.
        attitude_rad: of the attitude.
    """

    velocity_m_s: Annotated[float, Within(0.0)] = _VELOCITY_M_S
    attitude_rad: Annotated[float, Within(0.0)] = _ATTITUDE_RAD

    @classmethod
    def of_flights(cls, flights: Sequence[tuple[float, float]]) -> StateDeviation:
        """Of a model of flights whose median deviations, m/s and rad, these are."""
        velocity, attitude = np.median(np.array(flights), axis=0).tolist()
        return cls(velocity_m_s=max(velocity, _VELOCITY_M_S), attitude_rad=max(attitude, _ATTITUDE_RAD))


# Of motion capture, and of models of earlier versions.
SETTLED = StateDeviation()


@dataclass(frozen=True, kw_only=True)
class WindDrag:
    """Linear drag along body x and y, which tells the wind of a flight where nothing measures it.

    Attributes:
        per_mass_x_1_s, per_mass_y_1_s: drag over mass and airspeed.
        noise_x_m_s2, noise_y_m_s2: deviation of a fifth of a second's specific force from it, in which errors
            that hang together count as often as they are independent.
        wind_m_s: standard deviation of the wind to north and east before a flight.
        known_m_s: that a monitor knew it by in the model's flights, whose intervals hold what that does.
    """

    per_mass_x_1_s: Annotated[float, Within(0.0)]
    per_mass_y_1_s: Annotated[float, Within(0.0)]
    noise_x_m_s2: Positive
    noise_y_m_s2: Positive
    wind_m_s: Annotated[float, Within(0.0)]
    known_m_s: Annotated[float, Within(0.0)] = 0.0
