# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Second step of the physical fit: parameters by the errors of predictions a tenth to half a second ahead.

Moments from a differentiated gyro are noise above 10 Hz, and the slow moments below it are small: the
equation error hardly sees them, but they add up over a roll-out. The first step's posterior is the prior.
Roll-outs start with the disturbance that the past tells, as predictions do, which takes away much of the bias
that a controller causes by answering slow disturbances with rotor speeds: this is the filter error method
(Jategaonkar, Flight Vehicle System Identification, 2015, 5); without it, it would be his output error method
(4). Errors count by their norm, in units of their median over the flight, so that no wild sample and no fast
flight outweighs the others. Minimised by Gauss-Newton with the derivatives of `physical_rollout`.

What roll-outs weigh against the prior is what predicts flights left out best. A fit without a flight follows
from the sums over the others, linearised at the fit to all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array, from_rotation_vector, inverses, products
from quadpi_core.inputs import INPUT_INDEX
from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.least_squares import identifiable
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.physical_fit import FitStep, Problem, bounded_solution, flights_of, thinned_rows
from quadpi_core.models.physical_rollout import STATES, Disturbance, Disturbances, Rolled, Track, roll_out
from quadpi_core.models.physical_terms import regressors
from quadpi_core.models.rollout_model import (
    MOVES,
    FlightRollouts,
    RolloutFlight,
    RolloutModel,
    disturbance_left,
    horizon_steps,
)
from quadpi_core.models.tubes import (
    HORIZONS_S,
    QUANTITIES,
    TRACKING_PER_S,
    Following,
    TubeCalibration,
    chosen_shape,
    error_norms,
    tube_scores,
)
from quadpi_core.vehicle import Vehicle

# Horizons [s] of the errors, and what position, velocity, attitude and rates weigh there: at the first the
# noise of two samples rules, which holds parameters to what the next sample shows.
FITTED_HORIZONS_S = (0.01, 0.1, 0.25, 0.5)
_WEIGHTS = np.array(
    [[0.0, 0.2, 0.2, 0.3], [0.0, 1.0, 1.0, 1.0], [0.0, 0.3, 0.3, 0.3], [0.5, 1.0, 1.0, 1.0]],
)
# Between starts [s]: roll-outs of neighbours are then about independent.
EVERY_S = 0.5
# Error [in medians] up to which it counts by its square: beyond, by its size.
_SQUARE_TO = 0.5
# Least median error, for flights of the model itself.
_LEAST = 1e-9
# Starts whose errors are summed before their covariance is taken: what is wrong hangs together over 2 s.
_BLOCK = 4
# Samples whose regressors are held at a time: 28 MB.
_SAMPLES = 6000
# Kernels release the interpreter.
_THREADS = 2
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


class Windows(NamedTuple):
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
    def from_flight(cls, flight: RolloutFlight, model: RolloutModel) -> Windows:
        """Of a flight whose predictions by the model are finite."""
        track, lead = model.track(flight), model.lead(flight.step)
        horizons = horizon_steps(FITTED_HORIZONS_S, track.step)
        starts = flight.starts(int(horizons[-1]), max(1, round(EVERY_S / track.step)))
        process = replace(model.disturbance, step_s=track.step)
        before, aged = np.maximum(starts - lead, 0), process.decay**lead
        measured = process.filtered(flight.wrench)[before] * aged
        by_window: list[Array] = []
        last: Array | None = None
        for first in range(0, len(track.motion), _SAMPLES):
            slopes = regressors(track.motion[first : first + _SAMPLES], model.vehicle).transpose(0, 2, 1)
            filtered = process.filtered(slopes, last)
            by_window.append(filtered[before[(before >= first) & (before < first + _SAMPLES)] - first])
            last = filtered[-1]
        predicted = np.concatenate(by_window) * aged[:, np.newaxis]
        windows = cls(track, starts, horizons, measured, predicted, process.decay)
        errors = windows.rolled(model.parameters, derivatives=False).errors
        fine = np.all(np.isfinite(errors), axis=(1, 2)) & np.all(np.isfinite(predicted), axis=(1, 2))
        return windows._replace(starts=starts[fine], measured=measured[fine], predicted=predicted[fine])

    def rolled(self, values: Array, *, derivatives: bool) -> Rolled:
        """The roll-outs with parameters (P,)."""
        known = self.measured - self.predicted @ values
        slopes = -self.predicted if derivatives else np.zeros((0, 0, 0))
        disturbances, moving = Disturbances(known, slopes, self.decay), np.where(MOVES, values, 0.0)
        windows = self.track, self.starts, self.horizons
        return roll_out(*windows, moving, derivatives=derivatives, disturbances=disturbances)


