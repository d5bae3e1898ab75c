# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The wrench that a model lacks, as a process in time: what the past of a flight tells of the next second.

On each axis the residual wrench is a first-order Markov process (Jategaonkar, Flight Vehicle System
Identification, 2015, 5.3) measured with noise. A filter of constant gain gives the disturbance at a sample
from samples up to it. Correlation time and gain are those that predict the mean residual of the next tenth to
half second best; the size of the process follows from the autocovariance of the residuals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from quadpi_core.config_schema import NotNegative, Positive, Share
from quadpi_core.flight import AXES
from quadpi_core.frames import Array

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
        """Variance (6,) of what is new after a step."""
        variance = np.square([axis.deviation for axis in self.axes])
        return variance * (1.0 - np.square(self.decay))

    @property
    def gain(self) -> Array:
        """Share (6,) of a sample's surprise that the filter takes for disturbance."""
        return np.array([axis.gain for axis in self.axes])

    @property
    def filtered_variance(self) -> Array:
        """Variance (6,) of the disturbance given the samples up to now, for the filter at its best gain."""
        memory = 1.0 - self.gain
        result: Array = memory * self.drive / (1.0 - memory * np.square(self.decay))
        return result

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
