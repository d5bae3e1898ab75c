# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Roll-outs of an identified physical model, calibrated on flights that its parameters did not see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from quadpi_core.frames import Array, from_rotation_vector, inverses, products
from quadpi_core.inputs import INPUT_INDEX
from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.least_squares import identifiable
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.multi_step_fit import fit_multi_step
from quadpi_core.models.physical_fit import FitStep, Problem
from quadpi_core.models.physical_flight import flights_of, thinned_rows
from quadpi_core.models.physical_rollout import STATES, Disturbance, roll_out
from quadpi_core.models.rollout_model import (
    FlightRollouts,
    RolloutFlight,
    RolloutModel,
    disturbance_left,
    horizon_steps,
)
from quadpi_core.models.tubes import (
    HORIZONS_S,
    TRACKING_PER_S,
    Following,
    TubeCalibration,
    chosen_shape,
    error_norms,
    tube_scores,
)
from quadpi_core.vehicle import Vehicle

# Between the starts that calibrate [s].
_CALIBRATION_EVERY_S = 0.5
# Horizons [s] over which the shape of tubes is chosen, and the share of misses: those of the goals.
_SHAPED_S, _MISS_SHARE = (0.1, 0.5), 0.05
# Least variance of a measured state, for flights without any noise.
_LEAST_VARIANCE = 1e-16
# Kernels release the interpreter.
_THREADS = 2
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
