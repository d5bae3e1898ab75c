# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Search for what the physical model is fitted with: delay, bandwidth and terms.

The delay of the rotor speeds is that with the least errors of the moments, the bandwidth of the force
measurement that with the least errors of the forces; groups of terms leave where flights left out in turn are
predicted better without them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.fitted_physical import PhysicalFit
from quadpi_core.models.physical_fit import (
    AT_BOUND,
    LEAST,
    FitStep,
    Information,
    Problem,
    Weights,
    bounded_terms,
    total,
)
from quadpi_core.models.physical_flight import (
    DELAYS_S,
    FORCE,
    MOMENT,
    PhysicalFlight,
    Sensing,
    reference_thrust,
)
from quadpi_core.models.physical_regressors import physical_vehicle
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS, UNTOLD_DELAY_S, delay_untold, unidentified
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle

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
    """The delay by the errors of the moments, and the range that these do not rule out.

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
