# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Forces and moments of rotors and airframe, one set of parameters for all axes (see `physical_terms`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.fitted_physical import FittedPhysical, PhysicalAxis, PhysicalFit, triangular
from quadpi_core.models.interval_rules import NormalRule, calibrate, inside_range
from quadpi_core.models.model_kind import Fit, IdentifyOptions, Kind, Pools, TrainingSamples, option
from quadpi_core.models.physical_fit import thrust_variance
from quadpi_core.models.physical_flight import SHORTEST_S, flights_of, thinned_rows
from quadpi_core.models.physical_regressors import acting_terms
from quadpi_core.models.physical_study import PhysicalStudy
from quadpi_core.models.physical_terms import TERM_NAMES, TERMS
from quadpi_core.models.rollout_identification import calibrated_rollouts, rollout_flights
from quadpi_core.models.spread_shape import PlacedErrors, fit_shape, squared_speed
from quadpi_core.parallel import Progress, ReportProgress, one_blas_thread
from quadpi_core.signals.wrench import as_recorded

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
    fitted_type = FittedPhysical

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
            study = PhysicalStudy.from_flights(flights, samples.vehicle)
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
        plain = [_fitted(fit, noise, pools) for fit in (whole, *left_out)]
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
        final, *apart = (_fitted(fit, noise, pools, thrusts) for fit in (whole, *left_out))
        spread = [_placed(final, samples, k) for k in every]
        new = [_placed(apart[k], samples, k, others[k]) for k in every]
        axes, held_out = {}, {}
        for axis, shape in shapes.items():
            held_out[axis] = [own[axis].under(shape) for own in new]
            squares = np.square(np.concatenate([own[axis].under(shape).spread for own in spread]))
            rms = float(np.sqrt(np.mean(squares)))
            axes[axis] = replace(final.axes[axis], **vars(shape), rule=rules[axis], rms_spread=rms)
        progress(Progress("Calibrating predictions ahead", 1, 1))
        without = apart if len(flights) > 1 else ()
        return Fit(FittedPhysical(axes, whole), held_out, rollouts=ahead, left_out=without)


def _fitted(
    fit: PhysicalFit, noise: Array, pools: Pools, thrusts: Mapping[str, float] | None = None
) -> FittedPhysical:
    """The model of a fit, its intervals not yet calibrated.

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
        whitening = scale[:, np.newaxis] * triangular(covariance / np.outer(scale, scale))
        names = tuple(TERM_NAMES[k] for k in acting)
        axes[axis] = PhysicalAxis(names, whitening, 1.0, 0.0, NormalRule(), 1.0)
    return FittedPhysical(axes, fit)


def _placed(
    fitted: FittedPhysical, samples: TrainingSamples, flight: int, fitted_to: Sequence[int] = ()
) -> dict[str, PlacedErrors]:
    """Errors by axis on a flight, and where they were made.

    Args:
        fitted: to some of the flights.
        samples: of all flights.
        flight: number of the flight.
        fitted_to: numbers of the flights of the fit, if the flight is none of them.
    """
    rows = thinned_rows(samples, flight)
    inputs = samples.inputs[rows]
    evidence = fitted.evaluate(inputs, np.zeros(len(AXES)), samples.derivatives[rows])
    predicted = as_recorded(samples.time[rows], inputs, evidence.predicted, fitted.force_bandwidth_hz)
    error = samples.wrench[rows] - predicted
    peaks = []
    for other in fitted_to:
        thin = thinned_rows(samples, other)[::_PEAK_STEP]
        there = fitted.evaluate(samples.inputs[thin], np.zeros(len(AXES)), samples.derivatives[thin])
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
        for axis in fitted.axes
        for k in [AXES.index(axis)]
    }


KIND = Physical()
