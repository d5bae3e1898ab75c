# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The training envelope: the range of inputs, leverage and interval width of the training flights.

For each input it is the range that the flights covered, for each axis the largest leverage and relative
interval width that they reached. The range of a flight runs between its 0.1 % and 99.9 % quantiles, so that
one spike does not widen it; the envelope spans the ranges of all flights. Flights that repeat a
trajectory still differ a little at its extremes, so the alarm allows a margin beyond the range and a
headroom above the peaks. Here both are fixed fractions, without a stated rate of false alarms. Where there
are enough flights, `alarm_calibration` replaces them by limits with a stated rate; the fixed ones then remain
as limits of the warning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Each, NotNegative, Positive, Real, parse_config
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, VELOCITY_INPUTS
from quadpi_core.models.interval_rules import FlightErrors, flights_peak

# Quantile of an input over a flight at either end of its range.
RANGE_QUANTILE = 0.001
# Fixed limits of the warning: distance outside the range, in its width; leverage and width over their peaks.
MARGIN = 0.1
LEVERAGE_HEADROOM = 2.0
WIDTH_HEADROOM = 1.25
# Relative width of a range below which the input was constant.
_CONSTANT = 1e-9


@dataclass(frozen=True)
class Envelope:
    """Limits beyond which the training flights say nothing.

    Attributes:
        lower, upper: (19,) range of each input over the training flights, columns as `INPUT_NAMES`.
        margin: (19,) how far outside its range an input may be before it counts as evidence, in
            :attr:`scale`.
        leverage_peak, width_peak: (6,) leverage and relative width that the training flights reached,
            order as `AXES`; 0 for axes that the model does not hold, or without such a signal.
        leverage_limit, width_limit: (6,) those above which an axis counts as evidence; 1 where the peak
            is 0.
    """

    lower: Array
    upper: Array
    margin: Array
    leverage_peak: Array
    width_peak: Array
    leverage_limit: Array
    width_limit: Array

    @classmethod
    def fit(
        cls,
        inputs: Array,
        groups: npt.ArrayLike,
        leverage: Array,
        relative_width: Array,
    ) -> Envelope:
        """Envelope of the training samples.

        Args:
            inputs: (N, 19) input vectors.
            groups: (N,) label of the flight that each sample belongs to.
            leverage: (N, 6) leverage of each sample, zero columns for axes not held.
            relative_width: (N, 6) interval width over its root mean square in training, likewise.

        Raises:
            ModelError: for no samples, shapes that do not fit or values that are not finite.
        """
        labels = np.asarray(groups)
        samples = len(labels)
        for name, values, columns in (
            ("inputs", inputs, len(INPUT_NAMES)),
            ("leverage", leverage, len(AXES)),
            ("relative width", relative_width, len(AXES)),
        ):
            if values.shape != (samples, columns) or samples == 0:
                raise ModelError(f"envelope: {name} {values.shape} for {samples} flight labels")
            if not np.all(np.isfinite(values)):
                sample = int(np.argmin(np.isfinite(values).all(axis=1)))
                raise ModelError(f"envelope: {name} of sample {sample} is not finite")

        flights = [labels == label for label in np.unique(labels)]
        ranges = np.array([cls.flight_range(inputs[flight]) for flight in flights])
        high = 1.0 - RANGE_QUANTILE

        def peak(values: Array) -> Array:
            return np.max([np.quantile(values[flight], high, axis=0) for flight in flights], axis=0)

        leverage_peak, width_peak = peak(leverage), peak(relative_width)
        return cls(
            lower=ranges[:, 0].min(axis=0),
            upper=ranges[:, 1].max(axis=0),
            margin=np.full(len(INPUT_NAMES), MARGIN),
            leverage_peak=leverage_peak,
            width_peak=width_peak,
            leverage_limit=cls.of_peak(leverage_peak, LEVERAGE_HEADROOM),
            width_limit=cls.of_peak(width_peak, WIDTH_HEADROOM),
        )

    @staticmethod
    def of_peak(peak: Array, headroom: float) -> Array:
        """Limits (6,): peaks (6,) times a headroom; 1 where the peak is 0."""
        return np.where(peak > 0.0, headroom * peak, 1.0)

    @cached_property
    def near(self) -> Envelope:
        """The envelope with the limits of the warning: the tighter of fixed and calibrated ones."""
        return replace(
            self,
            margin=np.minimum(self.margin, MARGIN),
            leverage_limit=np.minimum(
                self.leverage_limit, self.of_peak(self.leverage_peak, LEVERAGE_HEADROOM)
            ),
            width_limit=np.minimum(self.width_limit, self.of_peak(self.width_peak, WIDTH_HEADROOM)),
        )

    @staticmethod
    def flight_range(inputs: Array) -> tuple[Array, Array]:
        """Range (19,), (19,) of each input over one flight (N, 19)."""
        lower, upper = np.quantile(inputs, (RANGE_QUANTILE, 1.0 - RANGE_QUANTILE), axis=0)
        return lower, upper

    @staticmethod
    def extent(lower: Array, upper: Array) -> Array:
        """(19,) width of each range; 1 (in the unit of the input) for one that training kept constant."""
        width = upper - lower
        constant = width <= _CONSTANT * np.maximum(np.abs(upper), 1.0)
        return np.where(constant, 1.0, width)

    @cached_property
    def scale(self) -> Array:
        """(19,) :meth:`extent` of the training range."""
        return self.extent(self.lower, self.upper)

    @classmethod
    def outside(cls, inputs: Array, lower: Array, upper: Array) -> Array:
        """Distance (N, 19) of inputs (N, 19) outside ranges (19,), (19,), in their widths; negative inside.

        Outside, that of a cosine becomes the distance of its angle: an angle that goes 1.2 times as far as in
        training takes its cosine 1.9 times as far. To first order, for a range about level flight.
        """
        distances = np.empty(inputs.shape)
        inputs, lower, upper = map(np.ascontiguousarray, (inputs, lower, upper))
        compiled.distances_outside(inputs, lower, upper, cls.extent(lower, upper), distances)
        return distances

    def input_excess(self, inputs: Array) -> Array:
        """Distance (N, 19) of inputs (N, 19) outside their training range; 0 inside, see :meth:`outside`."""
        return np.maximum(self.outside(inputs, self.lower, self.upper), 0.0)

    def to_json(self) -> dict[str, Any]:
        """Plain dictionary for the model file, by input and axis name; :meth:`from_json` reads it."""

        def entries(names: tuple[str, ...], entry: type[_InputLimits | _AxisLimits]) -> dict[str, Any]:
            keys = [column.name for column in fields(entry)]
            return {name: {k: float(getattr(self, k)[i]) for k in keys} for i, name in enumerate(names)}

        return {"inputs": entries(INPUT_NAMES, _InputLimits), "axes": entries(AXES, _AxisLimits)}

    @classmethod
    def from_json(cls, data: Any) -> Envelope:
        """Envelope from what :meth:`to_json` gave.

        Raises:
            ModelError: naming the entry that is missing or not usable.
        """
        stored = parse_config(_Stored, data, "envelope", ModelError)
        ordered = [stored.inputs[name] for name in INPUT_NAMES], [stored.axes[axis] for axis in AXES]
        return cls(
            **{
                column.name: np.array([getattr(entry, column.name) for entry in entries])
                for entries in ordered
                for column in fields(entries[0])
            }
        )


