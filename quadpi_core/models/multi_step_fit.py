# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Second step of the physical fit: parameters by the errors of predictions a tenth to half a second ahead.

Moments from a differentiated gyro are noise above 10 Hz, and the slow moments below it are small: the
equation error hardly sees them, but they add up over a roll-out. The first step's posterior is the prior.
As roll-outs start with the disturbance that the past tells, this is the filter error method (Jategaonkar,
Flight Vehicle System Identification, 2015, 5); without it, it would be his output error method (4). Minimised
by Gauss-Newton with the derivatives of `physical_rollout`.

What roll-outs weigh against the prior is what predicts flights left out best. A fit without a flight follows
from the sums over the others, linearised at the fit to all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.models.multi_step_errors import (
    Part,
    Windows,
    all_rolled,
    log_ratio,
    mean_norms,
    median_norms,
    part_of,
)
from quadpi_core.models.physical_fit import FitStep, Problem, bounded_solution
from quadpi_core.models.rollout_flight import RolloutFlight
from quadpi_core.models.rollout_model import MOVES, RolloutModel

# What an error of a roll-out weighs against the prior, tried in this order. All quantities and horizons of a
# start are worth about one independent error, 0.15 each; the prior is of the same flights and too sure of
# slow moments, so more may predict better. At 2.4 attitude errors after 0.5 s of NeuroBEM flights left out
# are 0 to 12 % smaller than at 0.6, but up to 11 % larger a tenth of a second ahead on fast ones.
WEIGHTS_TRIED = (0.15, 0.6)
# Share of the errors on flights left out that must remain at most for the second step to be used: refits
# with other starts move it by half a percent.
WORTH_IT = 0.99
# Iterations at each weight; they end earlier when the cost falls by less than this share.
_ITERATIONS, _ENOUGH = 12, 5e-3
_SHARES = (1.0, 0.5, 0.25, 0.1)


@dataclass(frozen=True)
class MultiStepFit:
    """The models, and what was done.

    Attributes:
        model: fitted to all flights.
        left_out: fitted without each of them.
        weight: of the roll-outs; 0 where the first step is kept.
        log: cost after each iteration, and error on flights left out at each weight.
    """

    model: RolloutModel
    left_out: tuple[RolloutModel, ...]
    weight: float
    log: tuple[FitStep, ...]


def fit_multi_step(
    flights: Sequence[RolloutFlight],
    first: RolloutModel,
    left_out: Sequence[RolloutModel],
    problem: Problem,
    *,
    by_terms: bool = False,
) -> MultiStepFit:
    """Improve a model by the errors of its predictions.

    Args:
        flights: to fit it to.
        first: the first step, fitted to all flights; its disturbance is that of roll-outs.
        left_out: the first step without each of them.
        problem: bounds of the parameters, and what is known of them before any flight.
        by_terms: take what `problem` knows as prior, for flights whose single samples are mostly noise; the
            first step is then where the search starts, and no more.

    Returns:
        The models of the first step, said in their remark and the log, where predictions of flights left out
        do not improve, or one flight is all there is.
    """
    if len(flights) < 2:
        return _first_step(first, left_out, (), "one flight cannot tell whether predictions ahead improve")
    found = [Windows.of(flight, first) for flight in flights]
    used = [k for k, own in enumerate(found) if len(own.starts)]
    windows = [found[k] for k in used]
    free = MOVES & (np.diag(first.covariance) > 0.0)
    for own in left_out:
        free &= np.diag(own.covariance) > 0.0
    if not windows:
        return _first_step(first, left_out, (), "no roll-out of half a second can be used")
    spread = problem.spread if by_terms else np.sqrt(np.diag(first.covariance))
    space = _Space(first.parameters, free, spread[free], problem.lower)
    if by_terms:
        prior = _Prior.of_terms(problem, space)
        priors = [prior] * len(left_out)
    else:
        prior, priors = _Prior.of(first, space), [_Prior.of(own, space) for own in left_out]
    begun = mean_norms(windows, [left_out[k].parameters for k in used])
    log: list[FitStep] = []
    best, chosen, values = 0.0, None, first.parameters
    # The terms are not of these flights, so that roll-outs weigh what they are worth.
    for weight in WEIGHTS_TRIED[:1] if by_terms else WEIGHTS_TRIED:
        solution = _minimised(windows, _Objective(space, prior, weight), values, log)
        values = solution.values
        apart = [
            _without(solution, used.index(k) if k in used else None, _Objective(space, own, weight))
            for k, own in enumerate(priors)
        ]
        gain = log_ratio(mean_norms(windows, [apart[k][0] for k in used]), begun)
        log.append(FitStep("log error of flights left out", f"roll-outs weigh {weight:g}", gain))
        if gain < best:
            best, chosen = gain, (weight, solution.values, solution.covariance(), apart)
    if chosen is None or best > np.log(WORTH_IT):
        share = float(np.exp(min(best, 0.0)))
        return _first_step(
            first, left_out, log, f"flights left out are predicted with {share:.3f} of the errors at best"
        )
    weight, values, covariance, apart = chosen
    remark = (
        "parameters of their own, fitted to errors 0.01 to 0.5 s ahead: on flights left out these are "
        f"{np.exp(best):.2f} times those by the parameters of the wrench"
    )
    return MultiStepFit(
        _moved(first, space, values, covariance, remark),
        tuple(_moved(own, space, *there, remark) for own, there in zip(left_out, apart, strict=True)),
        weight,
        tuple(log),
    )


