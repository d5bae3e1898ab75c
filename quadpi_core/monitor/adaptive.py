# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Intervals that adapt to the measured wrench, so that the coverage of any flight approaches the nominal one.

Adaptive conformal inference (Gibbs and Candès 2021) in the form of quantile tracking (Angelopoulos, Candès
and Tibshirani 2023): the interval of sample t is the model's own, its half width times a factor f_t, and

    log f_{t+1} = log f_t + η (m_t − α),      f_1 = 1,      α = 1 − confidence,

where m_t is 1 if sample t missed its interval, else 0. The interval of a sample depends on the past only. The
logarithm keeps the factor positive and makes a step the same share of it on every axis and vehicle.

**Coverage on any sequence.** The factor follows errors of 1/L to L half widths, L = :data:`LARGEST_CHANGE`:
while it is above L a sample counts as inside, below 1/L as missed, and the next step leads back. So
-log L − ηα ≤ log f_t ≤ log L + η(1 − α) for any sequence. Summing the steps,

    Σ (m_t − α) = (log f_{T+1} − log f_1)/η,    hence    |Σ m_t / T − α| ≤ (log L + η)/(ηT)

for the first T samples. This asks for no distribution, independence or exchangeability: it holds for drift,
jumps and an opponent who knows the factor. Smaller errors only add coverage; larger ones, a thousand times
the calibrated interval, occur in no flight. By the equality, a flight whose factor ends where it began has
exactly the nominal coverage.

**Step.** η = :data:`GAIN_PER_S` / sample rate, 0.01 at 500 Hz, so that the factor moves alike at any rate.
Errors of real flights stay correlated for 0.03 s (Mz) to 3 s (Fz; integrated autocorrelation time). With
5/s and 95 % the factor doubles within 0.15 s of unbroken misses, and halves within 2.8 s without any: it
follows the vehicle from one manoeuvre to the next. Thirty seconds suffice for coverage within 2 % of the
nominal even if the factor ends at 20 or 1/20. A much larger gain would chase single errors, a smaller one
leave a short flight uncorrected.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.elementary import exponential
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.records import record_dtype

GAIN_PER_S = 5.0
LARGEST_CHANGE = compiled.LARGEST_CHANGE


class Memory:
    """How the factors follow the measured wrench, and where they are."""

    step: float  # η
    miss_share: float  # α
    log_factor: Annotated[Array, len(AXES)]


MEMORY = record_dtype(Memory)


class AdaptiveFactor:
    """Factor per axis on the half width of a model's intervals; the same code live, in replay and offline.

    Time and memory per sample are constant: the state is one number per axis.

    Args:
        confidence: nominal coverage of the intervals.
        rate_hz: of the samples.
        gain_per_s: how fast the factor follows, see the module.

    Attributes:
        memory: a :class:`Memory` (1,), which compiled code changes in place.

    Raises:
        ModelError: for a confidence that is not between 0 and 1, or a rate or gain that is not positive.
    """

    def __init__(self, confidence: float, rate_hz: float, gain_per_s: float = GAIN_PER_S) -> None:
        if not 0.0 < confidence < 1.0:
            raise ModelError(f"confidence {confidence} is not between 0 and 1")
        for name, value in (("rate_hz", rate_hz), ("gain_per_s", gain_per_s)):
            if not 0.0 < value < np.inf:
                raise ModelError(f"adaptive intervals: {name} must be positive, found {value}")
        self.memory = np.zeros(1, MEMORY)
        self.memory["miss_share"] = 1.0 - confidence
        self._gain_per_s = gain_per_s
        self.retune(rate_hz)

    @property
    def factor(self) -> Array:
        """Factor (6,) for the next sample."""
        return exponential(self.memory["log_factor"][0])

    def reset(self) -> None:
        """Forget the past: the next interval is the model's own."""
        self.memory["log_factor"] = 0.0

    def retune(self, rate_hz: float) -> None:
        """Go on with samples of another rate."""
        self.memory["step"] = self._gain_per_s / rate_hz

    def step(self, measured: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Adapted bounds (K, 6) of K samples, from their measured wrench and the model's own bounds (K, 6).

        Blocks of any length give the same bounds, bit for bit. A sample and axis with no width, or with a
        number that is not finite, leaves the factor as it was.
        """
        bounds = np.empty(lower.shape), np.empty(upper.shape)
        measured, lower, upper = map(np.ascontiguousarray, (measured, lower, upper))
        compiled.adapt(self.memory, measured, lower, upper, *bounds)
        return bounds