class Part(NamedTuple):
    """Cost of the roll-outs of a flight, its gradient (n,) and Gauss-Newton matrix (n, n).

    Attributes:
        blocks: (B, n) gradient of each block of starts.
    """

    value: float
    gradient: Array
    matrix: Array
    blocks: Array


def all_rolled(windows: Sequence[Windows], values: Array, *, derivatives: bool) -> list[Rolled]:
    """The roll-outs of each flight with parameters (P,)."""
    with ThreadPoolExecutor(_THREADS) as threads:
        return list(threads.map(lambda own: own.rolled(values, derivatives=derivatives), windows))


def median_norms(rolled: Rolled) -> Array:
    """Median norm (H, 4) of the errors of each horizon and quantity."""
    return np.maximum(np.median(error_norms(rolled.errors), axis=0), _LEAST)


def mean_norms(windows: Sequence[Windows], values: Sequence[Array]) -> Array:
    """Mean norm (F, H, 4) of the errors of flights by parameters of each."""
    rolled = [own.rolled(there, derivatives=False) for own, there in zip(windows, values, strict=True)]
    return np.maximum(np.stack([error_norms(one.errors).mean(axis=0) for one in rolled]), _LEAST)


def log_ratio(norms: Array, others: Array) -> float:
    """Weighted mean of the logarithm of norms (F, H, 4) over others; infinite for those that diverge."""
    if not np.all(np.isfinite(norms)):
        return float(np.finfo(float).max)
    logs = np.mean(np.log(norms / others), axis=0)
    return float(np.sum(_WEIGHTS * logs) / np.sum(_WEIGHTS))


def part_of(rolled: Rolled, scale: Array, free: npt.NDArray[np.bool_], unit: Array) -> Part:
    """Cost of roll-outs; without derivatives, the value alone.

    Args:
        rolled: of a flight.
        scale: (H, 4) that errors are counted in.
        free: (P,) parameters with derivatives.
        unit: (n,) that these are counted in.
    """
    size = len(unit)
    value, gradients = 0.0, np.zeros((len(rolled.errors), size))
    matrix = np.zeros((size, size))
    if not np.all(np.isfinite(rolled.errors)):
        value = np.inf
    parts = list(QUANTITIES.values())
    for horizon, quantity in np.argwhere(_WEIGHTS):
        weight = _WEIGHTS[horizon, quantity]
        part, own = parts[quantity], scale[horizon, quantity]
        errors = rolled.errors[:, horizon, part] / own
        length = np.sqrt(_SQUARE_TO**2 + np.sum(np.square(errors), axis=1))
        value += weight * float(np.sum(length - _SQUARE_TO))
        if len(rolled.derivatives):
            slopes = rolled.derivatives[:, horizon, part][:, :, free] * (unit / own)
            shares = weight / length
            gradients += np.einsum("w,wi,wip->wp", shares, errors, slopes)
            rows = slopes.reshape(-1, size)
            matrix += (rows * np.repeat(shares, 3)[:, np.newaxis]).T @ rows
    starts = np.arange(0, len(gradients), _BLOCK)
    return Part(value, gradients.sum(axis=0), matrix, np.add.reduceat(gradients, starts, axis=0))


