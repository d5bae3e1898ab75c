# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Forces and moments of rotors and airframe, one set of parameters for all axes (see `physical_terms`)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from quadpi_core.bounded_files import parse_json
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import DERIVATIVES
from quadpi_core.models.fitted_physical import CompiledPhysical, FittedPhysical, PhysicalFit
from quadpi_core.models.fitted_polynomial import PlacedErrors, SpreadShape, fit_shape, squared_speed
from quadpi_core.models.interval_rules import NormalRule, calibrate, inside_range
from quadpi_core.models.model_kind import (
    Facts,
    Fit,
    FittedAxis,
    IdentifyOptions,
    Kind,
    Pools,
    RotorDelay,
    StoredAxes,
    TrainingSamples,
    option,
)
from quadpi_core.models.physical_advice import delay_words, missing_flying
from quadpi_core.models.physical_fit import (
    AT_BOUND,
    bounded_terms,
    thrust_variance,
    worst_pairs,
)
from quadpi_core.models.physical_flight import SHORTEST_S, flights_of, thinned_rows
from quadpi_core.models.physical_kernel import motions
from quadpi_core.models.physical_regressors import acting_terms, regressors
from quadpi_core.models.physical_study import DELAYS_S, PhysicalStudy
from quadpi_core.models.physical_terms import TERM_INDEX, TERM_NAMES, TERMS
from quadpi_core.models.rollout_identification import calibrated_rollouts, rollout_flights
from quadpi_core.models.rollout_model import MOVES, RolloutModel
from quadpi_core.parallel import Progress, ReportProgress, one_blas_thread
from quadpi_core.signals.force_bandwidth import as_recorded
from quadpi_core.vehicle import Vehicle

FIT_FILE, TABLE_FILE = "fit.json", "parameters.csv"
# Least variance of a direction of correlated parameters: hover leaves some that are known to 1e-13 of others.
_LEAST_VARIANCE = 1e-12
# Stride over the samples when recording the largest leverage and spread.
_PEAK_STEP = 8


