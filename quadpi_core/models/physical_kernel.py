# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled evaluation of the physical model: its wrench, and leverage and spread of each axis."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.compiled import njit
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import vehicle_constants
from quadpi_core.models.physical_regressors import MOTION, REGRESSORS, PhysicalVehicle, fill_regressors
from quadpi_core.records import Records, record_dtype
from quadpi_core.vehicle import ROTORS, Vehicle


class _Axis:
    """One axis: number of terms that act on it, 0 where it is not held; κ, γ and size of its spread."""

    size: int
    inflation: float
    growth: float
    rms_spread: float


class _Common:
    """Records of a fixed size: what the axes share, and the axes."""

    vehicle: PhysicalVehicle
    controls: Annotated[Array, 3, ROTORS]  # signs that gave U_p, U_q and U_r of the rotor speeds
    delay_s: float  # that rotor speeds act after they were measured
    axes: Annotated[Records, _Axis, len(AXES)]


class _Kept:
    """A term in the model: its number, and its parameter."""

    number: int
    value: float


COMMON, KEPT = record_dtype(_Common), record_dtype(_Kept)


class PackedPhysical(NamedTuple):
    """All axes for :func:`evaluate_physical`, which takes them one by one: a tuple costs a call 3 µs more.

    Attributes:
        common: (1,) of COMMON.
        kept: (T,) of KEPT, the terms in the model.
        acting: (6, S) numbers of the terms that act on an axis.
        whitening: (6, S, S) lower triangular Wᵀ with leverage h = |W z|².
    """

    common: Records
    kept: Records
    acting: npt.NDArray[np.int64]
    whitening: Array


def motions(inputs: Array, derivatives: Records, vehicle: Vehicle) -> Records:
    """Motion MOTION (N,) of input vectors (N, 19) and derivatives (N,), rotor speeds not delayed."""
    motion = np.zeros(len(inputs), MOTION)
    _read_all(inputs, derivatives, vehicle_constants(vehicle)["control_signs"][0], motion)
    return motion


@njit(cache=True)
def _read_all(inputs: Array, derivatives: Records, controls: Array, motion: Records) -> None:
    for i in range(len(inputs)):
        _read_motion(inputs[i], derivatives[i], controls, 0.0, motion[i])


@njit(cache=True)
def _read_motion(inputs: Array, derivatives: Any, controls: Array, delay_s: float, motion: Any) -> None:
    """Motion of an input vector (19,) and derivatives.

    ω_avg is a root mean square and the controls are orthogonal sums of the rotor speeds, so that
    Σω = √(16 ω_avg² − U_p² − U_q² − U_r²), and each rotor's speed is a quarter of the signed sums.
    """
    total = 16.0 * inputs[7] ** 2 - inputs[12] ** 2 - inputs[13] ** 2 - inputs[14] ** 2
    total = np.sqrt(max(total, 0.0))
    for axis in range(3):
        motion.velocity[axis] = inputs[axis]
        motion.rates[axis] = inputs[4 + axis]
        motion.angular_acceleration[axis] = derivatives.angular_acceleration[axis]
    for rotor in range(ROTORS):
        speed = total
        for control in range(3):
            speed += controls[control, rotor] * inputs[12 + control]
        speed, acceleration = delayed(
            0.25 * speed, derivatives.rotor_accelerations[rotor], derivatives.rotor_jerks[rotor], delay_s
        )
        motion.rotor_speeds[rotor] = max(speed, 0.0)
        motion.rotor_accelerations[rotor] = acceleration


@njit(cache=True)
def delayed(speed: Any, acceleration: Any, jerk: Any, delay_s: float) -> tuple[Any, Any]:
    """Rotor speed and acceleration as they were some time ago, by Taylor's series from now."""
    return speed - delay_s * (acceleration - 0.5 * delay_s * jerk), acceleration - delay_s * jerk


@njit(cache=True)
def evaluate_physical(
    inputs: Array,
    derivatives: Records,
    common: Records,
    kept: Records,
    acting: npt.NDArray[np.int64],
    whitening: Array,
    factors: Array,
    out: Array,
) -> None:
    """Fill predicted, lower, upper, leverage and relative width of `out` (5, N, 6) for the axes held.

    Args:
        inputs: (N, 19).
        derivatives: (N,).
        common: as the next three, see :class:`PackedPhysical`.
        kept: of it.
        acting: of it.
        whitening: of it.
        factors: (6,) half width of the intervals per spread.
        out: to fill.
    """
    model = common[0]
    motion, row = np.zeros(1, MOTION), np.zeros(1, REGRESSORS)
    values = row.view(np.float64)
    wrench, whitened = np.zeros(6), np.zeros(whitening.shape[1])
    for i in range(inputs.shape[0]):
        values[:] = 0.0
        _read_motion(inputs[i], derivatives[i], model.controls, model.delay_s, motion[0])
        fill_regressors(motion[0], model.vehicle, row[0])
        _predict(kept, values, wrench)
        speed_squared = inputs[i, 0] ** 2 + inputs[i, 1] ** 2 + inputs[i, 2] ** 2
        for axis in range(6):
            fitted = model.axes[axis]
            if fitted.size == 0:
                continue
            whitened[:] = 0.0
            for b in range(fitted.size):
                z = values[6 * acting[axis, b] + axis]
                for a in range(b + 1):
                    whitened[a] += whitening[axis, b, a] * z
            leverage = 0.0
            for a in range(fitted.size):
                leverage += whitened[a] * whitened[a]
            spread = np.sqrt(1.0 + fitted.inflation * leverage + fitted.growth * speed_squared)
            out[0, i, axis] = wrench[axis]
            out[1, i, axis] = wrench[axis] - factors[axis] * spread
            out[2, i, axis] = wrench[axis] + factors[axis] * spread
            out[3, i, axis] = leverage
            out[4, i, axis] = spread / fitted.rms_spread


@njit(cache=True)
def _predict(kept: Records, values: Array, wrench: Array) -> None:
    wrench[:] = 0.0
    for k in range(len(kept)):
        for axis in range(6):
            wrench[axis] += kept[k].value * values[6 * kept[k].number + axis]
