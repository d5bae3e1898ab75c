# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals that adapt to the measured wrench, so that the coverage of any flight approaches the nominal one.

Their centre moves with past errors (`models.interval_rules`), and their width follows the misses: adaptive
conformal inference (Gibbs and Candès 2021) in the form of quantile tracking (Angelopoulos, Candès and
Tibshirani 2023). The half width of sample t is that calibrated about such a centre, times a factor f_t, and

    log f_{t+1} = log f_t + η (m_t − α),      f_1 = 1,      α = 1 − confidence,

where m_t is 1 if sample t missed its interval, else 0. The interval of a sample depends on the past only. The
logarithm keeps the factor positive and makes a step the same share of it on every axis and vehicle.

**Coverage on any sequence.** The factor follows errors of 1/L to L half widths, L = :data:`LARGEST_CHANGE`:
while it is above L a sample counts as inside, below 1/L as missed, and the next step leads back. So
-log L − ηα ≤ log f_t ≤ log L + η(1 − α) for any sequence. Summing the steps,

    Σ (m_t − α) = (log f_{T+1} − log f_1)/η,    hence    |Σ m_t / T − α| ≤ (log L + η)/(ηT)

for the first T samples, wherever the centre moves. This asks for no distribution, independence or
exchangeability: it holds for drift, jumps and an opponent who knows the interval. Smaller errors only add
coverage; larger ones, a thousand times the calibrated interval, occur in no flight. By the equality, a flight
whose factor ends where it began has exactly the nominal coverage.

**Step.** η = :data:`GAIN_PER_S` / sample rate, 0.02 at 500 Hz and at most :data:`MOST_STEP`, so that the
factor moves alike at any rate. With 10/s and 95 % it doubles within 0.07 s of unbroken misses, and halves
within 1.4 s without any: it follows the vehicle from one manoeuvre to the next. Of 2, 5, 10, 20 and 40/s this
was the best on the flights that the winner of experiments/results/intervals-raced.md was chosen on. A larger
gain chases single errors, a smaller one leaves a short flight uncorrected.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from quadpi_core.core import compiled, exponential
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import MEMORIES_S, MovingCentre, delay, shares
from quadpi_core.records import record_dtype

GAIN_PER_S = 10.0
# Of rates below 50 Hz: a larger step than this chases single errors.
MOST_STEP = 0.2
LARGEST_CHANGE = compiled.LARGEST_CHANGE


class Memory:
    """How the intervals follow the measured wrench, and where they are."""

    step: float  # η
    miss_share: float  # α
    log_factor: Annotated[Array, len(AXES)]
    delay: int  # samples after which an error counts
    samples: int  # so far
    narrower: Annotated[Array, len(AXES)]
    share: Annotated[Array, len(MEMORIES_S)]  # of a new error in each running mean
    coefficient: Annotated[Array, len(AXES), len(MEMORIES_S)]
    mean: Annotated[Array, len(AXES), len(MEMORIES_S)]
    waiting: Annotated[Array, compiled.ERRORS_KEPT, len(AXES)]  # errors, the last ones


MEMORY = record_dtype(Memory)


class AdaptiveIntervals:
    """Centre and factor per axis of a model's intervals; the same code live, in replay and offline.

    Time and memory per sample are constant.

    Args:
        confidence: nominal coverage of the intervals.
        rate_hz: of the samples.
        centre: how it moves; it stays where that is not known.
        gain_per_s: how fast the factor follows, see the module.

    Attributes:
        memory: a :class:`Memory` (1,), which compiled code changes in place.

    Raises:
        ModelError: for a confidence that is not between 0 and 1, or a rate or gain that is not positive.
    """

    def __init__(
        self,
        confidence: float,
        rate_hz: float,
        centre: MovingCentre | None = None,
        gain_per_s: float = GAIN_PER_S,
    ) -> None:
        if not 0.0 < confidence < 1.0:
            raise ModelError(f"confidence {confidence} is not between 0 and 1")
        for name, value in (("rate_hz", rate_hz), ("gain_per_s", gain_per_s)):
            if not 0.0 < value < np.inf:
                raise ModelError(f"adaptive intervals: {name} must be positive, found {value}")
        self.memory = np.zeros(1, MEMORY)
        self.memory["miss_share"], self.memory["narrower"] = 1.0 - confidence, 1.0
        for axis, moved in ({} if centre is None else centre.axes).items():
            self.memory["coefficient"][0, AXES.index(axis)] = moved.coefficients
            self.memory["narrower"][0, AXES.index(axis)] = moved.narrower
        self._gain_per_s = gain_per_s
        self.retune(rate_hz)

    @property
    def factor(self) -> Array:
        """Factor (6,) for the next sample."""
        return exponential(self.memory["log_factor"][0])

    def reset(self) -> None:
        """Forget the past: the next interval is the model's own."""
        for name in ("log_factor", "samples", "mean", "waiting"):
            self.memory[name] = 0

    def retune(self, rate_hz: float) -> None:
        """Go on with samples of another rate."""
        self.memory["step"] = min(self._gain_per_s / rate_hz, MOST_STEP)
        self.memory["share"] = shares(rate_hz)
        self.memory["delay"] = min(delay(rate_hz), compiled.ERRORS_KEPT)

    def step(self, measured: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Adapted bounds (K, 6) of K samples, from their measured wrench and the model's own bounds (K, 6).

        Blocks of any length give the same bounds, bit for bit. A sample and axis with no width, or with a
        number that is not finite, leaves factor and centre as they were.
        """
        bounds = np.empty(lower.shape), np.empty(upper.shape)
        measured, lower, upper = map(np.ascontiguousarray, (measured, lower, upper))
        compiled.adapt(self.memory, measured, lower, upper, *bounds)
        return bounds
