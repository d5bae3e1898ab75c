# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Second step of the physical fit: parameters by the errors of predictions a tenth to half a second ahead.

Moments from a differentiated gyro are noise above 10 Hz, and the slow moments below it are small: the
equation error hardly sees them, but they add up over a roll-out. Roll-outs start with the disturbance that
the past tells, as predictions do, so a controller that answers slow disturbances with rotor speeds does not
bias what rotor speeds are found to do (the filter error method, Jategaonkar, Flight Vehicle System
Identification, 2015, 5; without the disturbance it is his output error method, 4). Errors count by their
norm, in units of their median over the flight, so that no wild sample and no fast flight outweighs the
others. Minimised by Gauss-Newton with the derivatives of `physical_rollout`.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.models.disturbance import Disturbance
from quadpi_core.models.physical_fit import FitStep, Problem
from quadpi_core.models.physical_regressors import regressors
from quadpi_core.models.physical_rollout import (
    ATTITUDE,
    POSITION,
    RATES,
    VELOCITY,
    Disturbances,
    Rolled,
    Track,
    roll_out,
)
from quadpi_core.models.rollout_flight import RolloutFlight, horizon_steps
from quadpi_core.models.rollout_model import MOVES, RolloutModel

# Horizons [s] of the errors, and what position, velocity, attitude and rates weigh there: at the first the
# noise of two samples rules, which holds parameters to what the next sample shows.
HORIZONS_S = (0.01, 0.1, 0.25, 0.5)
_WEIGHTS = np.array(
    [[0.0, 0.2, 0.2, 0.3], [0.0, 1.0, 1.0, 1.0], [0.0, 0.3, 0.3, 0.3], [0.5, 1.0, 1.0, 1.0]],
)
_PARTS = (POSITION, VELOCITY, ATTITUDE, RATES)
# Between starts [s]: roll-outs of neighbours are then about independent.
EVERY_S = 0.5
# Share of the roll-outs that count as independent, all quantities and horizons of a start together.
_INDEPENDENT = 0.15
# Error [in medians] up to which it counts by its square: beyond, by its size.
_SQUARE_TO = 0.5
# Iterations end when the cost falls by less than this share.
_ITERATIONS, _ENOUGH = 12, 2e-3
_SHARES = (1.0, 0.5, 0.25, 0.1)
# Share of the diagonal added to the Gauss-Newton matrix.
_DAMPING = 0.02
# Least median error, for flights of the model itself.
_LEAST = 1e-9
# Rounds of parameters, and of the disturbance that they leave.
_ROUNDS = 2
# Kernels release the interpreter.
_THREADS = 2


class _Cost(NamedTuple):
    value: float
    gradient: Array
    matrix: Array


@dataclass(frozen=True)
class MultiStepFit:
    """The model, and what was done.

    Attributes:
        model: with the parameters found, their covariance and the disturbance left.
        log: cost after each iteration.
    """

    model: RolloutModel
    log: tuple[FitStep, ...]


def fit_multi_step(
    flights: Sequence[RolloutFlight],
    start: RolloutModel,
    problem: Problem,
    *,
    delays_s: Sequence[float] | None = None,
    every_s: float = EVERY_S,
) -> MultiStepFit:
    """Improve a model by the errors of its predictions.

    Args:
        flights: to fit it to.
        start: the model of the first step.
        problem: prior of the parameters; bounds are not held.
        delays_s: of the rotor speeds of each flight; default: the model's.
        every_s: between starts.

    Returns:
        The start itself, said in the log, where predictions do not improve.
    """
    model, log = start, [FitStep("multi-step", "start", 0.0)]
    for _ in range(_ROUNDS):
        own = [
            replace(model, rotor_delay_s=delay) for delay in delays_s or [model.rotor_delay_s] * len(flights)
        ]
        residuals = [m.residuals(flight) for m, flight in zip(own, flights, strict=True)]
        process = Disturbance.of_residuals(residuals, flights[0].step, start.lead(flights[0].step))
        model = replace(model, disturbance=process)
        windows = [
            _Windows.of(flight, replace(m, disturbance=process), every_s)
            for m, flight in zip(own, flights, strict=True)
        ]
        model = _minimised([window for window in windows if len(window.starts)], model, problem, log)
    return MultiStepFit(model, tuple(log))