@dataclass(frozen=True)
class Physical(Kind):
    """All axes by one set of physical parameters.

    Attributes:
        multi_step: fit the parameters that predict ahead a second time, to errors of predictions.
    """

    multi_step: bool = option(True, "Fit parameters that predict ahead to errors up to 0.5 s ahead.")

    name = FittedPhysical.method
    label = "physical model"
    colour = "#332288"
    normal_errors = True
    is_simulation = True
    uses_derivatives = True
    chooses_candidates = False
    shortest_s = SHORTEST_S
    axis_type = FittedPhysical

    def fit(
        self,
        samples: TrainingSamples,
        pools: Pools,
        options: IdentifyOptions,
        progress: ReportProgress,
    ) -> Fit:
        """Fit all axes together, then again without each flight.

        All axes are measured for that, also where `pools` has some of them.
        """
        for axis in dict.fromkeys((*pools, *AXES)):
            target = samples.target(axis)
            if np.all(target == target[0]):
                raise ModelError(f"{axis}: the target is constant: there is nothing to identify")
        flights = flights_of(samples)
        steps = len(flights) + 1
        progress(Progress("Identifying the physical model", 0, steps))
        with one_blas_thread():
            study = PhysicalStudy.of(flights, samples.vehicle)
            whole = study.fit(choose=True)
            left_out = []
            for k in range(len(flights)):
                progress(Progress("Identifying the physical model", k + 1, steps))
                left_out.append(study.fit(choose=True, left_out=k) if len(flights) > 1 else whole)
            progress(Progress("Calibrating predictions ahead", 0, 1))
            ahead, log_ahead = calibrated_rollouts(
                rollout_flights(samples), samples.vehicle, whole, left_out, multi_step=self.multi_step
            )
        whole, noise = replace(whole, log=(*whole.log, *log_ahead)), study.weighing.deviation
        every = range(len(flights))
        others = [[other for other in every if other != k] for k in every]
        # Shape and factor are those that these flights need. On a new flight thrust differs as a whole, which
        # they may not tell; that comes on top, so that the factor must not make up for it.
        plain = [_axes(fit, noise, pools) for fit in (whole, *left_out)]
        trained = [_placed(plain[0], samples, k) for k in every]
        placed = [_placed(plain[1 + k], samples, k, others[k]) for k in every]
        shapes = {
            axis: fit_shape([own[axis] for own in placed], most_inflation=len(samples.time)) for axis in pools
        }
        rules = {
            axis: calibrate(
                [own[axis].under(shape) for own in placed], [own[axis].under(shape) for own in trained]
            )
            for axis, shape in shapes.items()
        }
        quantile = NormalRule().factor(options.confidence)
        variance = thrust_variance(
            [fit.thrust_change(flight) for fit, flight in zip(left_out, flights, strict=True)]
        )
        thrusts = {
            axis: variance * np.square(quantile / rule.factor(options.confidence)) / shapes[axis].inflation
            for axis, rule in rules.items()
        }
        final, *apart = (_axes(fit, noise, pools, thrusts) for fit in (whole, *left_out))
        spread = [_placed(final, samples, k) for k in every]
        new = [_placed(apart[k], samples, k, others[k]) for k in every]
        fitted, held_out = {}, {}
        for axis, shape in shapes.items():
            held_out[axis] = [own[axis].under(shape) for own in new]
            squares = np.square(np.concatenate([own[axis].under(shape).spread for own in spread]))
            fitted[axis] = replace(
                final[axis], shape=shape, rule=rules[axis], rms_spread=float(np.sqrt(np.mean(squares)))
            )
        progress(Progress("Calibrating predictions ahead", 1, 1))
        without = apart if len(flights) > 1 else ()
        return Fit(fitted, held_out, rollouts=ahead, left_out=without)

    def compile(self, fitted: Mapping[str, Any]) -> CompiledPhysical:
        """Pack the axes."""
        return CompiledPhysical(fitted)

    def force_bandwidth_hz(self, fitted: Mapping[str, Any]) -> float | None:
        """As it was found."""
        return _shared(fitted).sensing.force_bandwidth_hz

    def simulation_section(self, fitted: Mapping[str, Any]) -> dict[str, Any]:
        """The parameters; the place of the accelerometer, which moves no body, as an effect on sensors."""
        shared = _shared(fitted)
        values = {TERM_NAMES[k]: float(shared.values[k]) for k in shared.kept}
        lever_arm = {f"{axis}_m": values.pop(f"imu_{axis}", 0.0) for axis in "xyz"}
        flying = [TERM_INDEX[name] for name in values]
        scale = shared.standard_errors[flying]
        correlation = shared.covariance[np.ix_(flying, flying)] / np.outer(scale, scale)
        triangle = scale[:, np.newaxis] * _factor(correlation)
        section: dict[str, Any] = {
            "physical": {
                "reference_thrust_n_s2": float(shared.vehicle["reference_thrust"][0]),
                "parameters": values,
                "deviations": {name: triangle[row, : row + 1].tolist() for row, name in enumerate(values)},
                **asdict(shared.sensing),
            }
        }
        if any(lever_arm.values()):
            section["effects"] = {"imu_lever_arm": lever_arm}
        return section

    def facts(self, fitted: Mapping[str, Any], rollouts: RolloutModel | None) -> list[Facts]:
        """Parameters, their most correlated pairs, those that predict ahead, and the log of the fit."""
        shared = _shared(fitted)
        return [
            *_parameter_facts(
                "parameters",
                [(name, value, error, unit, note) for name, value, error, unit, _, note in shared.rows()],
                _sensing_words(shared),
                shared.covariance,
            ),
            *([] if rollouts is None else _facts_ahead(rollouts)),
            Facts(
                "log of the fit",
                ("step", "of", "error"),
                [(step.step, step.of, step.error) for step in shared.log],
            ),
        ]

    def standard_error(
        self, fitted: Mapping[str, Any], axis: str, inputs: Array, weights: Array, vehicle: Vehicle
    ) -> float:
        """By the covariance of the parameters, with the thrust that differs from flight to flight."""
        own, column, shared = fitted[axis], AXES.index(axis), _shared(fitted)
        steady = np.zeros(len(inputs), DERIVATIVES)
        z = regressors(motions(inputs, steady, vehicle), shared.vehicle)[:, own.acting, column]
        # The whitening is in units of the noise: of the force or moment at rest, both errors are known.
        rest = TERM_INDEX[f"bias_{('x', 'y', 'z', 'roll', 'pitch', 'yaw')[column]}"]
        place = np.flatnonzero(own.acting == rest)
        noise = shared.standard_errors[rest] / np.linalg.norm(own.whitening[place])
        return float(noise * np.linalg.norm(weights @ z @ own.whitening))

    def rotor_delay(self, fitted: Mapping[str, Any]) -> RotorDelay:
        """As it was found."""
        shared = _shared(fitted)
        return RotorDelay(shared.sensing.rotor_delay_s, shared.delay_range_s)

    def store(self, fitted: Mapping[str, FittedAxis]) -> StoredAxes:
        """Parameters once, what belongs to an axis by axis, and a table of parameters for people."""
        shared, by_axis = _shared(fitted), super().store(fitted)
        fit = json.dumps(shared.to_json(), indent=1, allow_nan=False) + "\n"
        files = {FIT_FILE: fit.encode(), TABLE_FILE: shared.csv().encode()}
        return StoredAxes(by_axis.entries, {**shared.arrays(), **by_axis.arrays}, files)

    def read(self, stored: StoredAxes) -> dict[str, FittedAxis]:
        """The fitted axes of what :meth:`store` gave."""
        if FIT_FILE not in stored.files:
            raise ModelError(f"{FIT_FILE}: missing")
        with named_in(FIT_FILE):
            shared = PhysicalFit.stored(
                parse_json(stored.files[FIT_FILE].decode(errors="replace")), stored.arrays
            )
        entries = {axis: {**entry, "parameters": shared} for axis, entry in stored.entries.items()}
        return super().read(StoredAxes(entries, stored.arrays))


def _shared(fitted: Mapping[str, Any]) -> PhysicalFit:
    shared: PhysicalFit = next(iter(fitted.values())).parameters
    return shared


