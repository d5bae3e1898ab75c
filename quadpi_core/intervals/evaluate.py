# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Prediction intervals of a model judged on flights, per axis, per flight and per group of flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import quadpi_core
from quadpi_core.errors import QuadpiError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES
from quadpi_core.intervals import metrics
from quadpi_core.intervals.autocorrelation import effective_sample_size
from quadpi_core.intervals.bootstrap import coverage_interval

_VELOCITY = [INPUT_INDEX[name] for name in ("u", "v", "w")]


class EvaluationError(QuadpiError):
    """Flights, groups and model do not fit together."""


@dataclass(frozen=True)
class FlightResult:
    """What a model says about one flight; columns Fx, Fy, Fz (N), Mx, My, Mz (Nm), body axes.

    Attributes:
        name: file stem of the flight.
        axes: axes that the model holds; the other columns of predicted, lower and upper mean nothing.
        time: (N,) seconds.
        measured, predicted, lower, upper: (N, 6).
        inputs: (N, 19), columns as :data:`quadpi_core.inputs.INPUT_NAMES`.
    """

    name: str
    axes: tuple[str, ...]
    time: Array
    measured: Array
    predicted: Array
    lower: Array
    upper: Array
    inputs: Array

    def __len__(self) -> int:
        return len(self.time)

    @property
    def speed(self) -> Array:
        """(N,) m/s relative to the air."""
        return np.asarray(np.linalg.norm(self.inputs[:, _VELOCITY], axis=1))

    def column(self, quantity: str, axis: str) -> Array:
        """One axis (N,) of `measured`, `predicted`, `lower` or `upper`."""
        values: Array = getattr(self, quantity)[:, AXES.index(axis)]
        return values

    def check(self) -> None:
        """Refuse what no metric is defined for.

        Raises:
            EvaluationError: naming flight, axis and sample, for no samples, a value that is not finite and
                bounds that cross.
        """
        if len(self) == 0:
            raise EvaluationError(f"flight {self.name}: holds no samples")
        for axis in self.axes:
            lower, upper = self.column("lower", axis), self.column("upper", axis)
            for quantity in ("measured", "predicted", "lower", "upper"):
                finite = np.isfinite(self.column(quantity, axis))
                if not finite.all():
                    sample = int(np.argmin(finite))
                    raise EvaluationError(
                        f"flight {self.name}: {axis}: sample {sample}: {quantity} not finite"
                    )
            if np.any(lower > upper):
                sample = int(np.argmax(lower > upper))
                raise EvaluationError(f"flight {self.name}: {axis}: sample {sample}: lower bound above upper")
        if self.inputs.shape != (len(self), len(INPUT_NAMES)):
            raise EvaluationError(f"flight {self.name}: inputs of shape {self.inputs.shape}")


def evaluate_flights(
    results: Sequence[FlightResult],
    groups: Mapping[str, Sequence[str]],
    training_range: Mapping[str, float],
    confidence: float,
    *,
    model: str,
    vehicle: str,
) -> dict[str, Any]:
    """Judge the intervals; the result is plain JSON, with null and never NaN where a metric is undefined.

    Keys: `model`, `vehicle`, `confidence`, `quadpi_version`, `training_range.AXIS` (denominator of nmpiw),
    `groups.NAME.{flights, axes.AXIS}` and `flights.NAME.{duration_s, axes.AXIS}`. Each axis holds

    - `picp`: coverage as a fraction; `picp_ci`: its 95 % confidence interval [low, high], see
      :func:`quadpi_core.intervals.bootstrap.coverage_interval`;
    - `mpiw`, `rmse`, `winkler` in N or Nm; `nmpiw`: mpiw over the range of the measured training data;
    - `r2`: null where the measurement is constant;
    - `n` samples; `n_eff`: how many independent samples the prediction errors are worth.

    Args:
        results: one per flight.
        groups: names of the flights in each group; a flight may be in several.
        training_range: range (max − min) of the measured training data per axis.
        confidence: nominal coverage of the intervals, between 0 and 1.
        model: identity of the model.
        vehicle: name of the vehicle file.

    Raises:
        EvaluationError: for a flight present twice, an empty group, a group with an unknown flight, a
            training range that is not positive, and what :meth:`FlightResult.check` refuses.
    """
    by_name: dict[str, FlightResult] = {}
    for result in results:
        if result.name in by_name:
            raise EvaluationError(f"flight {result.name}: present twice")
        result.check()
        by_name[result.name] = result
    members = {name: _members(name, flights, by_name) for name, flights in groups.items()}
    for axis, extent in training_range.items():
        if not 0.0 < extent < np.inf:
            raise EvaluationError(f"{axis}: the measured training data spans {extent}, so nmpiw is undefined")

    def judge(flights: Sequence[FlightResult]) -> dict[str, dict[str, Any]]:
        axes = [axis for axis in AXES if all(axis in flight.axes for flight in flights)]
        return {axis: evaluate_axis(flights, axis, training_range[axis], confidence) for axis in axes}

    return {
        "quadpi_version": quadpi_core.__version__,
        "model": model,
        "vehicle": vehicle,
        "confidence": confidence,
        "training_range": dict(training_range),
        "groups": {
            name: {"flights": [flight.name for flight in flights], "axes": judge(flights)}
            for name, flights in members.items()
        },
        "flights": {
            name: {"duration_s": float(flight.time[-1] - flight.time[0]), "axes": judge([flight])}
            for name, flight in by_name.items()
        },
    }


def evaluate_axis(
    flights: Sequence[FlightResult], axis: str, training_range: float, confidence: float
) -> dict[str, Any]:
    """Metrics of one axis over the samples of all `flights`; keys as in :func:`evaluate_flights`."""
    measured, predicted, lower, upper = (
        np.concatenate([flight.column(quantity, axis) for flight in flights])
        for quantity in ("measured", "predicted", "lower", "upper")
    )
    labels = np.repeat(np.arange(len(flights)), [len(flight) for flight in flights])
    inside = metrics.inside_interval(measured, lower, upper)
    errors = measured - predicted
    return {
        "picp": metrics.picp(measured, lower, upper),
        "picp_ci": list(coverage_interval(inside, errors, labels)),
        "mpiw": metrics.mpiw(lower, upper),
        "nmpiw": metrics.nmpiw(lower, upper, training_range),
        "rmse": metrics.rmse(measured, predicted),
        "r2": metrics.r_squared(measured, predicted),
        "winkler": metrics.winkler(measured, lower, upper, confidence),
        "n": len(measured),
        "n_eff": effective_sample_size(errors, labels),
    }


def _members(group: str, names: Sequence[str], by_name: Mapping[str, FlightResult]) -> list[FlightResult]:
    if not names:
        raise EvaluationError(f"group {group}: holds no flights")
    for name in names:
        if name not in by_name:
            raise EvaluationError(f"group {group}: no flight {name}; evaluated: {', '.join(by_name)}")
    if len(set(names)) < len(names):
        raise EvaluationError(f"group {group}: a flight is present twice")
    return [by_name[name] for name in names]
