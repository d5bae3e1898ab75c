# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a model says of flights, beside what was measured, and how good that is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from quadpi_core.evaluation.alarm_assessment import alarm_of_flight
from quadpi_core.evaluation.evaluation_result import Evaluation
from quadpi_core.evaluation.flight_results import FlightResult, evaluate_flights
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.adaptive import AdaptiveFactor


def predict_flight(
    model: AerodynamicModel,
    flight: PreparedFlight,
    confidence: float,
    *,
    adaptive: bool = False,
    with_alarm: bool = False,
) -> FlightResult:
    """What the model says of one flight, beside what was measured.

    Args:
        model: of the vehicle that flew.
        flight: passed the low-pass of the model.
        confidence: nominal coverage of the intervals.
        adaptive: intervals that adapt to the measurement as the flight goes, as the monitor's may.
        with_alarm: run the alarm as well; it goes by the model's own intervals either way.
    """
    evaluation = model.evaluate(flight.inputs, confidence)
    lower, upper = evaluation.lower, evaluation.upper
    if adaptive:
        rate_hz = 1.0 / float(np.median(np.diff(flight.time)))
        lower, upper = AdaptiveFactor(confidence, rate_hz).step(flight.wrench, lower, upper)
    alarm = None
    if with_alarm:
        alarm = alarm_of_flight(model, flight.time, flight.judged, confidence)
    return FlightResult(
        name=flight.name,
        axes=model.axes,
        time=flight.time,
        measured=flight.wrench,
        predicted=evaluation.predicted,
        lower=lower,
        upper=upper,
        inputs=flight.inputs,
        height=flight.height,
        alarm=alarm,
    )


def judge(
    model: AerodynamicModel,
    flights: Sequence[PreparedFlight],
    groups: Mapping[str, Sequence[str]],
    confidence: float,
    *,
    adaptive: bool = False,
) -> tuple[list[FlightResult], Evaluation]:
    """What the model says of flights, and how good that is.

    Args:
        model: of the vehicle that flew.
        flights: passed the low-pass of the model.
        groups: names of the flights in each group.
        confidence: nominal coverage of the intervals.
        adaptive: see :func:`predict_flight`.

    Returns:
        One result per flight, and the metrics of each flight and group.

    Raises:
        EvaluationError: for groups and flights that do not fit.
    """

    def at(level: float) -> Iterator[FlightResult]:
        return (predict_flight(model, flight, level, adaptive=adaptive) for flight in flights)

    results = [
        predict_flight(model, flight, confidence, adaptive=adaptive, with_alarm=True) for flight in flights
    ]
    evaluation = evaluate_flights(
        results,
        groups,
        model.training_range,
        confidence,
        model=model.identity,
        vehicle=model.vehicle,
        method=model.method,
        adaptive=adaptive,
        at_confidence=at,
    )
    return results, replace(evaluation, data_quality={flight.name: flight.quality for flight in flights})