@dataclass(frozen=True)
class _InputLimits:
    """An input in a stored model."""

    lower: Real
    upper: Real
    margin: NotNegative

    def __post_init__(self) -> None:
        if self.lower > self.upper:
            raise ValueError(f"the lower bound {self.lower:g} lies above its upper bound {self.upper:g}")


@dataclass(frozen=True)
class _AxisLimits:
    """An axis in a stored model."""

    leverage_peak: NotNegative
    width_peak: NotNegative
    leverage_limit: Positive
    width_limit: Positive


@dataclass(frozen=True)
class _Stored:
    """The key `envelope` of a stored model."""

    inputs: Annotated[dict[str, _InputLimits], Each(INPUT_NAMES)]
    axes: Annotated[dict[str, _AxisLimits], Each(AXES)]


# Least and most that the variance due to airspeed can be on average, relative to that of a hover.
_LEAST_GROWTH, _MOST_GROWTH = 1e-6, 1e2
# Mean squared airspeed, m²/s², below which flights do not determine the growth with airspeed.
_HOVER = 0.01


@dataclass(frozen=True)
class SpreadShape:
    """Spread √(1 + κ h + γ V²) of leverage h and airspeed V: how errors on new flights grow.

    They grow with leverage, where the training samples constrain the coefficients poorly, and with airspeed,
    as the terms that the model lacks do, however many samples there were.

    Attributes:
        inflation: κ.
        growth: γ, s²/m².
    """

    inflation: float
    growth: float

    def of(self, leverage: Array, speed_squared: Array) -> Array:
        """Spread (N,) at leverages (N,) and squared airspeeds (N,) in m²/s²."""
        return np.sqrt(1.0 + self.inflation * leverage + self.growth * speed_squared)


