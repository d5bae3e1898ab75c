# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The fitted physical model: parameters by weighted least squares of all axes, and how well they are known.

The measured wrench of all flights and axes is a linear function of the parameters, given the delay of the
rotor speeds and the bandwidth of the force measurement. The parameters are the maximum a posteriori: errors
weigh by their deviation on each axis and by how many independent samples they are worth, the spreads of
`physical_terms` are the prior (Jategaonkar, Flight Vehicle System Identification, 2015, 6 and 11).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, reduce
from operator import add, sub
from typing import Annotated, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import Real, Text
from quadpi_core.core import compiled
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES, mean_rate_hz
from quadpi_core.frames import Array
from quadpi_core.inputs import vehicle_constants, whole_derivatives
from quadpi_core.models.model_kind import TrainingSamples
from quadpi_core.models.physical_terms import (
    TERM_NAMES,
    TERMS,
    MotionSample,
    PhysicalVehicle,
    acting_terms,
    regressors,
    scales,
    wrenches,
)
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
    """Indices that thin a flight to about 100 Hz.

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


# Longest time [s] over which errors may be correlated.
_LONGEST_LAG_S = 5.0
# Lower bound on the effective sample rate [1/s], so that a biased axis keeps weight in the fit; standard
# errors use the true value.
_FEWEST_INDEPENDENT_HZ = 1.0
# A bound holds within this share of the prior spread; what is said of it.
_WITHIN = 1e-6
AT_BOUND = "at its lower bound, 0"
# Standard deviation of the thrust of a flight over that of others at the same rotor speeds, before there are
# flights to tell, and how many flights that is worth. A NeuroBEM flight of another day has 3 % less, five of
# an indiflight quadrotor spread by 2.6 %; 3 °C or 10 hPa are 1 %. Set with the NeuroBEM flights in view.
_THRUST_OF_A_FLIGHT, _WORTH_FLIGHTS = 0.03, 2.0
# Least deviation of an axis, for flights without any error.
LEAST = 1e-12


@cache
def _felt_terms() -> npt.NDArray[np.bool_]:
    """Which axes (P, 6) of a recording each term reaches: smoothing in the world mixes those of forces."""
    felt = acting_terms().copy()
    felt[:, FORCE] = np.any(felt[:, FORCE], axis=1, keepdims=True)
    return felt


@dataclass(frozen=True)
class Information:
    """Sums over the samples of a flight, each axis by itself: all that least squares needs.

    Attributes:
        matrix: (6, P, P) Σ z zᵀ of the regressors.
        moment: (6, P) Σ z y.
        square: (6,) Σ y².
        count: number of samples.
    """

    matrix: Array
    moment: Array
    square: Array
    count: int

    @classmethod
    def from_samples(cls, z: Array, wrench: Array) -> Information:
        """Of regressors (N, P, 6) and the measured wrench (N, 6)."""
        matrix, moment = np.zeros((len(AXES), len(TERMS), len(TERMS))), np.zeros((len(AXES), len(TERMS)))
        for axis, acting in enumerate(_felt_terms().T):
            columns = z[:, acting, axis]
            matrix[axis][np.ix_(acting, acting)] = columns.T @ columns
            moment[axis, acting] = wrench[:, axis] @ columns
        return cls(matrix, moment, np.sum(np.square(wrench), axis=0), len(wrench))

    def __add__(self, other: Information) -> Information:
        return Information(*map(add, vars(self).values(), vars(other).values()))

    def __sub__(self, other: Information) -> Information:
        return Information(*map(sub, vars(self).values(), vars(other).values()))

    def rmse(self, values: Array) -> Array:
        """Root-mean-square error (6,) with parameters (P,)."""
        explained = np.einsum("p,apq,q->a", values, self.matrix, values)
        squares = self.square - 2.0 * self.moment @ values + explained
        return np.sqrt(np.maximum(squares, 0.0) / self.count)


@dataclass(frozen=True)
class FitStep:
    """A step of the fit.

    Attributes:
        step: what was tried or done.
        of: with what: a delay, a bandwidth, a group of terms.
        error: that it gave, or what it changed.
    """

    step: Text
    of: str
    error: Real


@dataclass(frozen=True)
class Weights:
    """Weights of squared errors by axis.

    Attributes:
        deviation: (6,) of the errors.
        independent: (6,) share of the samples that are independent.
        fewest: share that an axis weighs by at least.
    """

    deviation: Array
    independent: Array
    fewest: float

    @classmethod
    def start(cls, information: Sequence[Information]) -> Weights:
        """From the measured wrench, before there are errors: a tenth of its size."""
        sums = total(information)
        deviation = np.maximum(0.1 * np.sqrt(sums.square / sums.count), LEAST)
        return cls(deviation, np.full(len(AXES), 0.01), 0.0)

    @classmethod
    def of_errors(cls, errors: Sequence[Array], rate_hz: float) -> Weights:
        """From the errors (N, 6) of flights, sampled at `rate_hz`."""
        together = np.concatenate(errors)
        deviation = np.sqrt(np.mean(np.square(together), axis=0))
        lags = round(_LONGEST_LAG_S * rate_hz)
        share = np.array(
            [_independent_share([e[:, axis] for e in errors], lags) for axis in range(len(AXES))]
        )
        return cls(np.maximum(deviation, LEAST), share, _FEWEST_INDEPENDENT_HZ / rate_hz)

    @property
    def share(self) -> Array:
        """Share (6,) of the samples that count as independent, by axis."""
        return np.maximum(self.independent, self.fewest)

    @property
    def weight(self) -> Array:
        """Of a squared error of each axis (6,)."""
        return self.share / np.square(self.deviation)


@dataclass(frozen=True)
class Problem:
    """Prior and bounds: mean, spread and lower bound (P,) of the parameters, SI."""

    mean: Array
    spread: Array
    lower: Array

    @classmethod
    def from_vehicle(cls, vehicle: Vehicle, reference: float) -> Problem:
        """Of a vehicle whose rotors have a thrust per ω² of about `reference` [N s²]."""
        scale = scales(vehicle, reference)
        return cls(
            np.array([term.mean for term in TERMS]) * scale,
            np.array([term.spread for term in TERMS]) * scale,
            np.array([0.0 if term.positive else -np.inf for term in TERMS]),
        )

    def solve(
        self, information: Sequence[Information], weighing: Weights, kept: npt.NDArray[np.bool_]
    ) -> Array:
        """Parameters (P,); zero where not kept."""
        matrix, right = self._normal(total(information), weighing, kept)
        change = bounded_solution(matrix, right, (self.lower[kept] - self.mean[kept]) / self.spread[kept])
        values = np.zeros(len(TERMS))
        values[kept] = self.mean[kept] + self.spread[kept] * change
        return values

    def covariance(
        self, information: Sequence[Information], weighing: Weights, kept: npt.NDArray[np.bool_]
    ) -> Array:
        """Covariance (P, P) of the parameters of :meth:`solve`, for the effective number of errors.

        H⁻¹ (J + 1) H⁻¹ in units of the prior, H the normal matrix and J the covariance of its right side.
        """
        sums, spread = total(information), self.spread[kept]
        matrix, _ = self._normal(sums, weighing, kept)
        counted = weighing.weight * weighing.share / weighing.independent
        noise = np.einsum("a,apq->pq", counted, sums.matrix)[np.ix_(kept, kept)] * np.outer(spread, spread)
        inverse = np.linalg.inv(matrix)
        covariance = np.zeros((len(TERMS), len(TERMS)))
        covariance[np.ix_(kept, kept)] = (
            inverse @ (noise + np.eye(len(spread))) @ inverse * np.outer(spread, spread)
        )
        return covariance

    def _normal(
        self, sums: Information, weighing: Weights, kept: npt.NDArray[np.bool_]
    ) -> tuple[Array, Array]:
        """Normal equations of the terms kept: matrix (s, s), right side (s,), for (value - mean) / spread."""
        matrix = np.einsum("a,apq->pq", weighing.weight, sums.matrix)[np.ix_(kept, kept)]
        moment = np.einsum("a,ap->p", weighing.weight, sums.moment)[kept]
        spread, mean = self.spread[kept], self.mean[kept]
        right = spread * (moment - matrix @ mean)
        return matrix * np.outer(spread, spread) + np.eye(len(spread)), right


def bounded_solution(matrix: Array, right: Array, lower: Array) -> Array:
    """Least xᵀ M x / 2 - rᵀ x for a positive definite matrix (s, s), right side (s,) and bounds (s,)."""
    from scipy import linalg, optimize

    free: Array = linalg.cho_solve(linalg.cho_factor(matrix), right)
    if not np.any(free < lower):
        return free
    factor = np.linalg.cholesky(matrix)
    return optimize.lsq_linear(factor.T, np.linalg.solve(factor, right), bounds=(lower, np.inf)).x


def total(information: Iterable[Information]) -> Information:
    """The sums over all flights."""
    return reduce(add, information)


def _independent_share(errors: Sequence[Array], lags: int) -> float:
    """Share of samples that are independent: 1 over the integrated autocorrelation (Sokal's window)."""
    sums = np.zeros(lags)
    for series in errors:
        spectrum = np.abs(np.fft.rfft(series, 2 * len(series))) ** 2
        covariance = np.fft.irfft(spectrum)[: min(lags, len(series))]
        sums[: len(covariance)] += covariance
    if sums[0] <= 0.0:
        return 1.0
    time = 2.0 * np.cumsum(sums / sums[0]) - 1.0
    window = int(np.argmax(np.arange(len(time)) >= 5.0 * time)) or len(time) - 1
    return float(1.0 / max(time[window], 1.0))


def bounded_terms(values: Array, spreads: Array) -> list[str]:
    """Terms that physics keeps from becoming negative, of parameters (P,) with spreads (P,)."""
    return [
        term.name
        for term, value, spread in zip(TERMS, values, spreads, strict=True)
        if term.positive and value <= _WITHIN * spread
    ]


def worst_pairs(covariance: Array, count: int = 5) -> list[tuple[str, str, float]]:
    """The most correlated pairs of parameters of a covariance (P, P), with their correlation."""
    errors = np.sqrt(np.diag(covariance))
    fitted = np.flatnonzero(errors > 0.0)
    correlation = covariance[np.ix_(fitted, fitted)] / np.outer(errors[fitted], errors[fitted])
    rows, columns = np.triu_indices(len(fitted), 1)
    worst = np.argsort(-np.abs(correlation[rows, columns]))[:count]
    return [
        (TERM_NAMES[fitted[rows[i]]], TERM_NAMES[fitted[columns[i]]], float(correlation[rows[i], columns[i]]))
        for i in worst
    ]


def thrust_variance(changes: Sequence[float]) -> float:
    """Variance of the thrust from flight to flight, as a share squared.

    Args:
        changes: of flights left out, see `PhysicalFit.thrust_change`.
    """
    known = float(np.sum(np.square(changes)))
    return (_WORTH_FLIGHTS * _THRUST_OF_A_FLIGHT**2 + known) / (_WORTH_FLIGHTS + len(changes))
