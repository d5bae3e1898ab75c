# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Predictions and intervals of models on flights, and how good they are."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from quadpi_core import array_checks
from quadpi_core.errors import ModelError
from quadpi_core.evaluation.alarm_assessment import alarm_of_flight
from quadpi_core.evaluation.evaluation_result import (
    ComparedEvaluation,
    Comparison,
    Evaluation,
    FlightResult,
    evaluate_flights,
)
from quadpi_core.findings import DataQuality
from quadpi_core.flight import Flight
from quadpi_core.flight_files import (
    FlightFile,
    FlightLeftOut,
    LeftOutFlights,
    for_each_flight,
    named_files,
    once_each,
    require_flights_left,
)
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import (
    PREPARE_FLIGHTS,
    PreparedFlight,
    prepare_flights,
    read_flight,
)
from quadpi_core.logs import is_log_folder
from quadpi_core.models.aerodynamic import LOAD_MODEL, AerodynamicModel
from quadpi_core.models.model_folder import MODEL_FILE
from quadpi_core.models.rollout_model import FlightRollouts, RolloutFlight, RolloutModel, horizon_steps
from quadpi_core.models.tubes import (
    HORIZONS_S,
    LARGEST,
    QUANTITIES,
    TRACKING_PER_S,
    Following,
    error_norms,
    require_horizon,
    tracked_factors,
    tube_radii,
    tube_scores,
)
from quadpi_core.monitor.adaptive import AdaptiveIntervals
from quadpi_core.parallel import DEFAULT_WORKERS, ReportProgress, Workers, ignore_progress
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.vehicle import Vehicle
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
    if model.wind is not None:
        # Slow to import, and most models have no wind to find.
        from quadpi_core.identification.found_wind import in_found_wind

        flight = in_found_wind(flight, model.wind, model.load_vehicle())
    evaluation = model.evaluate(flight, confidence)
    lower, upper = evaluation.lower, evaluation.upper
    if adaptive:
        rate_hz = 1.0 / float(np.median(np.diff(flight.time)))
        intervals = AdaptiveIntervals(confidence, rate_hz, model.moving_centre)
        lower, upper = intervals.step(flight.wrench, lower, upper)
    alarm = None
    if with_alarm:
        alarm = alarm_of_flight(model, flight, confidence)
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
    for name, model in models.items():
        model.require(the_vehicle)
        models[name] = replace(model, flown=the_vehicle)
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
        group: names
        for group, members in groups.items()
        if (names := [one.name for path in members for one in parts if one.file == name_of[path]])
    }
    return ComparisonCase(models, flights, named, level, left_out=list(left_out or ()))


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


# A tube follows its flight: once the roll-out that it was drawn around has ended, its factor grows where the
# flight left it and shrinks slowly where not, so that the coverage of any flight approaches the nominal one
# (quantile tracking, see `monitor.adaptive`, with errors that become known a horizon later). It starts at the
# factor that was calibrated on flights left out.

# Samples between the starts of roll-outs, of a flight at 100 Hz.
START_EVERY = 10
# Horizons [s] that are always judged, where they are not beyond the one asked for.
JUDGED_S = (0.01, 0.1, 0.5)
# Names of the quantities in results: angles are given in degrees there.
_NAMES = {"attitude_rad": ("attitude_deg", float(np.degrees(1.0)))}


@dataclass(frozen=True)
class TubeMetrics:
    """Errors and tubes of a quantity at one horizon of a flight.

    Attributes:
        rms: root mean square of the error's norm.
        coverage: share of roll-outs that ended in their tube.
        width: mean over the roll-outs of the diameter of the ball that has the volume of the tube; at most a
            whole turn.
        fixed_coverage, fixed_width: of tubes that do not follow the flight.
        conformal_coverage, conformal_width: of split conformal prediction, balls of one size from the same
            errors of the same flights left out.
        conformal_tracked_coverage, conformal_tracked_width: of such balls that follow the flight.
    """

    rms: float
    coverage: float
    width: float
    fixed_coverage: float
    fixed_width: float
    conformal_coverage: float
    conformal_width: float
    conformal_tracked_coverage: float
    conformal_tracked_width: float