class MultiStepFit(NamedTuple):
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
    all_windows = [Windows.from_flight(flight, first) for flight in flights]
    used = [k for k, one in enumerate(all_windows) if len(one.starts)]
    windows = [all_windows[k] for k in used]
    if not windows:
        return _first_step(first, left_out, (), "no roll-out of half a second can be used")
    free = MOVES & np.all([np.diag(model.covariance) > 0.0 for model in (first, *left_out)], axis=0)
    unit = (problem.spread if by_terms else np.sqrt(np.diag(first.covariance)))[free]

    def objective_of(own: RolloutModel) -> _Objective:
        mean, known = problem.mean, np.diag(np.square(unit / problem.spread[free]))
        if not by_terms:
            scaled = own.covariance[np.ix_(free, free)] / np.outer(unit, unit)
            mean, known = own.parameters, np.asarray(np.linalg.inv(scaled), dtype=float)
        centre = (mean - first.parameters)[free] / unit
        return _Objective(first.parameters, free, unit, problem.lower, centre, known, 0.0)

    whole, *others = [objective_of(model) for model in (first, *left_out)]
    begun = mean_norms(windows, [left_out[k].parameters for k in used])
    log: list[FitStep] = []
    best, chosen, values = 0.0, None, first.parameters
    # The terms are not of these flights, so that roll-outs weigh what they are worth.
    for weight in WEIGHTS_TRIED[:1] if by_terms else WEIGHTS_TRIED:
        objective = whole._replace(weight=weight)
        values, parts = _minimised(windows, objective, values, log)
        apart = []
        for k, own in enumerate(others):
            # Roll-outs linearised at the parameters of all flights.
            of_others = [part for j, part in zip(used, parts, strict=True) if j != k]
            without = own._replace(weight=weight)
            apart.append((without.moved(values, of_others), without.covariance(of_others)))
        gain = log_ratio(mean_norms(windows, [apart[k][0] for k in used]), begun)
        log.append(FitStep("log error of flights left out", f"roll-outs weigh {weight:g}", gain))
        if gain < best:
            best, chosen = gain, (weight, values, objective.covariance(parts), apart)
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
        _moved(first, free, values, covariance, remark),
        tuple(_moved(own, free, *there, remark) for own, there in zip(left_out, apart, strict=True)),
        weight,
        tuple(log),
    )


class _Objective(NamedTuple):
    """What is minimised: a prior plus the weighted cost of the roll-outs.

    Coordinates (n,) are of the parameters that move, from those of the first step on, in units.

    Attributes:
        origin: (P,) parameters of the first step.
        free: (P,) those that move.
        unit: (n,) their standard deviations in the prior.
        lower: (P,) bounds.
        centre, information: (n,), (n, n) what is known before the roll-outs: coordinates, their information.
        weight: of the roll-outs.
    """

    origin: Array
    free: npt.NDArray[np.bool_]
    unit: Array
    lower: Array
    centre: Array
    information: Array
    weight: float

    def place(self, values: Array) -> Array:
        """Coordinates of parameters (P,)."""
        return (values - self.origin)[self.free] / self.unit

    def cost(self, values: Array, parts: Sequence[Part]) -> float:
        away = self.place(values) - self.centre
        of_roll_outs = sum(part.value for part in parts)
        return float(0.5 * away @ self.information @ away) + self.weight * of_roll_outs

    def matrix(self, parts: Sequence[Part]) -> Array:
        return self.information + self.weight * sum(part.matrix for part in parts)

    def moved(self, values: Array, parts: Sequence[Part], share: float = 1.0) -> Array:
        """Parameters (P,) after a share of the Gauss-Newton step from those at which the parts were found."""
        place = self.place(values)
        gradient: Array = self.information @ (place - self.centre)
        gradient = gradient + self.weight * sum(part.gradient for part in parts)
        step = bounded_solution(self.matrix(parts), -gradient, self.place(self.lower) - place)
        result = values.copy()
        result[self.free] += share * step * self.unit
        return np.maximum(result, self.lower)

    def covariance(self, parts: Sequence[Part]) -> Array:
        """H⁻¹ (J + Λ) H⁻¹ (n, n), SI: J of the gradients of blocks, Λ that of the prior."""
        inverse = np.linalg.inv(self.matrix(parts))
        blocks = self.weight * np.concatenate([part.blocks for part in parts])
        spread = inverse @ (blocks.T @ blocks + self.information) @ inverse
        return spread * np.outer(self.unit, self.unit)


