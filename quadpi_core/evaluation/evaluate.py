# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Predictions and intervals of models on flights, and how good they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from quadpi_core import array_checks
from quadpi_core.errors import ModelError
from quadpi_core.evaluation.alarm_assessment import alarm_of_flight
from quadpi_core.evaluation.evaluation_result import (
    ComparedEvaluation,
    Comparison,
    Evaluation,
)
from quadpi_core.evaluation.flight_results import FlightResult, evaluate_flights
from quadpi_core.flight_files import FlightLeftOut, LeftOutFlights, named_files, require_flights_left
from quadpi_core.identification.prepared_flights import PREPARE_FLIGHTS, PreparedFlight, prepare_flights
from quadpi_core.logs import is_log_folder
from quadpi_core.models.aerodynamic import LOAD_MODEL, AerodynamicModel
from quadpi_core.models.model_folder import MODEL_FILE
from quadpi_core.monitor.adaptive import AdaptiveIntervals
from quadpi_core.parallel import DEFAULT_WORKERS, Workers
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.version import __version__


def predict_flight(
    model: AerodynamicModel,
    flight: PreparedFlight,
    confidence: float,
    *,
    adaptive: bool = False,
    with_alarm: bool = False,
) -> FlightResult:
    """Predict the wrench of one flight, with intervals.

    Args:
        model: of the vehicle that flew.
        flight: passed the low-pass of the model.
        confidence: nominal coverage of the intervals.
        adaptive: intervals that adapt to the measurement as the flight goes, as the monitor's may.
        with_alarm: run the alarm as well, on the model's own intervals in either case.
    """
    evaluation = model.evaluate(flight, confidence)
    lower, upper = evaluation.lower, evaluation.upper
    if adaptive:
        rate_hz = 1.0 / float(np.median(np.diff(flight.time)))
        intervals = AdaptiveIntervals(confidence, rate_hz, model.moving_centre)
        lower, upper = intervals.step(flight.wrench, lower, upper)
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
        sha256=flight.sha256,
        in_sample=model.learned_from(flight.sha256),
        recorded_s=flight.recorded_s,
    )


def judge(
    model: AerodynamicModel,
    flights: Sequence[PreparedFlight],
    groups: Mapping[str, Sequence[str]],
    confidence: float | None = None,
    *,
    adaptive: bool = False,
) -> tuple[list[FlightResult], Evaluation]:
    """Predict the wrench of flights, and judge predictions and intervals.

    Args:
        model: of the vehicle that flew.
        flights: passed the low-pass of the model.
        groups: names of the flights in each group.
        confidence: nominal coverage of the intervals; the model's own unless given.
        adaptive: see :func:`predict_flight`.

    Returns:
        One result per flight, and the metrics of each flight and group.

    Raises:
        ArgumentError: for what are no model, flights, groups or confidence.
        EvaluationError: for groups and flights that do not fit.
        ModelError: for samples that are not finite, and a confidence that the model has no intervals of.
    """
    array_checks.instance("model", model, AerodynamicModel, LOAD_MODEL)
    flights = array_checks.several("flights", flights, PreparedFlight, PREPARE_FLIGHTS)
    array_checks.instance("groups", groups, Mapping, "names of flights by the name of their group")
    groups = {name: array_checks.several(f"groups, {name}", of, str) for name, of in groups.items()}
    confidence = model.confidence if confidence is None else array_checks.number("confidence", confidence)
    for flight in flights:
        flight.require_finite()

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
    return results, replace(
        evaluation,
        force_bandwidth_hz=model.force_bandwidth_hz,
        data_quality={flight.name: flight.quality for flight in flights},
        support=None if adaptive else model.support(confidence),
    )


def is_model_folder(path: Path) -> bool:
    """Whether a path that may be that of a model or of a flight is of a model: a folder that is no bag."""
    return (path / MODEL_FILE).is_file() or (path.is_dir() and not is_log_folder(path))


def load_models(folders: Sequence[Path]) -> dict[str, AerodynamicModel]:
    """Stored models by name.

    Raises:
        ModelError: for a folder without a model, and two models of one name.
    """
    models: dict[str, AerodynamicModel] = {}
    for folder in folders:
        model = AerodynamicModel.load(folder)
        if model.name in models:
            raise ModelError(f"{folder}: another model is called {model.name}; rename one of the folders")
        models[model.name] = model
    return models


