# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Ridge regression on the inputs and their squares, each axis by itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from quadpi_core.config_schema import Numbers, Positive
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.interval_rules import FlightErrors, StoredRule, calibrate, inside_range
from quadpi_core.models.model_kind import Evaluation, Fit, Fitted, FittedAxis, Kind, option
from quadpi_core.parallel import Progress

TERMS = ["1", *INPUT_NAMES, *(f"{name}^2" for name in INPUT_NAMES)]


@dataclass(frozen=True)
class RidgeAxis(FittedAxis):
    """One axis, as a model folder keeps it. Its intervals are equally wide everywhere."""

    coefficients: Annotated[Array, Numbers(len(TERMS))]
    rule: StoredRule
    terms = TERMS


class FittedRidge(Fitted):
    """The axes of a model."""

    method = "ridge"
    axis_type = RidgeAxis

    @cached_property
    def coefficients(self):
        """Coefficients (6, 39), zero for axes not held."""
        coefficients = np.zeros((len(AXES), len(TERMS)))
        for axis, own in self.axes.items():
            coefficients[AXES.index(axis)] = own.coefficients
        return coefficients

    def evaluate(self, inputs, factors, derivatives=None):  # noqa: ARG002
        """Predictions and intervals (N, 6), by the factors (6,) of the rules."""
        out = np.zeros((5, len(inputs), len(AXES)))
        predict(inputs, self.coefficients, out[0])
        out[1], out[2] = out[0] - factors, out[0] + factors
        return Evaluation(*out)


def predict(inputs, coefficients, out):
    """Fill predictions (N, A) for inputs (N, 19): term by term, as a matrix product may round by its size."""
    count = inputs.shape[1]
    out[:] = coefficients[:, 0]
    for k in range(count):
        value = inputs[:, k, np.newaxis]
        out += (coefficients[:, 1 + k] + coefficients[:, 1 + count + k] * value) * value


@dataclass(frozen=True)
class Ridge(Kind):
    """Each axis a ridge regression (Hoerl and Kennard 1970)."""

    penalty: Positive = option(1e-4, "Penalty on squared coefficients of standardised inputs, per sample.")
    name = FittedRidge.method
    label = "ridge regression"
    colour = "#009E73"
    normal_errors = True
    fitted_type = FittedRidge

    def fit(self, samples, pools, options, progress):  # noqa: ARG002
        """Fit each axis to all flights, and without each in turn."""
        X, axes, held_out = samples.inputs, {}, {}
        flights = [samples.flight == k for k in range(samples.flight.max() + 1)]
        for done, axis in enumerate(pools):
            progress(Progress(f"Identifying {axis}", done, len(pools)))
            y = samples.target(axis)
            held_out[axis] = [
                errors(self.solve(X[~mine], y[~mine]), X[mine], y[mine], inside_range(X[mine], of=X[~mine]))
                for mine in flights
            ]
            coefficients = self.solve(X, y)
            trained = [errors(coefficients, X[k], y[k], np.ones(k.sum(), dtype=bool)) for k in flights]
            axes[axis] = RidgeAxis(coefficients, calibrate(held_out[axis], trained))
        return Fit(FittedRidge(axes), held_out)

    def solve(self, X, y):
        """Coefficients (39,) for inputs (N, 19) and target (N,)."""
        Z = np.hstack((X, X**2))
        mean, scale = Z.mean(axis=0), np.maximum(Z.std(axis=0), 1e-9)
        Z = (Z - mean) / scale
        penalty = self.penalty * len(Z) * np.eye(Z.shape[1])
        slopes = np.linalg.solve(Z.T @ Z + penalty, Z.T @ (y - y.mean())) / scale
        return np.concatenate(([y.mean() - mean @ slopes], slopes))


def errors(coefficients, X, y, inside):
    """Errors on one flight, with a spread of 1 N or Nm: the rule makes it as wide as they need."""
    predicted = np.empty((len(X), 1))
    predict(X, coefficients[None], predicted)
    return FlightErrors(y - predicted[:, 0], np.ones(len(y)), inside)


KIND = Ridge()
