# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Errors of predictions ahead over the flights that a model is fitted to, their cost and its derivatives.

Roll-outs start with the disturbance that the past tells, as predictions do, which takes away much of the
bias that a controller causes by answering slow disturbances with rotor speeds. Errors count by their norm, in
units of their median over the flight, so that no wild sample and no fast flight outweighs the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.frames import Array
from quadpi_core.models.disturbance import Disturbance
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
    def of(cls, flight: RolloutFlight, model: RolloutModel) -> Windows:
        """Of a flight whose predictions by the model are finite."""
        track = model.track(flight)
        horizons = horizon_steps(HORIZONS_S, track.step)
        starts = flight.starts(int(horizons[-1]), max(1, round(EVERY_S / track.step)))
        process = replace(model.disturbance, step_s=track.step)
        lead = model.lead(track.step)
        before = np.maximum(starts - lead, 0)
        aged = process.decay**lead
        windows = cls(
            track,
            starts,
            horizons,
            process.filtered(flight.wrench)[before] * aged,
            _filtered_regressors(track, model, process, before) * aged[:, np.newaxis],
            process.decay,
        )
        errors = windows.rolled(model.parameters, derivatives=False).errors
        fine = np.all(np.isfinite(errors), axis=(1, 2)) & np.all(np.isfinite(windows.predicted), axis=(1, 2))
        return windows._replace(
            starts=starts[fine], measured=windows.measured[fine], predicted=windows.predicted[fine]
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


def _filtered_regressors(
    track: Track, model: RolloutModel, process: Disturbance, rows: npt.NDArray[np.int64]
) -> Array:
    """Regressors (W, 6, P) filtered as a disturbance is, at samples (W,) that rise."""
    found = []
    before: Array | None = None
    for first in range(0, len(track.motion), _SAMPLES):
        own = regressors(track.motion[first : first + _SAMPLES], model.vehicle).transpose(0, 2, 1)
        filtered = process.filtered(own, before)
        found.append(filtered[rows[(rows >= first) & (rows < first + _SAMPLES)] - first])
        before = filtered[-1]
    return np.concatenate(found)


def _norms(rolled: Rolled) -> Array:
    """Norm (W, H, 4) of each quantity."""
    result: Array = np.stack([np.linalg.norm(rolled.errors[..., part], axis=-1) for part in _PARTS], axis=-1)
    return result


def median_norms(rolled: Rolled) -> Array:
    """Median norm (H, 4) of the errors of each horizon and quantity."""
    result: Array = np.maximum(np.median(_norms(rolled), axis=0), _LEAST)
    return result


def mean_norms(windows: Sequence[Windows], values: Sequence[Array]) -> Array:
    """Mean norm (F, H, 4) of the errors of flights by parameters of each."""
    rolled = [own.rolled(there, derivatives=False) for own, there in zip(windows, values, strict=True)]
    result: Array = np.maximum(np.stack([_norms(own).mean(axis=0) for own in rolled]), _LEAST)
    return result


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
    for (horizon, quantity), weight in np.ndenumerate(_WEIGHTS):
        if weight == 0.0:
            continue
        part, own = _PARTS[quantity], scale[horizon, quantity]
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