def _parameter_facts(
    title: str, rows: Sequence[tuple[str | float, ...]], note: str, covariance: Array
) -> list[Facts]:
    """Parameters, and their most correlated pairs."""
    columns = ("parameter", "value", "standard error", "unit", "note")
    pairs = ("one", "other", "correlation")
    return [
        Facts(title, columns, rows, note),
        Facts(f"most correlated {title}", pairs, worst_pairs(covariance)),
    ]


def _facts_ahead(rollouts: RolloutModel) -> list[Facts]:
    values, errors = rollouts.parameters, np.sqrt(np.diag(rollouts.covariance))
    bounded = bounded_terms(values, errors)
    rows = [
        (term.name, float(values[k]), float(errors[k]), term.unit, AT_BOUND if term.name in bounded else "")
        for k, term in enumerate(TERMS)
        if MOVES[k] and errors[k] > 0.0
    ]
    return _parameter_facts("parameters that predict ahead", rows, rollouts.remark, rollouts.covariance)


def _sensing_words(shared: PhysicalFit) -> str:
    words = delay_words(shared.sensing.rotor_delay_s, shared.delay_range_s, DELAYS_S[-1])
    if (bandwidth := shared.sensing.force_bandwidth_hz) is not None:
        words += (
            f"; measured forces of these flights end at {bandwidth:g} Hz, so predicted forces are judged "
            "smoothed alike"
        )
    untold = [name for name, note in shared.notes.items() if note != AT_BOUND]
    missing = missing_flying(untold, len(shared.kept))
    return f"{words}. {missing}" if missing else words


def _axes(
    fit: PhysicalFit, noise: Array, pools: Pools, thrusts: Mapping[str, float] | None = None
) -> dict[str, FittedPhysical]:
    """The axes of a fit, their intervals not yet calibrated.

    Args:
        fit: of all axes.
        noise: (6,) standard deviation of the errors on the flights.
        pools: by axis held.
        thrusts: by axis, 1/N² or 1/(Nm)²: what thrust that differs from flight to flight adds to the
            leverage, per square of the thrust or its moment; nothing unless given.
    """
    acts, axes = acting_terms(), {}
    thrust_values = np.where([term.name.startswith("thrust") for term in TERMS], fit.values, 0.0)
    for axis in pools:
        column = AXES.index(axis)
        acting = np.flatnonzero(acts[:, column] & (fit.standard_errors > 0.0))
        covariance = fit.covariance[np.ix_(acting, acting)] / noise[column] ** 2
        if thrusts is not None:
            thrust = thrust_values[acting]
            covariance = covariance + thrusts[axis] * np.outer(thrust, thrust)
        scale = np.sqrt(np.diag(covariance))
        whitening = scale[:, np.newaxis] * _factor(covariance / np.outer(scale, scale))
        axes[axis] = FittedPhysical(fit, whitening, acting, SpreadShape(1.0, 0.0), NormalRule(), 1.0)
    return axes


def _factor(correlation: Array) -> Array:
    """Lower triangular L (s, s) with L Lᵀ the correlation (s, s), which rounding may leave indefinite."""
    values, vectors = np.linalg.eigh(correlation)
    half = vectors * np.sqrt(np.maximum(values, _LEAST_VARIANCE))
    lower: Array = np.transpose(np.linalg.qr(half.T).R)
    return lower * np.where(np.diag(lower) < 0.0, -1.0, 1.0)


def _placed(
    axes: Mapping[str, FittedPhysical],
    samples: TrainingSamples,
    flight: int,
    fitted_to: Sequence[int] = (),
) -> dict[str, PlacedErrors]:
    """Errors by axis on a flight, and where they were made.

    Args:
        axes: of a fit.
        samples: of all flights.
        flight: number of the flight.
        fitted_to: numbers of the flights of the fit, if the flight is none of them.
    """
    compiled, rows = CompiledPhysical(axes), thinned_rows(samples, flight)
    inputs = samples.inputs[rows]
    evidence = compiled.evaluate(inputs, np.zeros(len(AXES)), samples.derivatives[rows])
    bandwidth = KIND.force_bandwidth_hz(axes)
    predicted = as_recorded(samples.time[rows], inputs, evidence.predicted, bandwidth)
    error = samples.wrench[rows] - predicted
    peaks = []
    for other in fitted_to:
        thin = thinned_rows(samples, other)[::_PEAK_STEP]
        there = compiled.evaluate(samples.inputs[thin], np.zeros(len(AXES)), samples.derivatives[thin])
        peaks.append((there.leverage, squared_speed(samples.inputs[thin])))
    inside = np.ones(len(rows), dtype=np.bool_)
    if fitted_to:
        inside = inside_range(inputs, of=samples.inputs[np.isin(samples.flight, fitted_to)])
    return {
        axis: PlacedErrors(
            error[:, k],
            evidence.leverage[:, k],
            squared_speed(inputs),
            inside,
            [(leverage[:, k], speed) for leverage, speed in peaks],
        )
        for axis in axes
        for k in [AXES.index(axis)]
    }


KIND = Physical()
