# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One sample through bootstrap ensembles of six axes, as the monitor evaluates each, timed from Python."""

from __future__ import annotations

import time

import numpy as np

from benchmarks import Result
from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.model_kind import Fitted

NAMES = ("inference_one_sample_us",)

SAMPLES = 50_000


def run() -> list[Result]:
    X = smooth_inputs(SAMPLES, seed=1)
    inputs = simulation_inputs()
    widest = max(inputs.values(), key=len)
    own = microseconds(random_ensembles("bootstrap", X, inputs), X)
    wide = microseconds(random_ensembles("bootstrap", X, dict.fromkeys(inputs, widest)), X)
    baseline = (
        f"6 axes x 10 members of 20 units and a variance network of 25, called from Python; "
        f"inputs of the paper's simulation: {_summary(own)}; {len(widest)} inputs on every axis: "
        f"{_summary(wide)}"
    )
    return [Result(NAMES[0], float(np.median(own)), "µs", baseline, goal=10.0, at_most=True)]


def microseconds(fitted: Fitted, X: Array) -> Array:
    """How long (N,) each row of X (N, 19) takes alone."""
    factors = np.full(len(AXES), 1.96)
    fitted.evaluate(X[:1], factors)
    nanoseconds = np.empty(len(X))
    for i in range(len(X)):
        row = X[i : i + 1]
        start = time.perf_counter_ns()
        fitted.evaluate(row, factors)
        nanoseconds[i] = time.perf_counter_ns() - start
    return nanoseconds / 1e3


def _summary(times: Array) -> str:
    return f"median {np.median(times):.1f}, p99 {np.quantile(times, 0.99):.1f} µs"
