# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Open-loop roll-outs of the physical model with their derivatives by each parameter.

A rigid body starts at a smoothed state and moves by the model's wrench of the measured rotor speeds, by the
explicit midpoint rule. With it go the derivatives of its state by the parameters: the scheme itself is
differentiated, so they are those of the numbers computed (Jategaonkar, Flight Vehicle System Identification,
2015, 4.7). The derivatives of the wrench by velocity and rates are central differences. Attitude errors are
rotation vectors φ in body axes: R exp(φ). A disturbance, the residual wrench known at the start, adds to the
wrench and decays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import NotNegative, Positive, Share
from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.records import Records, record_dtype

# Rows of an error and of its derivatives.
POSITION, VELOCITY, ATTITUDE, RATES = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
STATES = 12


class Moving:
    """State of a body during a roll-out.

    Attributes:
        displacement: m in the world, since the start.
        attitude: body to world.
        velocity: m/s in the world.
        rates: rad/s in the body.
    """

    displacement: Annotated[Array, 3]
    attitude: Annotated[Array, 4]
    velocity: Annotated[Array, 3]
    rates: Annotated[Array, 3]


MOVING = record_dtype(Moving)


class Rolled(NamedTuple):
    """Errors of W roll-outs at H horizons: predicted less measured.

    Attributes:
        errors: (W, H, 12) position m, velocity m/s in the world, attitude rad, rates rad/s.
        derivatives: (W, H, 12, P) of the errors by the parameters; empty where not asked for.
        path: MOVING (W, S + 1) at each of the S steps to the last horizon.
    """

    errors: Array
    derivatives: Array
    path: Records


class Disturbances(NamedTuple):
    """Residual wrench known at the starts of W roll-outs.

    Attributes:
        wrench: (W, 6) N and Nm, body axes.
        slopes: (W, 6, P) its derivatives by the parameters.
        decay: (6,) share that is left after a step.
    """

    wrench: Array
    slopes: Array
    decay: Array


class Track(NamedTuple):
    """A flight as roll-outs need it.

    Attributes:
        step: s between samples.
        motion: MOTION (N,), rotor speeds as they act at each sample.
        attitude: (N, 4) body to world.
        vehicle: PHYSICAL_VEHICLE (1,).
        mass, gravity: kg, m/s².
        inertia, inverse_inertia: (3, 3) kg m², and its inverse.
    """

    step: float
    motion: Records
    attitude: Array
    vehicle: Records
    mass: float
    gravity: float
    inertia: Array
    inverse_inertia: Array

    def in_rows(self) -> Track:
        """The same with its samples one after another, as the compiled core takes them."""
        motion, attitude = np.ascontiguousarray(self.motion), np.ascontiguousarray(self.attitude)
        return self._replace(motion=motion, attitude=attitude)


def roll_out(
    track: Track,
    starts: npt.NDArray[np.int64],
    horizons: npt.NDArray[np.int64],
    parameters: Array,
    *,
    derivatives: bool,
    disturbances: Disturbances | None = None,
) -> Rolled:
    """Roll the model out from samples of a flight.

    Args:
        track: the flight, on an even time grid.
        starts: (W,) samples to start from; the last horizon after each lies within the flight.
        horizons: (H,) steps after the start, rising.
        parameters: (P,) of the model.
        derivatives: whether to compute them, which takes thirty times as long.
        disturbances: at the starts; without them there are none.
    """
    if disturbances is None:
        none = np.zeros((len(starts), 6, len(parameters)) if derivatives else (0, 0, 0))
        disturbances = Disturbances(np.zeros((len(starts), 6)), none, np.ones(6))
    wrench, own_slopes = map(np.ascontiguousarray, disturbances[:2])
    disturbances = Disturbances(wrench, own_slopes, disturbances.decay)
    errors = np.zeros((len(starts), len(horizons), STATES))
    slopes = np.zeros((len(starts) if derivatives else 0, len(horizons), STATES, len(parameters)))
    rolled = Rolled(errors, slopes, np.zeros((len(starts), horizons[-1] + 1), MOVING))
    compiled.roll_out(track.in_rows(), starts, horizons, parameters, disturbances, rolled)
    return rolled


# Correlation times [s] and gains that are tried. Shorter times die out within the low-pass of all signals,
# longer ones are a constant over a roll-out; a gain of 0 holds nothing.
TIMES_S = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2)
GAINS = (0.0, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5)
# Spans [s] whose mean residual is predicted, those of roll-outs.
_SPANS_S = (0.1, 0.25, 0.5)
# Lags [s] at which the autocovariance is matched: below, the noise of a low-pass at 30 Hz hangs together;
# beyond, a roll-out has ended.
_FIRST_LAG_S, _LAST_LAG_S = 0.04, 0.6
# Least deviation, for flights of the model itself.
_LEAST = 1e-12


@dataclass(frozen=True)
class AxisDisturbance:
    """Disturbance of one axis; N or Nm.

    Attributes:
        deviation: standard deviation of the process.
        time_s: over which its correlation falls to 1/e.
        gain: share of a sample's surprise that the filter takes for disturbance.
    """

    deviation: NotNegative
    time_s: Positive
    gain: Share


