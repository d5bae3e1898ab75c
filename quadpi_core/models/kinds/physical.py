# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Forces and moments of rotors and airframe, one set of parameters for all axes (see `physical_terms`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.envelope import PlacedErrors, fit_shape, squared_speed
from quadpi_core.models.fitted_physical import FittedPhysical, PhysicalAxis, PhysicalFit, triangular
from quadpi_core.models.interval_rules import NormalRule, calibrate, inside_range
from quadpi_core.models.model_kind import Fit, IdentifyOptions, Kind, Pools, TrainingSamples, option
from quadpi_core.models.multi_step_fit import calibrated_rollouts, rollout_flights
from quadpi_core.models.physical_fit import (
    AT_BOUND,
    DELAYS_S,
    FORCE,
    LEAST,
    MOMENT,
    SHORTEST_S,
    FitStep,
    Information,
    PhysicalFlight,
    Problem,
    Sensing,
    Weights,
    bounded_terms,
    flights_of,
    reference_thrust,
    thinned_rows,
    thrust_variance,
    total,
)
from quadpi_core.models.physical_terms import (
    TERM_INDEX,
    TERM_NAMES,
    TERMS,
    UNTOLD_DELAY_S,
    acting_terms,
    delay_untold,
    physical_vehicle,
    unidentified,
)
from quadpi_core.parallel import Progress, ReportProgress, one_blas_thread
from quadpi_core.records import Records
from quadpi_core.signals.wrench import as_recorded
from quadpi_core.vehicle import Vehicle

# The delay of the rotor speeds is that with the least errors of the moments, the bandwidth of the force
# measurement that with the least errors of the forces; groups of terms leave where flights left out in turn
# are predicted better without them.

# A delay is ruled out where twice the logarithm of the likelihood falls by this: χ² of one number, 95 %.
_WITHIN_CHI_SQUARE = 3.84
# Bandwidths of the force measurement that are tried [Hz]. The specific force of the NeuroBEM data set ends at
# 7 Hz; that of an accelerometer lies beyond all signals.
BANDWIDTHS_HZ = (20.0, 15.0, 12.0, 10.0, 8.0, 7.0, 6.0, 5.0)
# Share of the squared error that a bandwidth must save: on NeuroBEM it saves half, on Crazyflie it costs.
_WORTH_A_BANDWIDTH = 0.9
# Stride over the samples of a flight; these are enough to distinguish delays.
_DELAY_STRIDE = 4
# Rounds of fit and weights, and of fit and bandwidth; deviations change by less than 1 % after three.
_ROUNDS = 3
# A group of terms leaves where that lowers the mean logarithm of the squared errors on flights left out by
# this: the prior keeps terms that flights do not identify near zero. Set with the fastest NeuroBEM flight in
# view: without the groups that gain less than 0.002, its error of Fz was a third larger when it was left out.
_HARM_OF_A_GROUP = 0.05
_EVERYTHING = np.ones(len(TERMS), dtype=np.bool_)