@dataclass(frozen=True)
class FlightRolloutMetrics:
    """A flight's roll-outs judged.

    Attributes:
        starts: number of roll-outs.
        left_out: number of starts after which a rotor speed was not measured, or samples are missing.
        position_measured: whether errors of position are against a measured position; else they are against
            the integrated velocity.
        in_sample: whether the model was identified on this flight, by its hash.
        horizons: by horizon in seconds and quantity, such as "0.5" and "position_m".
    """

    starts: int
    left_out: int
    position_measured: bool
    in_sample: bool
    horizons: dict[str, dict[str, TubeMetrics]]


@dataclass(frozen=True)
class RolloutEvaluation:
    """Roll-outs of a model on flights; the names of the attributes are the keys of the JSON file.

    Attributes:
        data_quality: remarks on the data, by flight.
        left_out: flights that were given and cannot be predicted.
    """

    quadpi_version: str
    model: str
    vehicle: str
    confidence: float
    horizon_s: float
    flights: dict[str, FlightRolloutMetrics]
    data_quality: dict[str, DataQuality]
    left_out: tuple[FlightLeftOut, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return asdict(self)


class RolledFlight(NamedTuple):
    """Roll-outs of a flight with their tubes, for figures.

    Attributes:
        name: of the flight.
        quality: remarks on its data.
        horizons_s: (H,).
        flight: that was flown, at about 100 Hz.
        rolled: paths, errors, and the matrices of the tubes' ellipsoids for covariances.
        factors: (W, H, 4) on the ellipsoids.
    """

    name: str
    quality: DataQuality
    horizons_s: tuple[float, ...]
    flight: RolloutFlight
    rolled: FlightRollouts
    factors: Array


def evaluate_rollouts(
    model: AerodynamicModel,
    paths: Sequence[Path],
    vehicle: Vehicle,
    *,
    horizon_s: float = 0.5,
    confidence: float | None = None,
    mapping: MappingOrOptions = None,
    progress: ReportProgress = ignore_progress,
    left_out: LeftOutFlights = None,
) -> tuple[list[RolledFlight], RolloutEvaluation]:
    """Predict flights ahead, open loop from every tenth sample, with the measured rotor speeds.

    Args:
        model: of the vehicle that flew.
        paths: bags or logs.
        vehicle: that flew.
        horizon_s: to predict to.
        confidence: of the tubes; default: the model's.
        mapping: of the files, see :func:`quadpi_core.logs.read_recording`.
        progress: called after each flight.
        left_out: the list to which flights that cannot be predicted are added; without it, the first is an
            error.

    Raises:
        ModelError: for a model that is no simulation, or of another vehicle; a horizon or confidence that is
            not calibrated; naming the flight, for one that is shorter than the horizon.
        LogError, SignalError: for what cannot be read or used, naming the file, and a flight present twice.
    """
    model.require(vehicle)
    rollouts = model.require_rollouts()
    require_horizon(horizon_s)
    level = model.confidence if confidence is None else confidence

    def ahead(_: None, file: FlightFile) -> tuple[str, RolledFlight, FlightRolloutMetrics]:
        flight = replace(read_flight(file.path, vehicle, model.cutoff_hz, mapping), name=file.name)
        rolled, judged = judge_flight(rollouts, flight, vehicle, horizon_s=horizon_s, confidence=level)
        in_sample = model.learned_from(flight.sha256)
        return flight.sha256, rolled, replace(judged, in_sample=in_sample)

    workers = Workers(1, progress=progress)
    task = "Predicting flights ahead"
    done = for_each_flight(ahead, paths, shared=None, task=task, workers=workers, left_out=left_out)
    flights = [(rolled, judged) for _, (_, rolled, judged) in once_each(done, itemgetter(0), left_out)]
    return [rolled for rolled, _ in flights], RolloutEvaluation(
        __version__,
        model.identity,
        model.vehicle,
        level,
        horizon_s,
        {rolled.name: judged for rolled, judged in flights},
        {rolled.name: rolled.quality for rolled, _ in flights},
        tuple(left_out or ()),
    )


def judge_flight(
    model: RolloutModel, flight: Flight, vehicle: Vehicle, *, horizon_s: float, confidence: float
) -> tuple[RolledFlight, FlightRolloutMetrics]:
    """Predict one flight, which passed the low-pass of the model, ahead; see :func:`evaluate_rollouts`.

    Raises:
        ModelError: for a horizon or confidence that is not calibrated; naming the flight, where it is shorter
            than the horizon or no roll-out has all rotor speeds.
    """
    rollout_flight = RolloutFlight.from_flight(flight, vehicle)
    step = rollout_flight.step
    # Those calibrated up to the one asked for, which is the last.
    times = tuple(sorted({horizon for horizon in HORIZONS_S if horizon < horizon_s} | {horizon_s}))
    horizons = horizon_steps(times, step)
    possible = len(range(0, len(rollout_flight.time) - int(horizons[-1]), START_EVERY))
    if possible <= 0:
        raise ModelError(
            f"{flight.source}: {len(rollout_flight.time) * step:.2f} s in the air, "
            f"shorter than the horizon of {horizon_s:g} s"
        )
    starts = rollout_flight.starts(int(horizons[-1]), START_EVERY)
    if len(starts) == 0:
        raise ModelError(
            f"{flight.source}: topic rotor_speeds: a rotor was not measured within {horizon_s:g} s "
            f"of every start"
        )
    assert model.calibration is not None
    rolled = model.roll(rollout_flight, starts, horizons)
    rolled = rolled._replace(covariance=model.calibration.shape.shaped(rolled.covariance))
    scores, norms = tube_scores(rolled.errors, rolled.covariance), error_norms(rolled.errors)
    unit = tube_radii(rolled.covariance)
    following = Following(
        (-(-horizons // START_EVERY)).tolist(), 1.0 - confidence, TRACKING_PER_S * START_EVERY * step
    )
    factors = model.calibration.factors(times, confidence)
    balls = model.calibration.radii(times, confidence)
    tubes = tracked_factors(scores, factors, following)
    tracked_balls = tracked_factors(norms, balls, following)
    # Sizes of the errors, those that tubes hold, and the radii of these.
    ways = {
        "": (scores, tubes, tubes * unit),
        "fixed_": (scores, factors, factors * unit),
        "conformal_": (norms, balls, np.broadcast_to(balls, norms.shape)),
        "conformal_tracked_": (norms, tracked_balls, tracked_balls),
    }
    metrics: dict[str, dict[str, TubeMetrics]] = {}
    for k, q in itertools.product(range(len(times)), range(len(QUANTITIES))):
        if times[k] not in (*JUDGED_S, horizon_s):
            continue
        name = list(QUANTITIES)[q]
        shown, scale = _NAMES.get(name, (name, 1.0))
        values = {"rms": scale * float(np.sqrt(np.mean(np.square(norms[:, k, q]))))}
        for way, (sizes, held, radii) in ways.items():
            values[f"{way}coverage"] = float(np.mean((sizes <= held)[:, k, q]))
            values[f"{way}width"] = scale * float(np.mean(2.0 * np.minimum(radii[:, k, q], LARGEST[q])))
        metrics.setdefault(f"{times[k]:g}", {})[shown] = TubeMetrics(**values)
    return (
        RolledFlight(flight.name, flight.quality, times, rollout_flight, rolled, tubes),
        FlightRolloutMetrics(
            len(starts), possible - len(starts), flight.position_measured, in_sample=False, horizons=metrics
        ),
    )