def _minimised(
    windows: Sequence[Windows], objective: _Objective, start: Array, log: list[FitStep]
) -> tuple[Array, list[Part]]:
    """Parameters (P,) with the least cost, and the parts of each flight there."""

    def parts_of(rolled: Sequence[Rolled], scales: Sequence[Array]) -> list[Part]:
        pairs = zip(rolled, scales, strict=True)
        return [part_of(own, scale, objective.free, objective.unit) for own, scale in pairs]

    values = start
    rolled = all_rolled(windows, values, derivatives=True)
    for _ in range(_ITERATIONS):
        scales = [median_norms(rollout) for rollout in rolled]
        parts = parts_of(rolled, scales)
        before = objective.cost(values, parts)
        for share in _SHARES:
            trial = objective.moved(values, parts, share)
            tried = objective.cost(trial, parts_of(all_rolled(windows, trial, derivatives=False), scales))
            if tried < before:
                break
        else:
            break
        values = trial
        log.append(FitStep("multi-step fit", f"roll-outs weigh {objective.weight:g}, cost", tried / before))
        rolled = all_rolled(windows, values, derivatives=True)
        if tried > before * (1.0 - _ENOUGH):
            break
    return values, parts_of(rolled, [median_norms(rollout) for rollout in rolled])


def _moved(
    first: RolloutModel, free: npt.NDArray[np.bool_], values: Array, covariance: Array, remark: str
) -> RolloutModel:
    """The model with other parameters, but for those of sensors, with which roll-outs began."""
    together = np.where(free | free[:, np.newaxis], 0.0, first.covariance)
    together[np.ix_(free, free)] = covariance
    parameters = np.where(free, values, first.parameters)
    return replace(first, parameters=parameters, covariance=together, remark=remark)


def _first_step(
    first: RolloutModel, left_out: Sequence[RolloutModel], log: Sequence[FitStep], why: str
) -> MultiStepFit:
    remark = f"parameters of the wrench; fitting them to errors ahead was not used: {why}"
    model, *others = (replace(own, remark=remark) for own in (first, *left_out))
    return MultiStepFit(model, tuple(others), 0.0, (*log, FitStep("multi-step fit", f"not used: {why}", 1.0)))


# Between the starts that calibrate [s].
_CALIBRATION_EVERY_S = 0.5
# Horizons [s] over which the shape of tubes is chosen, and the share of misses: those of the goals.
_SHAPED_S, _MISS_SHARE = (0.1, 0.5), 0.05
# Least variance of a measured state, for flights without any noise.
_LEAST_VARIANCE = 1e-16
# Kernels release the interpreter.
_ANGLES = slice(INPUT_INDEX["sin_phi"], INPUT_INDEX["cos_theta"] + 1)


def calibrated_rollouts(
    flights: Sequence[RolloutFlight],
    vehicle: Vehicle,
    whole: PhysicalFit,
    left_out: Sequence[PhysicalFit],
    *,
    multi_step: bool,
) -> tuple[RolloutModel | None, tuple[FitStep, ...]]:
    """A model that predicts ahead, its tubes calibrated on flights that the parameters did not see.

    Args:
        flights: of the vehicle.
        vehicle: that flew.
        whole: fit to all of them.
        left_out: fits without each of them; with a single flight, that of all.
        multi_step: fit the parameters to errors of predictions ahead as well.

    Returns:
        The model, None where no flight is as long as the longest horizon, and the log of its fit.
    """
    used = [k for k, own in enumerate(flights) if own.time[-1] - own.time[0] > 1.1 * HORIZONS_S[-1]]
    if not used:
        return None, ()
    long, every = [flights[k] for k in used], range(len(used))

    def bare(fit: PhysicalFit) -> RolloutModel:
        body, delay_s = (fit.values, fit.covariance, fit.vehicle, fit.inertia), fit.sensing.rotor_delay_s
        nothing, variance = Disturbance.nothing(long[0].step), np.full(STATES, _LEAST_VARIANCE)
        return RolloutModel(*body, vehicle.gravity_m_s2, delay_s, nothing, variance)

    apart: Sequence[RolloutModel] = [bare(left_out[k]) for k in used]
    processes = []
    for k in every:
        others = [j for j in every if j != k] or [k]
        processes.append(disturbance_left([apart[j] for j in others], [long[j] for j in others]))
    final = replace(bare(whole), disturbance=disturbance_left(apart, long))
    log: tuple[FitStep, ...] = ()
    if multi_step:
        problem = Problem.from_vehicle(vehicle, float(whole.vehicle["reference_thrust"][0]))
        with identifiable("the parameters, from errors of predictions ahead,"):
            final, apart, _, log = fit_multi_step(long, final, apart, problem)
    variance = _measured_variance(apart, long)

    def rolled(k: int) -> FlightRollouts:
        model = replace(apart[k], disturbance=processes[k], measured_variance=variance)
        horizons, between = horizon_steps(HORIZONS_S, long[k].step), _CALIBRATION_EVERY_S / long[k].step
        return model.roll(long[k], long[k].starts(int(horizons[-1]), max(1, round(between))), horizons)

    with ThreadPoolExecutor(_THREADS) as threads:
        ahead = list(threads.map(rolled, every))
    for flight, rollouts in zip(long, ahead, strict=True):
        with identifiable(f"{flight.name}: the width of predictions ahead"):
            tube_scores(rollouts.errors, rollouts.covariance)
    ahead = [rollouts for rollouts in ahead if len(rollouts.starts)]
    if not ahead:
        return None, log
    # The shape is that of the tubes that are narrowest over the horizons that flights are judged at.
    judged = [k for k, horizon in enumerate(HORIZONS_S) if _SHAPED_S[0] <= horizon <= _SHAPED_S[1]]
    following = Following(
        [math.ceil(HORIZONS_S[k] / _CALIBRATION_EVERY_S) for k in judged],
        _MISS_SHARE,
        TRACKING_PER_S * _CALIBRATION_EVERY_S,
    )
    with identifiable("the width of predictions ahead"):
        errors, covariances = [one.errors for one in ahead], [one.covariance for one in ahead]
        shape = chosen_shape(
            [one[:, judged] for one in errors], [one[:, judged] for one in covariances], following
        )
        calibration = TubeCalibration.of_flights(
            [tube_scores(one, shape.shaped(sizes)) for one, sizes in zip(errors, covariances, strict=True)],
            [error_norms(one) for one in errors],
            shape,
        )
    return replace(final, measured_variance=variance, calibration=calibration), log


