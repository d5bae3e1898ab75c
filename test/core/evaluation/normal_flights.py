# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of flights with normal errors, and their evaluation."""

import numpy as np

from quadpi_core.evaluation.evaluation_result import FlightResult, evaluate_flights
from quadpi_core.inputs import INPUT_NAMES

RANGES = {"Fx": 4.0, "Fz": 8.0}


def flight_result(name, samples=400, seed=0, half_width=2.0, axes=("Fx", "Fz")):
    rng = np.random.default_rng(seed)
    predicted = rng.standard_normal((samples, 6))
    return FlightResult(
        name=name,
        axes=axes,
        time=np.arange(samples) / 400,
        measured=predicted + rng.standard_normal((samples, 6)),
        predicted=predicted,
        lower=predicted - half_width,
        upper=predicted + half_width,
        inputs=rng.standard_normal((samples, len(INPUT_NAMES))),
        height=rng.uniform(0.0, 3.0, samples),
    )


def evaluate(results, groups, ranges=RANGES, **options):
    return evaluate_flights(results, groups, ranges, 0.95, model="m", vehicle="v", **options)