@dataclass(frozen=True)
class PhysicalStudy:
    """Flights summed up, so that the model can be fitted to any of them quickly.

    Delay, bandwidth, reference thrust and weights are those of all flights, in a fit without one of them too.

    Attributes:
        vehicle: that flew.
        reference: N s², thrust of a rotor over ω².
        sensing: delay and bandwidth of all flights.
        delay_range_s: delays that the flights do not rule out; None if it was given.
        information: of each flight.
        weighing: of the errors of all flights.
        rate_hz: of the samples.
        log: of what was searched.
    """

    vehicle: Vehicle
    reference: float
    sensing: Sensing
    delay_range_s: tuple[float, float] | None
    information: tuple[Information, ...]
    weighing: Weights
    rate_hz: float
    log: tuple[FitStep, ...]

    @classmethod
    def from_flights(
        cls, flights: Sequence[PhysicalFlight], vehicle: Vehicle, *, sensing: Sensing | None = None
    ) -> PhysicalStudy:
        """Search delay and bandwidth, sum up and weigh.

        Args:
            flights: of the vehicle.
            vehicle: that flew.
            sensing: delay and bandwidth where they are known; else they are searched.

        Raises:
            ModelError: for no flights, and for flights whose rotors carry no weight.
        """
        if not flights:
            raise ModelError("no flights to identify on: at least one is needed")
        reference = reference_thrust(flights)
        problem, record = Problem.from_vehicle(vehicle, reference), physical_vehicle(vehicle, reference)
        log: list[FitStep] = []
        delay_range = None
        if sensing is None:
            delay, delay_range = _rotor_delay(flights, record, problem, log)
            sensing = _force_bandwidth(flights, record, problem, delay, log)
        information = [_summed(flight, record, sensing) for flight in flights]
        weighing = Weights.start(information)
        rate_hz = float(np.mean([flight.rate_hz for flight in flights]))
        for _ in range(_ROUNDS):
            values = problem.solve(information, weighing, _EVERYTHING)
            errors = [flight.errors(values, record, sensing) for flight in flights]
            weighing = Weights.of_errors(errors, rate_hz)
        return cls(
            vehicle, reference, sensing, delay_range, tuple(information), weighing, rate_hz, tuple(log)
        )

    def fit(self, *, choose: bool, left_out: int | None = None) -> PhysicalFit:
        """Fit the model to all flights, or to all but one.

        Args:
            choose: leave out groups of terms that harm flights left out.
            left_out: number of a flight that is not used.
        """
        information = [own for k, own in enumerate(self.information) if k != left_out]
        problem, log = Problem.from_vehicle(self.vehicle, self.reference), list(self.log)
        terms = _EVERYTHING
        if choose and len(information) > 1:
            terms = _chosen_terms(information, problem, self.weighing, log)
        values = problem.solve(information, self.weighing, terms)
        covariance = problem.covariance(information, self.weighing, terms)
        bounded = [name for name in bounded_terms(values, problem.spread) if terms[TERM_INDEX[name]]]
        return PhysicalFit(
            values,
            covariance,
            physical_vehicle(self.vehicle, self.reference),
            self.vehicle.inertia,
            self.sensing,
            self.delay_range_s,
            unidentified(covariance, problem.spread) | dict.fromkeys(bounded, AT_BOUND),
            tuple(log),
        )


def _summed(flight: PhysicalFlight, record: Records, sensing: Sensing) -> Information:
    return total(
        Information.from_samples(part.regressors(record, sensing), part.wrench) for part in flight.parts()
    )


def _rotor_delay(
    flights: Sequence[PhysicalFlight], record: Records, problem: Problem, log: list[FitStep]
) -> tuple[float, tuple[float, float]]:
    """The delay with the least errors of the moments, and the range whose likelihood is not ruled out.

    The range is that of the likelihood ratio (Jategaonkar, Flight Vehicle System Identification, 2015, 11.2),
    for normal errors of which as many are independent as their autocorrelation tells.
    """
    thin = [flight.cut(slice(None, None, _DELAY_STRIDE)) for flight in flights]
    squares: list[Array] = []
    for delay_s in DELAYS_S:
        information = [_summed(flight, record, Sensing(delay_s)) for flight in thin]
        if not squares:
            weighing = Weights.start(information)
            values = problem.solve(information, weighing, _EVERYTHING)
            weighing = replace(weighing, deviation=np.maximum(total(information).rmse(values), LEAST))
        values = problem.solve(information, weighing, _EVERYTHING)
        if not squares:
            errors = [flight.errors(values, record, Sensing(delay_s)) for flight in thin]
        relative = total(information).rmse(values)[MOMENT] / weighing.deviation[MOMENT]
        squares.append(np.maximum(np.square(relative), LEAST))
        log.append(FitStep("rotor delay", f"{delay_s * 1e3:g} ms", float(np.mean(squares[-1]))))
    best = int(np.argmin(np.mean(squares, axis=1)))
    rate_hz = float(np.mean([flight.rate_hz for flight in thin]))
    independent = Weights.of_errors(errors, rate_hz).independent[MOMENT]
    count = sum(len(flight.time) for flight in thin) * independent
    delay_range = delays_not_ruled_out(np.array(squares), count, best)
    return UNTOLD_DELAY_S if delay_untold(delay_range) else DELAYS_S[best], delay_range


