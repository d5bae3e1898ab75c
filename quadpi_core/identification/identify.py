# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Identify an aerodynamic model from prepared flights: fit, calibrate the intervals, calibrate the alarm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.errors import ArgumentError, ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.alarm_calibration import (
    Judged,
    LiveErrors,
    calibrate_alarm,
    hover_rotor_speed,
    left_out,
    live_errors,
)
from quadpi_core.identification.change_calibration import calibrate_change
from quadpi_core.identification.found_wind import with_found_wind
from quadpi_core.identification.prepared_flights import PREPARE_FLIGHTS, PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel, TrainingFlight
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.interval_rules import (
    MEMORIES_S,
    FlightErrors,
    HeldOutRule,
    MovedAxis,
    MovingCentre,
    StateDeviation,
    delay,
    delayed,
    inside_range,
    means_of,
    regressed,
    require_confidence,
    usable,
)
from quadpi_core.models.kind_registry import kind_of
from quadpi_core.models.least_squares import identifiable
from quadpi_core.models.model_kind import (
    Evaluation,
    Fitted,
    IdentifyOptions,
    Pools,
    Settings,
    TrainingSamples,
)
from quadpi_core.models.regressors import CandidatePool
from quadpi_core.models.small_model import errors_by_flight
from quadpi_core.parallel import ReportProgress, ignore_progress
from quadpi_core.records import Records
from quadpi_core.vehicle import LOAD_VEHICLE, Vehicle


class LeftErrors(NamedTuple):
    """What the live path would err on a flight by the model of the others.

    Attributes:
        rate_hz: of the samples.
        errors: by axis held; the spread is the half width of the interval.
    """

    rate_hz: float
    errors: Mapping[str, FlightErrors]


def calibrate_centre(flights: Sequence[LeftErrors], confidence: float) -> MovingCentre | None:
    """How intervals move; None where none of the flights lies mostly inside the range of the others.

    Args:
        flights: left out in turn.
        confidence: of their intervals.
    """
    axes = {}
    for axis in flights[0].errors if flights else ():
        of_axis = [(rate_hz, errors[axis]) for rate_hz, errors in flights if errors[axis].usual]
        if not of_axis:
            return None
        known = usable(min(rate for rate, _ in of_axis))
        means = [means_of(delayed(one.error, delay(rate)), rate)[:, known] for rate, one in of_axis]
        coefficients = np.zeros(len(MEMORIES_S))
        coefficients[known], moves = regressed(
            [(one.error, m) for (_, one), m in zip(of_axis, means, strict=True)]
        )
        moved = [
            FlightErrors(one.error - by, one.spread, one.inside).factors()
            for (_, one), by in zip(of_axis, moves, strict=True)
        ]
        narrower = HeldOutRule(np.stack(moved), len(moved)).factor(confidence)
        axes[axis] = MovedAxis(coefficients, min(narrower, 1.0))
    return MovingCentre(axes) if axes else None


def errors_left(
    flights: Sequence[Judged], live: Sequence[LiveErrors], left_out: Sequence[Fitted], factors: Array
) -> list[LeftErrors]:
    """Errors of each flight left out, at all samples if the models of the others are at hand.

    Args:
        flights: of the identification.
        live: their errors, of all samples or every k-th; see `alarm_calibration.live_errors`.
        left_out: the model without each flight in turn, or none.
        factors: (6,) half width of an interval per unit of spread.
    """
    errors_by_flight = []
    extremes = [np.stack((flight.inputs.min(axis=0), flight.inputs.max(axis=0))) for flight in flights]
    for k, (flight, (every, errors)) in enumerate(zip(flights, live, strict=True)):
        rows = np.flatnonzero(flight.judged.known) if left_out else every
        if len(rows) < 2 or not errors:
            continue
        halves = {
            axis: FlightErrors(one.error, one.spread * factors[AXES.index(axis)], one.inside)
            for axis, one in errors.items()
        }
        if left_out:
            others = np.concatenate([own for place, own in enumerate(extremes) if place != k])
            halves = _all_samples(flight, rows, left_out[k], factors, others, list(errors))
        errors_by_flight.append(LeftErrors(1.0 / float(np.median(np.diff(flight.time[rows]))), halves))
    return errors_by_flight