class _Windows(NamedTuple):
    """Roll-outs of a flight.

    Attributes:
        track: the flight.
        starts: (W,) samples.
        horizons: (H,) samples.
        measured: (W, 6) wrench that a disturbance is filtered of.
        predicted: (W, 6, P) per parameter, filtered alike.
        decay: (6,) of the disturbance.
    """

    track: Track
    starts: npt.NDArray[np.int64]
    horizons: npt.NDArray[np.int64]
    measured: Array
    predicted: Array
    decay: Array

    @classmethod
    def of(cls, flight: RolloutFlight, model: RolloutModel, every_s: float) -> _Windows:
        track = model.track(flight)
        horizons = horizon_steps(HORIZONS_S, track.step)
        starts = flight.starts(int(horizons[-1]), max(1, round(every_s / track.step)))
        by_parameter = regressors(track.motion, model.vehicle).transpose(0, 2, 1)
        process = replace(model.disturbance, step_s=track.step)
        lead = model.lead(track.step)
        before = np.maximum(starts - lead, 0)
        aged = process.decay**lead
        return cls(
            track,
            starts,
            horizons,
            process.filtered(flight.wrench)[before] * aged,
            process.filtered(by_parameter)[before] * aged[:, np.newaxis],
            process.decay,
        )

    def rolled(self, values: Array, *, derivatives: bool) -> Rolled:
        """The roll-outs with parameters (P,)."""
        known = self.measured - self.predicted @ values
        slopes = -self.predicted if derivatives else np.zeros((0, 0, 0))
        return roll_out(
            self.track,
            self.starts,
            self.horizons,
            np.where(MOVES, values, 0.0),
            derivatives=derivatives,
            disturbances=Disturbances(known, slopes, self.decay),
        )


def _minimised(
    windows: Sequence[_Windows], start: RolloutModel, problem: Problem, log: list[FitStep]
) -> RolloutModel:
    free = MOVES & (np.diag(start.covariance) > 0.0)
    spread = problem.spread[free]
    values = start.parameters.copy()

    def moved(trial: Array) -> Array:
        result: Array = (trial - problem.mean)[free] / spread
        return result

    rolled = _rolled(windows, values, derivatives=True)
    for number in range(_ITERATIONS):
        scales = [_medians(own) for own in rolled]
        cost = _cost(rolled, scales, moved(values), free, spread)
        matrix = cost.matrix + _DAMPING * np.diag(np.diag(cost.matrix))
        step = -np.linalg.solve(matrix, cost.gradient) * spread
        for share in _SHARES:
            trial = values.copy()
            trial[free] += share * step
            tried = _cost(
                _rolled(windows, trial, derivatives=False), scales, moved(trial), free, spread
            ).value
            if tried < cost.value:
                break
        else:
            break
        values = trial
        log.append(
            FitStep("multi-step", f"iteration {number + 1}, cost over that before", tried / cost.value)
        )
        rolled = _rolled(windows, values, derivatives=True)
        if tried > cost.value * (1.0 - _ENOUGH):
            break
    final = _cost(rolled, [_medians(own) for own in rolled], moved(values), free, spread)
    covariance = start.covariance.copy()
    covariance[np.ix_(free, free)] = np.linalg.inv(final.matrix) * np.outer(spread, spread)
    return replace(start, parameters=values, covariance=covariance)


def _rolled(windows: Sequence[_Windows], values: Array, *, derivatives: bool) -> list[Rolled]:
    with ThreadPoolExecutor(_THREADS) as threads:
        return list(threads.map(lambda own: own.rolled(values, derivatives=derivatives), windows))


def _medians(rolled: Rolled) -> Array:
    """Median norm (H, 4) of the errors of each horizon and quantity."""
    norms = [np.linalg.norm(rolled.errors[..., part], axis=-1) for part in _PARTS]
    result: Array = np.maximum(np.median(np.stack(norms, axis=-1), axis=0), _LEAST)
    return result


def _cost(
    rolled: Sequence[Rolled],
    scales: Sequence[Array],
    moved: Array,
    free: npt.NDArray[np.bool_],
    spread: Array,
) -> _Cost:
    """Cost of errors and parameters (moved, in spreads), gradient and Gauss-Newton matrix."""
    value = 0.5 * float(moved @ moved)
    gradient, matrix = moved.copy(), np.eye(len(moved))
    for own, scale in zip(rolled, scales, strict=True):
        if not np.all(np.isfinite(own.errors)):
            return _Cost(np.inf, gradient, matrix)
        for (horizon, quantity), weight in np.ndenumerate(_INDEPENDENT * _WEIGHTS):
            if weight == 0.0:
                continue
            part, unit = _PARTS[quantity], scale[horizon, quantity]
            errors = own.errors[:, horizon, part] / unit
            size = np.sqrt(_SQUARE_TO**2 + np.sum(np.square(errors), axis=1))
            value += weight * float(np.sum(size - _SQUARE_TO))
            if len(own.derivatives):
                slopes = own.derivatives[:, horizon, part][:, :, free] * (spread / unit)
                rows = slopes.reshape(-1, len(spread))
                flat = np.repeat(weight / size, 3)
                gradient = gradient + rows.T @ (flat * errors.reshape(-1))
                matrix = matrix + (rows * flat[:, np.newaxis]).T @ rows
    return _Cost(value, gradient, matrix)
