# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Roll-outs of an identified physical model, calibrated on flights that its parameters did not see."""

from __future__ import annotations

import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX
from quadpi_core.models.disturbance import Disturbance
from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.least_squares import identifiable
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.multi_step_fit import fit_multi_step
from quadpi_core.models.physical_fit import FitStep, Problem
from quadpi_core.models.physical_flight import flights_of, thinned_rows
from quadpi_core.models.physical_rollout import STATES, roll_out
from quadpi_core.models.rollout_flight import RolloutFlight, horizon_steps
from quadpi_core.models.rollout_model import FlightRollouts, RolloutModel, disturbance_left
from quadpi_core.models.tubes import (
    HORIZONS_S,
    TRACKING_PER_S,
    Following,
    TubeCalibration,
    TubeShape,
    chosen_shape,
    error_norms,
    tube_scores,
)
from quadpi_core.rotations import from_rotation_vectors, inverses, products
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


class CalibratedRollouts(NamedTuple):
    """A model that predicts ahead, None where no flight is as long as the longest horizon; log of its fit."""

    model: RolloutModel | None
    log: tuple[FitStep, ...]


def calibrated_rollouts(
    flights: Sequence[RolloutFlight],
    vehicle: Vehicle,
    whole: PhysicalFit,
    left_out: Sequence[PhysicalFit],
    *,
    multi_step: bool,
) -> CalibratedRollouts:
    """A model that predicts ahead, its tubes calibrated on flights that the parameters did not see.

    Args:
        flights: of the vehicle.
        vehicle: that flew.
        whole: fit to all of them.
        left_out: fits without each of them; with a single flight, that of all.
        multi_step: fit the parameters to errors of predictions ahead as well.
    """
    long = [k for k, flight in enumerate(flights) if flight.time[-1] - flight.time[0] > 1.1 * HORIZONS_S[-1]]
    if not long:
        return CalibratedRollouts(None, ())
    headed = [flights[k] for k in long]
    step = headed[0].step
    bare = [_uncalibrated(left_out[k], vehicle, Disturbance.nothing(step)) for k in long]
    processes = []
    for k in range(len(bare)):
        others = [j for j in range(len(bare)) if j != k] or [k]
        processes.append(disturbance_left([bare[j] for j in others], [headed[j] for j in others]))
    final = _uncalibrated(whole, vehicle, disturbance_left(bare, headed))
    log: tuple[FitStep, ...] = ()
    if multi_step:
        problem = Problem.of(vehicle, float(whole.vehicle["reference_thrust"][0]))
        with identifiable("the parameters, from errors of predictions ahead,"):
            found = fit_multi_step(headed, final, bare, problem)
        final, bare, log = found.model, list(found.left_out), found.log
    variance = _measured_variance(bare, headed)
    models = [
        replace(model, disturbance=process, measured_variance=variance)
        for model, process in zip(bare, processes, strict=True)
    ]

    def rolled(model: RolloutModel, flight: RolloutFlight) -> FlightRollouts:
        horizons, every = horizon_steps(HORIZONS_S, flight.step), round(_CALIBRATION_EVERY_S / flight.step)
        return model.roll(flight, flight.starts(int(horizons[-1]), max(1, every)), horizons)

    with ThreadPoolExecutor(_THREADS) as threads:
        rolled_flights = list(threads.map(rolled, models, headed))
    of_flights = [own for own in rolled_flights if len(own.starts)]
    if not of_flights:
        return CalibratedRollouts(None, log)
    for flight, own in zip(headed, rolled_flights, strict=True):
        with identifiable(f"{flight.name}: the width of predictions ahead"):
            tube_scores(own.errors, own.covariance)
    with identifiable("the width of predictions ahead"):
        shape = _narrowest(of_flights)
        calibration = TubeCalibration.of_flights(
            [tube_scores(own.errors, shape.shaped(own.covariance)) for own in of_flights],
            [error_norms(own.errors) for own in of_flights],
            shape,
        )
    return CalibratedRollouts(replace(final, measured_variance=variance, calibration=calibration), log)


def _narrowest(flights: Sequence[FlightRollouts]) -> TubeShape:
    """The shape of tubes that is narrowest at 95 % over the horizons that flights are judged at."""
    judged = [k for k, horizon in enumerate(HORIZONS_S) if _SHAPED_S[0] <= horizon <= _SHAPED_S[1]]
    delays = [math.ceil(HORIZONS_S[k] / _CALIBRATION_EVERY_S) for k in judged]
    return chosen_shape(
        [own.errors[:, judged] for own in flights],
        [own.covariance[:, judged] for own in flights],
        Following(delays, _MISS_SHARE, TRACKING_PER_S * _CALIBRATION_EVERY_S),
    )


def _uncalibrated(fit: PhysicalFit, vehicle: Vehicle, disturbance: Disturbance) -> RolloutModel:
    body, delay_s = (fit.values, fit.covariance, fit.vehicle, fit.inertia), fit.sensing.rotor_delay_s
    variance = np.full(STATES, _LEAST_VARIANCE)
    return RolloutModel(*body, vehicle.gravity_m_s2, delay_s, disturbance, variance)


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
    return np.stack(
        (
            np.cos(roll) * np.cos(pitch),
            np.sin(roll) * np.cos(pitch),
            np.cos(roll) * np.sin(pitch),
            -np.sin(roll) * np.sin(pitch),
        ),
        axis=1,
    )


def _with_heading(attitude: Array, rates: Array, time: Array) -> Array:
    """Attitudes (N, 4) turned about the vertical so that they follow rates (N, 3)."""
    turns = from_rotation_vectors(0.5 * np.diff(time)[:, np.newaxis] * (rates[:-1] + rates[1:]))
    # The turn about the vertical that brings the next attitude nearest to the one that the rates give.
    between = products(products(attitude[:-1], turns), inverses(attitude[1:]))
    half = np.concatenate(([0.0], np.cumsum(np.arctan2(between[:, 3], between[:, 0]))))
    heading = np.stack((np.cos(half), np.zeros_like(half), np.zeros_like(half), np.sin(half)), axis=1)
    return products(heading, attitude)