def delays_not_ruled_out(squares: Array, count: Array, best: int) -> tuple[float, float]:
    """Shortest and longest delay [s] whose likelihood is nearly the greatest, and `best` between them.

    The likelihood weighs axes by their independent errors, and `best` all alike: real axes disagree, on
    brushless Crazyflies by 2.5 ms, so the delay that is used may be ruled out by the likelihood.

    Args:
        squares: (D, 3) mean squared errors of the moments with each of :data:`DELAYS_S`.
        count: (3,) independent errors.
        best: number of the delay that is used.
    """
    ratio = np.log(squares) @ count
    open_still = ratio <= ratio.min() + _WITHIN_CHI_SQUARE
    open_still[best] = True
    numbers = np.flatnonzero(open_still)
    return DELAYS_S[numbers[0]], DELAYS_S[numbers[-1]]


def _force_bandwidth(
    flights: Sequence[PhysicalFlight],
    record: Records,
    problem: Problem,
    delay_s: float,
    log: list[FitStep],
) -> Sensing:
    """The bandwidth of the measured force by how well predictions smoothed alike agree."""
    forces = np.concatenate([flight.wrench[:, FORCE] for flight in flights])
    deviation = np.maximum(np.sqrt(np.mean(np.square(forces), axis=0)), LEAST)
    best = Sensing(delay_s)
    for _ in range(_ROUNDS):
        information = [_summed(flight, record, best) for flight in flights]
        values = problem.solve(information, Weights.start(information), _EVERYTHING)
        costs = {}
        for bandwidth in (None, *BANDWIDTHS_HZ):
            sensing = Sensing(delay_s, bandwidth)
            errors: Array = np.concatenate([flight.errors(values, record, sensing) for flight in flights])
            costs[sensing] = float(np.mean(np.square(errors[:, FORCE] / deviation)))
            of = "none" if bandwidth is None else f"{bandwidth:g} Hz"
            log.append(FitStep("force bandwidth", of, costs[sensing]))
        before, best = best, min(costs, key=lambda tried: costs[tried])
        if costs[best] > _WORTH_A_BANDWIDTH * costs[Sensing(delay_s)]:
            return Sensing(delay_s)
        if best == before:
            break
    return best


def _chosen_terms(
    information: Sequence[Information], problem: Problem, weighing: Weights, log: list[FitStep]
) -> npt.NDArray[np.bool_]:
    """Leave out, one after the other, the groups of terms that harm flights left out."""
    groups = sorted({term.group for term in TERMS} - {""})
    members = {group: np.array([term.group == group for term in TERMS]) for group in groups}
    together = total(information)
    others = [together - flight for flight in information]

    def error(kept: npt.NDArray[np.bool_]) -> float:
        """Mean logarithm of the squared errors on flights left out in turn, over flights and axes."""
        squares = [
            np.square(flight.rmse(problem.solve([rest], weighing, kept)) / weighing.deviation)
            for flight, rest in zip(information, others, strict=True)
        ]
        return float(np.mean(np.log(np.maximum(squares, LEAST))))

    kept = _EVERYTHING.copy()
    best = error(kept)
    log.append(FitStep("log error of flights left out", "all terms", best))
    while groups:
        errors = {group: error(kept & ~members[group]) for group in groups}
        least = min(groups, key=lambda group: errors[group])
        if errors[least] > best - _HARM_OF_A_GROUP:
            break
        kept &= ~members[least]
        groups.remove(least)
        best = errors[least]
        log.append(FitStep("log error of flights left out", f"without {least}", errors[least]))
    log.extend(FitStep("gain of a group kept", group, errors[group] - best) for group in groups)
    return kept


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
    """Errors by axis on a flight, with the leverage and airspeed of each.

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