@dataclass(frozen=True)
class Disturbance:
    """The disturbance on all axes, for samples `step_s` apart; a model folder keeps its fields."""

    step_s: Positive
    axes: tuple[AxisDisturbance, ...]

    def __post_init__(self) -> None:
        if len(self.axes) != len(AXES):
            raise ValueError(f"`axes` must be a list of {len(AXES)}, found {len(self.axes)}")

    @classmethod
    def of_residuals(cls, residuals: Sequence[Array], step_s: float, lead: int = 0) -> Disturbance:
        """From the residual wrench (N, 6) of flights, best of a model that did not see them.

        Args:
            residuals: measured less predicted, of each flight.
            step_s: between samples.
            lead: samples before the present whose residuals are not known yet.
        """
        axes = []
        for axis in range(len(AXES)):
            series = [residual[:, axis] for residual in residuals]
            time_s, gain = _best_predictor(series, step_s, lead)
            axes.append(AxisDisturbance(_deviation(series, time_s, step_s), time_s, gain))
        return cls(step_s, tuple(axes))

    @classmethod
    def nothing(cls, step_s: float) -> Disturbance:
        """No disturbance at all."""
        return cls(step_s, (AxisDisturbance(0.0, TIMES_S[0], 0.0),) * len(AXES))

    @property
    def decay(self) -> Array:
        """Share (6,) of the disturbance that is left after a step."""
        return np.exp(-self.step_s / np.array([axis.time_s for axis in self.axes]))

    @property
    def drive(self) -> Array:
        """Process noise (6,) per step: a variance."""
        variance = np.square([axis.deviation for axis in self.axes])
        return variance * (1.0 - np.square(self.decay))

    @property
    def gain(self) -> Array:
        """Kalman gain (6,): share of a sample's innovation that the filter takes for disturbance."""
        return np.array([axis.gain for axis in self.axes])

    @property
    def filtered_variance(self) -> Array:
        """Variance (6,) of the disturbance given the samples up to now, for the filter at its best gain."""
        memory = 1.0 - self.gain
        return memory * self.drive / (1.0 - memory * np.square(self.decay))

    def filtered(self, residuals: Array, before: Array | None = None) -> Array:
        """Disturbance (N, 6, ...) at each sample from the residuals (N, 6, ...) up to it.

        The filter is linear, so it takes derivatives of residuals as well.

        Args:
            residuals: of samples in a row.
            before: disturbance (6, ...) at the sample before them; zero unless given.
        """
        # Slow to import, and no model in flight needs it.
        from scipy.signal import lfilter

        out = np.empty_like(residuals)
        before = np.zeros_like(residuals[0]) if before is None else before
        for axis, (gain, decay) in enumerate(zip(self.gain, self.decay, strict=True)):
            memory = (1.0 - gain) * decay
            start = memory * before[axis][np.newaxis]
            out[:, axis], _ = lfilter([gain], [1.0, -memory], residuals[:, axis], axis=0, zi=start)
        return out


def _best_predictor(series: Sequence[Array], step_s: float, lead: int) -> tuple[float, float]:
    """Correlation time and gain whose held disturbance predicts the mean of the next residuals best."""
    spans = [max(1, round(span / step_s)) for span in _SPANS_S]
    known = [residual for residual in series if len(residual) > 2 * (spans[-1] + lead)]
    if not known:
        return TIMES_S[0], 0.0
    from scipy.signal import lfilter

    sums = [np.concatenate(([0.0], np.cumsum(residual))) for residual in known]
    scale = [max(sum(float(np.abs(own[n:] - own[:-n]).mean()) for own in sums), _LEAST) for n in spans]

    def cost(time_s: float, gain: float) -> float:
        decay = float(np.exp(-step_s / time_s))
        total = 0.0
        for residual, summed in zip(known, sums, strict=True):
            estimate = lfilter([gain], [1.0, -(1.0 - gain) * decay], residual) * decay**lead
            for n, size in zip(spans, scale, strict=True):
                # Of samples after the present up to the end of the span.
                share = decay * (1.0 - decay**n) / (1.0 - decay)
                ahead = summed[lead + 1 + n :] - summed[lead + 1 : -n]
                total += float(np.abs(ahead - share * estimate[: len(ahead)]).mean()) / size
        return total

    best = min(
        (cost(TIMES_S[0], 0.0), TIMES_S[0], 0.0),
        *((cost(time_s, gain), time_s, gain) for time_s in TIMES_S for gain in GAINS[1:]),
    )
    return best[1], best[2]


def _deviation(series: Sequence[Array], time_s: float, step_s: float) -> float:
    """Deviation of the process of a correlation time whose autocovariance is nearest to that of residuals."""
    first, last = (max(1, round(lag / step_s)) for lag in (_FIRST_LAG_S, _LAST_LAG_S))
    lags = np.arange(first, last + 1)
    products, counts = np.zeros(len(lags)), np.zeros(len(lags))
    whole, samples = 0.0, 0
    for residual in series:
        whole, samples = whole + float(residual @ residual), samples + len(residual)
        for place, lag in enumerate(lags[lags < len(residual)]):
            products[place] += residual[:-lag] @ residual[lag:]
            counts[place] += len(residual) - lag
    shape = np.exp(-lags * step_s / time_s)
    variance = float(shape @ (products / np.maximum(counts, 1.0)) / (shape @ shape))
    return float(np.sqrt(np.clip(variance, 0.0, whole / max(samples, 1))))