class _Space(NamedTuple):
    """Coordinates x (n,) of the parameters that move, from the first step on, in deviations of the prior.

    Attributes:
        origin: (P,) parameters of the first step.
        free: (P,) those that move.
        unit: (n,) their standard deviations in the prior.
        lower: (P,) bounds.
    """

    origin: Array
    free: npt.NDArray[np.bool_]
    unit: Array
    lower: Array

    def place(self, values: Array) -> Array:
        """Coordinates of parameters (P,)."""
        result: Array = (values - self.origin)[self.free] / self.unit
        return result

    def bound(self) -> Array:
        """Bounds (n,) of the coordinates."""
        return self.place(self.lower)


class _Prior(NamedTuple):
    """What is known before the roll-outs: coordinates (n,) of the parameters, their information (n, n)."""

    centre: Array
    information: Array

    @classmethod
    def of_terms(cls, problem: Problem, space: _Space) -> _Prior:
        """Of the terms, before any flight."""
        return cls(space.place(problem.mean), np.diag(np.square(space.unit / problem.spread[space.free])))

    @classmethod
    def of(cls, first: RolloutModel, space: _Space) -> _Prior:
        """Of the first step."""
        scaled = first.covariance[np.ix_(space.free, space.free)] / np.outer(space.unit, space.unit)
        information = np.asarray(np.linalg.inv(scaled), dtype=float)
        return cls(space.place(first.parameters), information)


class _Objective(NamedTuple):
    """What is minimised: the prior plus the weighted cost of the roll-outs."""

    space: _Space
    prior: _Prior
    weight: float

    def cost(self, values: Array, parts: Sequence[Part]) -> float:
        away = self.space.place(values) - self.prior.centre
        of_roll_outs = sum(part.value for part in parts)
        return float(0.5 * away @ self.prior.information @ away) + self.weight * of_roll_outs

    def matrix(self, parts: Sequence[Part]) -> Array:
        result: Array = self.prior.information + self.weight * sum(part.matrix for part in parts)
        return result

    def step(self, values: Array, parts: Sequence[Part]) -> Array:
        """Gauss-Newton step (n,) from parameters (P,) at which the parts were found."""
        place = self.space.place(values)
        gradient: Array = self.prior.information @ (place - self.prior.centre)
        gradient = gradient + self.weight * sum(part.gradient for part in parts)
        return bounded_solution(self.matrix(parts), -gradient, self.space.bound() - place)

    def moved(self, values: Array, step: Array) -> Array:
        result = values.copy()
        result[self.space.free] += step * self.space.unit
        return np.maximum(result, self.space.lower)

    def covariance(self, parts: Sequence[Part]) -> Array:
        """H⁻¹ (J + Λ) H⁻¹ (n, n), SI: J of the gradients of blocks, Λ that of the prior."""
        inverse = np.linalg.inv(self.matrix(parts))
        blocks = self.weight * np.concatenate([part.blocks for part in parts])
        spread = inverse @ (blocks.T @ blocks + self.prior.information) @ inverse
        result: Array = spread * np.outer(self.space.unit, self.space.unit)
        return result


class _Solution(NamedTuple):
    """Parameters (P,) with the least cost, the objective, and the parts of each flight there."""

    values: Array
    objective: _Objective
    parts: tuple[Part, ...]

    def covariance(self) -> Array:
        return self.objective.covariance(self.parts)


def _minimised(
    windows: Sequence[Windows], objective: _Objective, start: Array, log: list[FitStep]
) -> _Solution:
    values, space = start, objective.space
    rolled = all_rolled(windows, values, derivatives=True)
    for _ in range(_ITERATIONS):
        scales = [median_norms(own) for own in rolled]
        parts = [
            part_of(own, scale, space.free, space.unit) for own, scale in zip(rolled, scales, strict=True)
        ]
        before, step = objective.cost(values, parts), objective.step(values, parts)
        for share in _SHARES:
            trial = objective.moved(values, share * step)
            there = all_rolled(windows, trial, derivatives=False)
            tried = objective.cost(
                trial,
                [
                    part_of(own, scale, space.free, space.unit)
                    for own, scale in zip(there, scales, strict=True)
                ],
            )
            if tried < before:
                break
        else:
            break
        values = trial
        log.append(FitStep("multi-step fit", f"roll-outs weigh {objective.weight:g}, cost", tried / before))
        rolled = all_rolled(windows, values, derivatives=True)
        if tried > before * (1.0 - _ENOUGH):
            break
    return _Solution(
        values, objective, tuple(part_of(own, median_norms(own), space.free, space.unit) for own in rolled)
    )


def _without(solution: _Solution, flight: int | None, objective: _Objective) -> tuple[Array, Array]:
    """Parameters (P,) and covariance (n, n) of an objective without the roll-outs of a flight."""
    parts = [part for k, part in enumerate(solution.parts) if k != flight]
    values = objective.moved(solution.values, objective.step(solution.values, parts))
    return values, objective.covariance(parts)


def _moved(first: RolloutModel, space: _Space, values: Array, covariance: Array, remark: str) -> RolloutModel:
    """The model with other parameters, but for those of sensors, with which roll-outs began."""
    free = space.free
    parameters, together = np.where(free, values, first.parameters), first.covariance.copy()
    together[free] = 0.0
    together[:, free] = 0.0
    together[np.ix_(free, free)] = covariance
    return replace(first, parameters=parameters, covariance=together, remark=remark)


def _first_step(
    first: RolloutModel, left_out: Sequence[RolloutModel], log: Sequence[FitStep], why: str
) -> MultiStepFit:
    remark = f"parameters of the wrench; fitting them to errors ahead was not used: {why}"
    kept = tuple(replace(own, remark=remark) for own in left_out)
    return MultiStepFit(
        replace(first, remark=remark), kept, 0.0, (*log, FitStep("multi-step fit", f"not used: {why}", 1.0))
    )