def _all_samples(
    flight: Judged,
    rows: npt.NDArray[np.int64],
    fitted: Fitted,
    factors: Array,
    others: Array,
    axes: Sequence[str],
) -> dict[str, FlightErrors]:
    inputs = flight.judged.inputs[rows]
    evaluation = fitted.evaluate(inputs, factors, flight.judged.derivatives[rows])
    error = flight.judged.wrench[rows] - 0.5 * (evaluation.lower + evaluation.upper)
    half, inside = 0.5 * (evaluation.upper - evaluation.lower), inside_range(inputs, others)
    columns = {axis: AXES.index(axis) for axis in axes}
    return {axis: FlightErrors(error[:, k], half[:, k], inside) for axis, k in columns.items()}


# Each flight is left out in turn to calibrate the intervals, and a model of the others must remain.
_FEWEST_FLIGHTS = 2


def identify(
    flights: Sequence[PreparedFlight],
    vehicle: Vehicle,
    pools: Pools,
    options: IdentifyOptions,
    progress: ReportProgress = ignore_progress,
) -> AerodynamicModel:
    """Identify a model of every axis of `pools`, with its envelope and the limits of its alarm.

    Args:
        flights: to identify on; errors of flights left out in turn calibrate the intervals.
        vehicle: the vehicle that flew.
        pools: by axis: candidates of a polynomial, inputs of an ensemble.
        options: kind of model with its own options, and settings.
        progress: called as the fit goes on.

    Raises:
        ArgumentError: for what are no flights, vehicle, pools or options.
        ModelError: see :func:`check_options`; for too few flights for the settings; naming the flight, for
            samples that are not finite; naming the axis, for what cannot be identified.
    """
    flights = array_checks.several("flights", flights, PreparedFlight, PREPARE_FLIGHTS)
    array_checks.instance("vehicle", vehicle, Vehicle, LOAD_VEHICLE)
    array_checks.instance("options", options, IdentifyOptions)
    _require_pools(pools)
    check_options(options, pools)
    _require_samples(flights, options.settings)
    kind = kind_of(options)
    flights, wind = with_found_wind(flights, vehicle)
    samples = joined(flights, vehicle)
    axes = [axis for axis in AXES if axis in pools]
    with identifiable(f"a {options.method or kind.name} model"):
        fit = kind.fit(samples, {axis: pools[axis] for axis in axes}, options, progress)
    fitted = fit.fitted
    factors = fitted.factors(options.confidence)

    # Intervals: the held-out errors must be covered for the causal states of the live path too.
    held_out = fit.held_out

    def evaluate(rows: Array, moving: Records) -> Evaluation:
        return fitted.evaluate(rows, factors, moving)

    live = live_errors(flights, held_out, evaluate) if held_out else []
    rules = {
        axis: rule.covering([flight.errors[axis] for flight in live])
        for axis in held_out
        if isinstance(rule := fitted.axes[axis].rule, HeldOutRule)
    }

    # Alarm: the envelope of all flights, with limits from the flights left out.
    evidence = fitted.evaluate(samples.inputs, factors, samples.derivatives)
    signals = left_out(flights, rules, live, options.confidence) if rules else []
    envelope, limits = calibrate_alarm(
        Envelope.fit(samples.inputs, samples.flight, evidence.leverage, evidence.relative_width),
        signals,
        confidence=options.confidence,
        rate_per_hour=options.false_alarms_per_hour,
        hover_rotor_speed=hover_rotor_speed(
            samples.inputs, samples.wrench, vehicle.mass_kg * vehicle.gravity_m_s2
        ),
    )
    margin = envelope.near.margin
    change = calibrate_change(flights, live, signals, margin, vehicle, evaluate) if rules else None
    left = errors_left(flights, live, fit.left_out, factors) if rules else []
    model = AerodynamicModel(
        name="",
        vehicle=vehicle.name,
        vehicle_fingerprint=vehicle.fingerprint,
        flown=_with_learned_noise(vehicle, flights),
        settings=options.settings,
        cutoff_hz=options.cutoff_hz,
        confidence=options.confidence,
        fitted=fitted.with_rules(rules),
        envelope=envelope,
        training_range={axis: float(np.ptp(samples.target(axis))) for axis in axes},
        flights=tuple(TrainingFlight(f.name, f.sha256, len(f.time), f.air) for f in flights),
        selection={axis: fit.log.get(axis, []) for axis in axes},
        held_out_coverage={
            axis: rules[axis].held_out_coverage(held_out[axis], options.confidence).tolist()
            if axis in rules
            else []
            for axis in axes
        },
        rollouts=fit.rollouts,
        alarm_limits=limits,
        change_limits=change,
        moving_centre=calibrate_centre(left, options.confidence),
        state=StateDeviation.of_flights([flight.state for flight in flights]),
        wind=wind,
        left_out=tuple(fit.left_out),
    )
    return replace(model, by_flight=errors_by_flight(model, vehicle))