def common_confidence(models: Mapping[str, AerodynamicModel], confidence: float | None) -> float:
    """The confidence that is asked for, else that of all models.

    Raises:
        ModelError: if none is asked for and theirs differ.
    """
    if confidence is not None:
        return confidence
    levels = {model.confidence for model in models.values()}
    if len(levels) > 1:
        raise ModelError("the models have different confidences: give one with --confidence")
    return levels.pop()


@dataclass(frozen=True)
class ComparisonCase:
    """Models and the flights to judge them on.

    Attributes:
        models: of the vehicle that flew, by the name that they have in the result.
        flights: the same flights after each low-pass (Hz) that the models take.
        groups: names of the flights in each group.
        confidence: nominal coverage of the intervals.
        left_out: flights that were given and cannot be used.
    """

    models: Mapping[str, AerodynamicModel]
    flights: Mapping[float, Sequence[PreparedFlight]]
    groups: Mapping[str, Sequence[str]]
    confidence: float
    left_out: Sequence[FlightLeftOut] = field(default_factory=list)


def given_comparison(
    folders: Sequence[Path],
    groups: Mapping[str, Sequence[Path]],
    *,
    vehicle: str | None = None,
    confidence: float | None = None,
    mapping: MappingOrOptions = None,
    workers: Workers = DEFAULT_WORKERS,
    left_out: LeftOutFlights = None,
) -> ComparisonCase:
    """Stored models and the flights in files; each flight is read once for each low-pass.

    Args:
        folders: of the models, of one vehicle.
        groups: files of the flights in each group; a flight may be in several.
        vehicle: name or path of the vehicle file; default: the one that the first model names.
        confidence: of the intervals; default: the models' own.
        mapping: of the files, see :func:`quadpi_core.logs.read_recording`.
        workers: that read the files.
        left_out: the list to which flights that cannot be used are added, and with the last of its flights a
            group ends; without it, the first is an error.

    Raises:
        ModelError: for what is no model of the vehicle, two models of one name, and confidences that differ
            where none is given.
        LogError, SignalError, VehicleError, ParallelError: for what cannot be read.
    """
    models = load_models(folders)
    the_vehicle = next(iter(models.values())).load_vehicle(vehicle)
    for model in models.values():
        model.require(the_vehicle)
    level = common_confidence(models, confidence)
    files = list(dict.fromkeys(path for members in groups.values() for path in members))
    flights = {
        cutoff: prepare_flights(
            files, the_vehicle, cutoff, mapping=mapping, workers=workers, left_out=left_out
        )
        for cutoff in dict.fromkeys(model.cutoff_hz for model in models.values())
    }
    common = set.intersection(*({flight.name for flight in of_model} for of_model in flights.values()))
    require_flights_left(len(common), left_out)
    flights = {cutoff: [f for f in own if f.name in common] for cutoff, own in flights.items()}
    name_of = {file.path: file.name for file in named_files(files)}
    parts = next(iter(flights.values()))
    named = {
        group: [one.name for path in members for one in parts if one.file == name_of[path]]
        for group, members in groups.items()
    }
    return ComparisonCase(
        models,
        flights,
        {group: names for group, names in named.items() if names},
        level,
        left_out=list(left_out or ()),
    )


def compare(
    case: ComparisonCase, *, adaptive: bool = False
) -> tuple[dict[str, list[FlightResult]], Comparison]:
    """Predict each flight with each model, and judge the intervals.

    Args:
        case: of at least one model.
        adaptive: see :func:`quadpi_core.evaluation.evaluate.predict_flight`.

    Returns:
        One result per flight of each model, and the metrics.

    Raises:
        EvaluationError: for groups and flights that do not fit.
        ModelError: for a confidence that a model has no intervals of.
    """
    results: dict[str, list[FlightResult]] = {}
    evaluations: dict[str, ComparedEvaluation] = {}
    for name, model in case.models.items():
        results[name], evaluation = judge(
            model, case.flights[model.cutoff_hz], case.groups, case.confidence, adaptive=adaptive
        )
        evaluations[name] = ComparedEvaluation(
            **vars(evaluation) | {"left_out": case.left_out},
            settings=model.settings,
            cutoff_hz=model.cutoff_hz,
        )
    return results, Comparison(
        quadpi_version=__version__,
        vehicle=next(iter(case.models.values())).vehicle,
        confidence=case.confidence,
        adaptive=adaptive,
        groups={name: list(members) for name, members in case.groups.items()},
        models=evaluations,
        left_out=case.left_out,
    )