def _measured_variance(models: Sequence[RolloutModel], flights: Sequence[RolloutFlight]) -> Array:
    """Variance (12,) of a measured state: half that of the errors after one sample, as two states err."""
    errors = []
    for model, flight in zip(models, flights, strict=True):
        track, starts = model.track(flight), flight.starts(1, 1)
        errors.append(roll_out(track, starts, np.array([1]), model.moving, derivatives=False).errors[:, 0])
    # Of the median, since single samples of a log may be wild.
    deviation = 1.4826 * np.median(np.abs(np.concatenate(errors)), axis=0)
    return np.maximum(0.5 * np.square(deviation), _LEAST_VARIANCE)


def rollout_flights(samples: TrainingSamples) -> list[RolloutFlight]:
    """The flights of training samples; heading, which the input vector lacks, follows from the rates."""
    flights = []
    for k, own in enumerate(flights_of(samples)):
        angles = samples.inputs[thinned_rows(samples, k)][:, _ANGLES]
        attitude = _with_heading(_level_attitude(angles), own.motion["rates"], own.time)
        flights.append(RolloutFlight(own.name, own.time, attitude, own.motion, own.wrench))
    return flights


def _level_attitude(angles: Array) -> Array:
    """Quaternions (N, 4) of sin φ, cos φ, sin θ, cos θ (N, 4) and heading zero."""
    roll = 0.5 * np.arctan2(angles[:, 0], angles[:, 1])
    pitch = 0.5 * np.arctan2(angles[:, 2], angles[:, 3])
    (sin_roll, cos_roll), (sin_pitch, cos_pitch) = ((np.sin(angle), np.cos(angle)) for angle in (roll, pitch))
    parts = cos_roll * cos_pitch, sin_roll * cos_pitch, cos_roll * sin_pitch, -sin_roll * sin_pitch
    return np.stack(parts, axis=1)


def _with_heading(attitude: Array, rates: Array, time: Array) -> Array:
    """Attitudes (N, 4) turned about the vertical so that they follow rates (N, 3)."""
    turns = from_rotation_vector(0.5 * np.diff(time)[:, np.newaxis] * (rates[:-1] + rates[1:]))
    # The turn about the vertical that brings the next attitude nearest to the one that the rates give.
    between = products(products(attitude[:-1], turns), inverses(attitude[1:]))
    half = np.concatenate(([0.0], np.cumsum(np.arctan2(between[:, 3], between[:, 0]))))
    heading = np.stack((np.cos(half), np.zeros_like(half), np.zeros_like(half), np.sin(half)), axis=1)
    return products(heading, attitude)
