# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights as the physical model is fitted to them, and what lies between a wrench and its measurement."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.core import compiled
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES, mean_rate_hz
from quadpi_core.frames import Array
from quadpi_core.inputs import vehicle_constants, whole_derivatives
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.physical_regressors import MotionSample, PhysicalVehicle, regressors, wrenches
from quadpi_core.models.physical_terms import TERMS
from quadpi_core.records import ROTORS_MAX, Records, record_dtype
from quadpi_core.signals.wrench import band_limited
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


# Samples that are fitted [Hz], about: signals have passed a low-pass at 30 Hz.
_FIT_HZ = 100.0
# Time in the air below which a flight tells no delay or bandwidth [s].
SHORTEST_S = 1.0
# Delays of the rotor speeds that are tried [s]: NeuroBEM has 2.5 ms, Crazyflies 7.5 ms. Beyond the last, the
# series of `physical_kernel.delayed` is wrong by a third at 15 Hz, up to which moments follow rotor speeds.
DELAYS_S = (0.0, 0.0025, 0.005, 0.0075, 0.01, 0.0125, 0.015)
# Samples whose regressors are held at a time: 28 MB.
_PART = 6000
FORCE, MOMENT = slice(0, 3), slice(3, 6)
# Terms with a force.
_PUSHING = np.array([not term.unit.startswith(("Nm", "kg")) for term in TERMS])


@dataclass(frozen=True)
class Sensing:
    """What lies between the wrench on the vehicle and its measurement.

    Attributes:
        rotor_delay_s: that rotor speeds act after they were measured.
        force_bandwidth_hz: of the measured force, where it ends below that of the other signals.
    """

    rotor_delay_s: float = 0.0
    force_bandwidth_hz: float | None = None


@dataclass(frozen=True)
class PhysicalFlight:
    """Samples of a flight that the physical model is fitted to.

    Attributes:
        name: of the flight.
        time: (N,) s.
        motion: MOTION (N,), rotor speeds not delayed.
        rotor_jerks: (N, rotors) rad/s³.
        wrench: (N, 6) measured, N and Nm.
    """

    name: str
    time: Array
    motion: Records
    rotor_jerks: Array
    wrench: Array

    @property
    def rate_hz(self) -> float:
        """Mean sample rate, without holes."""
        return mean_rate_hz(self.time)

    def cut(self, keep: slice) -> PhysicalFlight:
        """Some of the samples."""
        arrays = {name: getattr(self, name)[keep] for name in ("time", "motion", "rotor_jerks", "wrench")}
        return replace(self, **arrays)

    def parts(self) -> Iterator[PhysicalFlight]:
        """The flight in parts whose regressors fit into memory."""
        count = -(-len(self.time) // _PART)
        ends = np.linspace(0, len(self.time), count + 1).astype(int)
        return (self.cut(slice(start, end)) for start, end in itertools.pairwise(ends))

    def delayed(self, delay_s: float) -> PhysicalFlight:
        """The flight with rotor speeds as they were so much earlier."""
        motion = self.motion.copy()
        motion["rotor_speeds"], motion["rotor_accelerations"] = delayed(
            self.motion["rotor_speeds"], self.motion["rotor_accelerations"], self.rotor_jerks, delay_s
        )
        return replace(self, motion=motion)

    def recorded(self, forces: Array, sensing: Sensing) -> Array:
        """Forces (N, 3, K) in body axes as they would have been recorded."""
        return band_limited(self.time, self.motion["rates"], forces, sensing.force_bandwidth_hz)

    def regressors(self, vehicle: Records, sensing: Sensing) -> Array:
        """Regressors (N, P, 6) of the wrench as it would have been recorded, for a PHYSICAL_VEHICLE (1,)."""
        z = regressors(self.delayed(sensing.rotor_delay_s).motion, vehicle)
        if sensing.force_bandwidth_hz is not None:
            forces = np.ascontiguousarray(z[:, _PUSHING, FORCE].transpose(0, 2, 1))
            z[:, _PUSHING, FORCE] = self.recorded(forces, sensing).transpose(0, 2, 1)
        return z

    def errors(self, values: Array, vehicle: Records, sensing: Sensing) -> Array:
        """Measured less predicted wrench (N, 6), as recorded, for parameters (P,)."""
        predicted = wrenches(self.delayed(sensing.rotor_delay_s).motion, vehicle, values)
        predicted[:, FORCE] = self.recorded(predicted[:, FORCE, np.newaxis], sensing)[:, :, 0]
        return self.wrench - predicted


def thinned_rows(samples: TrainingSamples, flight: int) -> npt.NDArray[np.int64]:
    """Samples of a flight that leave about 100 Hz.

    Raises:
        ModelError: naming the flight, for one that is too short.
    """
    rows = np.flatnonzero(samples.flight == flight)
    time = samples.time[rows]
    if len(rows) < 2 or time[-1] - time[0] < SHORTEST_S:
        name = samples.names[flight]
        raise ModelError(f"{name}: the physical model needs {SHORTEST_S:g} s or more in the air")
    return rows[:: max(1, round(mean_rate_hz(time) / _FIT_HZ))]


def flights_of(samples: TrainingSamples) -> list[PhysicalFlight]:
    """The flights of training samples, thinned to about 100 Hz.

    Raises:
        ModelError: naming the flight, for one that is too short.
    """
    flights = []
    for k, name in enumerate(samples.names):
        rows = thinned_rows(samples, k)
        derivatives = samples.derivatives[rows]
        motion = motions(samples.inputs[rows], derivatives, samples.vehicle)
        jerks = derivatives["rotor_jerks"]
        flights.append(PhysicalFlight(name, samples.time[rows], motion, jerks, samples.wrench[rows]))
    return flights


def reference_thrust(flights: Sequence[PhysicalFlight]) -> float:
    """Thrust of a rotor over the square of its speed [N s²], by least squares of the measured thrust.

    Raises:
        ModelError: where thrust does not grow with the rotor speeds.
    """
    squares = np.concatenate([np.sum(np.square(f.motion["rotor_speeds"]), axis=1) for f in flights])
    thrust = np.concatenate([-f.wrench[:, 2] for f in flights])
    coefficient = float(squares @ thrust / max(float(squares @ squares), 1.0))
    if not coefficient > 0.0:
        raise ModelError(f"{flights[0].name}: the measured force does not point up while the rotors turn")
    return coefficient
