# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Input vectors that look like flight: smooth, correlated over time and within the vehicle's range."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from quadpi_core.frames import Array
from quadpi_core.inputs import aerodynamic_inputs
from quadpi_core.vehicle import Vehicle

# Samples between the knots of the splines; the motion is correlated over about as many.
_KNOT_SAMPLES = 12


def smooth_inputs(count: int, seed: int, vehicle_name: str = "hdbeetle") -> Array:
    """Inputs X (count, 19) of a vehicle whose state and rotor speeds follow random splines."""
    vehicle = Vehicle.load(vehicle_name)
    rng = np.random.default_rng(seed)
    velocity = _smooth(rng, count, 3) * [5.0, 3.0, 2.0]
    rates = _smooth(rng, count, 3) * [2.0, 2.0, 1.0]
    yaw_pitch_roll = _smooth(rng, count, 3) * [1.5, 0.4, 0.4]
    attitude = Rotation.from_euler("ZYX", yaw_pitch_roll).as_quat(scalar_first=True)
    hover = 0.4 * vehicle.rotor_speed_max_rad_s
    rotor_speeds = hover * (1.0 + 0.15 * np.tanh(_smooth(rng, count, 4)))
    return aerodynamic_inputs(velocity, attitude, rates, rotor_speeds, vehicle)


def planted_target(regressors: Array, n_fixed: int, terms: int, seed: int) -> Array:
    """Target (N,) of random columns beyond the fixed ones, each of weight 0.5 to 2, in unit noise."""
    rng = np.random.default_rng(seed)
    planted = rng.choice(np.arange(n_fixed, regressors.shape[1]), size=terms, replace=False)
    columns = regressors[:, planted] / regressors[:, planted].std(axis=0)
    target: Array = columns @ rng.uniform(0.5, 2.0, size=terms) + rng.normal(size=len(regressors))
    return target


def _smooth(rng: np.random.Generator, count: int, columns: int) -> Array:
    knots = np.arange(0, count + 2 * _KNOT_SAMPLES, _KNOT_SAMPLES)
    smooth: Array = CubicSpline(knots, rng.normal(size=(len(knots), columns)))(np.arange(count))
    return smooth