def _with_learned_noise(vehicle: Vehicle, flights: Sequence[PreparedFlight]) -> Vehicle:
    """The vehicle, with the noise that flights by a slow state told: a monitor cannot estimate it."""
    told = [flight.state_noise for flight in flights if flight.state_noise is not None]
    if not told:
        return vehicle
    position, attitude, velocity = np.sqrt(np.mean(np.square(told), axis=0)).tolist()
    noise = replace(
        vehicle.noise,
        state_position_m=position,
        state_attitude_rad=attitude,
        state_velocity_m_s=velocity,
    )
    return replace(vehicle, noise=noise)


def check_options(options: IdentifyOptions, pools: Pools) -> None:
    """Refuse options that no flights can satisfy; cheap, so that it can come before flights are read.

    Raises:
        ModelError: for a confidence that the settings cannot give, an unknown kind of model, or what the
            kind does not have.
    """
    require_confidence(options.confidence, calibrated=options.settings == "default")
    kind_of(options).check(options, pools)


def joined(flights: Sequence[PreparedFlight], vehicle: Vehicle) -> TrainingSamples:
    """The samples of all flights, with the wrench that air of the vehicle file's density would have given.

    Inertia and biases, some thousandths of it, go with it: models scale all that the air gives.
    """
    return TrainingSamples(
        vehicle,
        np.concatenate([flight.time for flight in flights]),
        np.concatenate([flight.inputs for flight in flights]),
        np.concatenate([flight.derivatives for flight in flights]),
        np.concatenate(
            [
                flight.wrench / (1.0 + flight.derivatives["density_excess"][:, np.newaxis])
                for flight in flights
            ]
        ),
        np.repeat(np.arange(len(flights)), [len(flight.time) for flight in flights]),
        [flight.name for flight in flights],
    )


def _require_pools(pools: Pools) -> None:
    """Refuse what is no candidate pool by axis, in the words of `quadpi_core.array_checks`."""
    hint = "load_pools(name_or_path) reads them"
    if not array_checks.instance("pools", pools, Mapping, hint):
        raise ArgumentError(f"pools: expected those of an axis at least, found none; {hint}")
    for axis, pool in pools.items():
        if axis not in AXES:
            raise ArgumentError(
                f"pools: expected axes of {', '.join(AXES)}, found {array_checks.description(axis)}"
            )
        array_checks.instance(f"pools, {axis}", pool, CandidatePool, hint)


def _require_samples(flights: Sequence[PreparedFlight], settings: Settings) -> None:
    """Refuse flights that no kind of model can be identified on.

    Raises:
        ModelError: for too few flights for the settings; naming the flight, for samples that are not finite.
    """
    if settings == "default" and len(flights) < _FEWEST_FLIGHTS:
        raise ModelError(
            f"too few flights: {len(flights)} given, {_FEWEST_FLIGHTS} or more needed to calibrate; "
            "--settings paper takes one, uncalibrated"
        )
    if not flights:
        raise ModelError("no flights to identify on: at least one is needed")
    for flight in flights:
        flight.require_finite()