@dataclass(frozen=True)
class PlacedErrors:
    """Errors of a model on one flight, with the leverage and airspeed of each.

    Attributes:
        error: (N,).
        leverage: (N,).
        speed_squared: (N,) of the airspeed, m²/s².
        inside: (N,) whether every input lies in the range of the samples that the model was fitted to.
        others: leverage (M,) and squared airspeed (M,) of some samples of each flight that it was fitted to.
    """

    error: Array
    leverage: Array
    speed_squared: Array
    inside: npt.NDArray[np.bool_]
    others: Sequence[tuple[Array, Array]] = ()

    def under(self, shape: SpreadShape) -> FlightErrors:
        """The errors beside the spread of a shape."""
        spread = shape.of(self.leverage, self.speed_squared)
        if not self.others:
            return FlightErrors(self.error, spread, self.inside)
        return FlightErrors(
            self.error,
            spread,
            self.inside,
            width=spread / flights_peak(shape.of(*causes) for causes in self.others),
            leverage=self.leverage / flights_peak(leverage for leverage, _ in self.others),
        )


def fit_shape(flights: Sequence[PlacedErrors], most_inflation: float) -> SpreadShape:
    """κ, 1 to `most_inflation`, and γ that maximise the likelihood of held-out errors e ~ N(0, σ² spread²).

    Flights weigh the same. Independent residuals of a true model would give κ = 1 and γ = 0; correlation and
    a wrong model give hundreds, and a γ that doubles the variance at some speed of the flights.
    """
    squares = [np.square(flight.error) for flight in flights]
    if not any(np.any(square) for square in squares):
        return SpreadShape(1.0, 0.0)
    causes = [np.stack((flight.leverage, flight.speed_squared)) for flight in flights]
    typical = max(float(np.mean([np.mean(cause[1]) for cause in causes])), _HOVER)

    def cost(logs: Array) -> tuple[float, Array]:
        """Negative log-likelihood with the best σ, and its gradient, for logarithms of κ and γ."""
        weights = np.exp(logs)
        variances = [1.0 + weights @ cause for cause in causes]
        pairs = list(zip(squares, causes, variances, strict=True))
        scale = np.mean([np.mean(e / v) for e, _, v in pairs])
        pull = np.mean([c @ (e / v**2) / len(e) for e, c, v in pairs], axis=0) / scale
        push = np.mean([c @ (1.0 / v) / len(v) for _, c, v in pairs], axis=0)
        value = np.log(scale) + np.mean([np.mean(np.log(v)) for v in variances])
        return float(value), weights * (push - pull)

    bounds = np.log([(1.0, max(most_inflation, 1.0)), (_LEAST_GROWTH / typical, _MOST_GROWTH / typical)])
    low, high = bounds.T
    # From either cause alone, as the likelihood may have a maximum near each.
    starts = [(0.5 * (low[0] + high[0]), low[1]), (low[0], np.log(1.0 / typical))]
    from scipy.optimize import minimize  # here, as no model in flight needs it

    fits = [minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds) for start in starts]
    inflation, growth = np.exp(min(fits, key=lambda fit: fit.fun).x)
    return SpreadShape(float(inflation), float(growth))


def squared_speed(inputs: Array) -> Array:
    """Squared airspeed (N,), m²/s², of input vectors (N, 19)."""
    return np.square(inputs[:, VELOCITY_INPUTS]).sum(axis=1)


def leverage_of(regressors: Array, whitening: Array) -> Array:
    """Leverage h (N,) = |W z|² for each row z of the regressors (N, s)."""
    return np.square(regressors @ whitening.T).sum(axis=1)
