# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the compiled evaluation of the physical model takes: motions, and the model as records."""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import vehicle_constants, whole_derivatives
from quadpi_core.models.physical_regressors import MotionSample, PhysicalVehicle
from quadpi_core.records import ROTORS_MAX, Records, record_dtype
from quadpi_core.vehicle import Vehicle


class _Axis:
    """One axis: number of terms that act on it, 0 where it is not held; κ, γ and size of its spread."""

    size: int
    inflation: float
    growth: float
    rms_spread: float


class Common:
    """Records of a fixed size: what the axes share, and the axes."""

    vehicle: PhysicalVehicle
    controls: Annotated[Array, 3, ROTORS_MAX]  # signs that gave U_p, U_q and U_r of the rotor speeds
    delay_s: float  # that rotor speeds act after they were measured
    axes: Annotated[Records, _Axis, len(AXES)]


class _Kept:
    """A term in the model: its number, and its parameter."""

    number: int
    value: float


# The first of four rotors.
COMMON, KEPT = record_dtype(Common, 4), record_dtype(_Kept)


class PackedPhysical(NamedTuple):
    """All axes for `Physical` of the compiled core.

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
    motion = np.zeros(len(inputs), record_dtype(MotionSample, vehicle.rotor_count))
    derivatives = whole_derivatives(derivatives)
    compiled.read_motions(np.ascontiguousarray(inputs), derivatives, vehicle_constants(vehicle), motion)
    return motion


def delayed(speed: Any, acceleration: Any, jerk: Any, delay_s: float) -> tuple[Any, Any]:
    """Rotor speed and acceleration as they were some time ago, by Taylor's series from now."""
    return speed - delay_s * (acceleration - 0.5 * delay_s * jerk), acceleration - delay_s * jerk
