# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How good prediction intervals are: the numbers of one model, and of several models side by side.

The names of the attributes are the keys of the JSON file that `--json` writes. A metric that is undefined is
None, `null` in the file, and never NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from quadpi_core.errors import ModelError, QuadpiError
from quadpi_core.evaluation import metrics
from quadpi_core.evaluation.alarm_assessment import AlarmAssessment, FlightAlarm, assess
from quadpi_core.evaluation.metrics import (
    RegimeBins,
    by_bin,
    coverage_interval,
    effective_sample_size,
    round_edges,
)
from quadpi_core.findings import DataQuality
from quadpi_core.flight import AXES
from quadpi_core.flight_files import FlightLeftOut
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES, VELOCITY_INPUTS
from quadpi_core.models.interval_rules import LevelSupport, inside_interval
from quadpi_core.models.kind_registry import kind_named
from quadpi_core.records import brief_repr
from quadpi_core.version import __version__


@dataclass(frozen=True)
class AxisMetrics:
    """Metrics of one axis of the wrench over all samples of a group or flight; widths in N or Nm.

    Attributes:
        picp: coverage, the fraction of measurements inside their interval.
        picp_ci: 95 % confidence interval of the coverage (low, high), see
            :func:`quadpi_core.evaluation.metrics.coverage_interval`.
        mpiw: mean width of the interval.
        nmpiw: mean width over the range of the measured training data.
        rmse: root mean square of measured − predicted.
        r2: coefficient of determination; None where the measurement is constant.
        winkler: Winkler score.
        cwc: coverage width criterion.
        crps: of the normal distribution that the interval implies; None for kinds of model that imply none.
        regimes: coverage and width in each bin between the edges of `Evaluation.regime_edges`.
        n: number of samples.
        n_eff: number of independent samples that the autocorrelated prediction errors are worth.
        calibration: coverage at each of `Evaluation.calibration_levels`; None where the model has no
            interval of that level.
    """

    picp: float
    picp_ci: Sequence[float]
    mpiw: float
    nmpiw: float
    rmse: float
    r2: float | None
    winkler: float
    cwc: float
    crps: float | None
    regimes: Mapping[str, RegimeBins]
    n: int
    n_eff: float
    calibration: Sequence[float | None]

    def covers_too_little(self, confidence: float) -> bool:
        """Whether the confidence interval of the coverage lies below the nominal coverage.

        That is beyond chance, but may be by less than a user would care about.
        """
        return self.picp_ci[1] < confidence


@dataclass(frozen=True)
class GroupEvaluation:
    """The metrics of one group of flights, by axis; the alarm is None where it was not run."""

    flights: Sequence[str]
    axes: Mapping[str, AxisMetrics]
    alarm: AlarmAssessment | None


@dataclass(frozen=True)
class FlightEvaluation:
    """The metrics of one flight, by axis; the alarm is None where it was not run.

    Attributes:
        sha256: hash of the flight; empty where not known.
        in_sample: whether the model was identified on this flight, by its hash and under whatever name.
    """

    duration_s: float
    axes: Mapping[str, AxisMetrics]
    alarm: AlarmAssessment | None
    sha256: str = ""
    in_sample: bool = False


@dataclass(frozen=True)
class CoverageWidthCriterion:
    """Parameters of the coverage width criterion: penalty and nominal coverage."""

    mu: float
    eta: float = metrics.CWC_ETA


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """The prediction intervals of a model, judged on flights.

    Attributes:
        quadpi_version: that evaluated.
        model: its identity.
        vehicle: name of the vehicle file.
        method: kind of model.
        adaptive: whether the intervals adapted to the measured wrench.
        confidence: nominal coverage of the intervals.
        training_range: range of the measured training data, by axis.
        nmpiw_denominator: key of what widths are divided by.
        cwc: parameters of the coverage width criterion.
        calibration_levels: confidences of the calibration curves.
        regime_edges: edges of the bins that all groups and flights share, by quantity.
        groups: by name.
        flights: by name.
        force_bandwidth_hz: at which the measured forces end, so that predicted forces are judged smoothed
            alike; None where they are judged as they are.
        data_quality: remarks on the data, by flight.
        left_out: flights that were given and cannot be used.
        support: which level the flights that calibrated the intervals support; None where they adapt.
    """

    __repr__ = brief_repr

    quadpi_version: str
    model: str
    vehicle: str
    method: str
    adaptive: bool
    confidence: float
    training_range: Mapping[str, float]
    nmpiw_denominator: str = "training_range"
    cwc: CoverageWidthCriterion
    calibration_levels: Sequence[float]
    regime_edges: Mapping[str, Sequence[float]]
    groups: Mapping[str, GroupEvaluation]
    flights: Mapping[str, FlightEvaluation]
    force_bandwidth_hz: float | None = None
    data_quality: Mapping[str, DataQuality] = field(default_factory=dict)
    left_out: Sequence[FlightLeftOut] = field(default_factory=list)
    support: LevelSupport | None = None

    def in_sample(self, group: str) -> list[str]:
        """Names of the flights of a group that the model was identified on."""
        return [flight for flight in self.groups[group].flights if self.flights[flight].in_sample]

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class ComparedEvaluation(Evaluation):
    """The evaluation of one of several models, with its settings and the low-pass of its flights."""

    settings: str
    cutoff_hz: float


@dataclass(frozen=True)
class Comparison:
    """Several models of one vehicle, judged on the same groups of flights.

    Attributes:
        quadpi_version: that compared.
        vehicle: name of the vehicle file.
        confidence: nominal coverage of the intervals.
        adaptive: whether the intervals adapted to the measured wrench.
        groups: names of the flights in each group.
        published: always None, a key that readers of the JSON file may expect.
        models: by name.
        left_out: flights that were given and cannot be used.
    """

    quadpi_version: str
    vehicle: str
    confidence: float
    adaptive: bool
    groups: Mapping[str, Sequence[str]]
    published: None = field(default=None, kw_only=True)
    models: Mapping[str, ComparedEvaluation]
    left_out: Sequence[FlightLeftOut] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """As JSON holds it."""
        return asdict(self)


# Confidences of the calibration curve.
LEVELS = (0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
# Quantities by which coverage is binned, see FlightResult.regimes.
REGIMES = ("speed_m_s", "rotor_speed_rad_s", "height_m")


class EvaluationError(QuadpiError):
    """Flights, groups and model do not fit together."""


@dataclass(frozen=True)
class FlightResult:
    """Predictions and intervals of a model on one flight; columns Fx, Fy, Fz (N), Mx, My, Mz (Nm), body axes.

    Attributes:
        name: of the flight.
        axes: axes that the model holds; predicted, lower and upper are void for the others.
        time: (N,) seconds.
        measured, predicted, lower, upper: (N, 6).
        inputs: (N, 19), columns as :data:`quadpi_core.inputs.INPUT_NAMES`.
        height: (N,) m above the origin of the world.
        alarm: the alarm at each sample of a monitor; None where it was not run.
        sha256: hash of the flight; empty where not known.
        in_sample: whether the model was identified on this flight, by its hash.
    """

    __repr__ = brief_repr

    name: str
    axes: tuple[str, ...]
    time: Array
    measured: Array
    predicted: Array
    lower: Array
    upper: Array
    inputs: Array
    height: Array
    alarm: FlightAlarm | None = None
    sha256: str = ""
    in_sample: bool = False

    def __len__(self) -> int:
        return len(self.time)

    @property
    def speed(self) -> Array:
        """(N,) m/s relative to the air."""
        return np.asarray(np.linalg.norm(self.inputs[:, VELOCITY_INPUTS], axis=1))

    @property
    def regimes(self) -> dict[str, Array]:
        """Quantities (N,) by which coverage is binned."""
        values = (self.speed, self.inputs[:, INPUT_INDEX["omega_avg"]], self.height)
        return dict(zip(REGIMES, values, strict=True))

    def column(self, quantity: str, axis: str) -> Array:
        """One axis (N,) of `measured`, `predicted`, `lower` or `upper`."""
        return getattr(self, quantity)[:, AXES.index(axis)]

    def check(self) -> None:
        """Refuse samples for which metrics are undefined.

        Raises:
            EvaluationError: naming flight, axis and sample, for no samples, a value that is not finite,
                bounds that cross, and shapes that do not fit.
        """
        if len(self) == 0:
            raise EvaluationError(f"flight {self.name}: holds no samples")
        for axis in self.axes:
            lower, upper = self.column("lower", axis), self.column("upper", axis)
            for quantity in ("measured", "predicted", "lower", "upper"):
                finite = np.isfinite(self.column(quantity, axis))
                if not finite.all():
                    sample = int(np.argmin(finite))
                    raise EvaluationError(
                        f"flight {self.name}: {axis}: sample {sample}: {quantity} not finite"
                    )
            if np.any(lower > upper):
                sample = int(np.argmax(lower > upper))
                raise EvaluationError(f"flight {self.name}: {axis}: sample {sample}: lower bound above upper")
        if self.inputs.shape != (len(self), len(INPUT_NAMES)):
            raise EvaluationError(f"flight {self.name}: inputs of shape {self.inputs.shape}")
        for quantity, values in self.regimes.items():
            if values.shape != (len(self),) or not np.all(np.isfinite(values)):
                raise EvaluationError(f"flight {self.name}: {quantity} not finite, or not one per sample")


def evaluate_flights(
    results: Sequence[FlightResult],
    groups: Mapping[str, Sequence[str]],
    training_range: Mapping[str, float],
    confidence: float,
    *,
    model: str,
    vehicle: str,
    method: str = "polynomial",
    adaptive: bool = False,
    at_confidence: Callable[[float], Iterable[FlightResult]] | None = None,
) -> Evaluation:
    """Judge the intervals on each flight and on each group of flights.

    Args:
        results: one per flight.
        groups: names of the flights in each group; a flight may be in several.
        training_range: range (max − min) of the measured training data per axis.
        confidence: nominal coverage of the intervals, between 0 and 1.
        model: identity of the model.
        vehicle: name of the vehicle file.
        method: of the model.
        adaptive: whether the intervals adapted to the measurement; only recorded.
        at_confidence: gives the results of the same flights with intervals of another confidence, or raises
            ModelError where there are none; without it there is no calibration curve.

    Raises:
        EvaluationError: for no flights, a flight present twice, an empty group, a group with an unknown
            flight, a training range that is not positive, and what :meth:`FlightResult.check` refuses.
    """
    if not results:
        raise EvaluationError("no flights to judge: at least one is needed")
    by_name: dict[str, FlightResult] = {}
    for result in results:
        if result.name in by_name:
            raise EvaluationError(f"flight {result.name}: present twice")
        result.check()
        by_name[result.name] = result
    members = {name: _members(name, flights, by_name) for name, flights in groups.items()}
    for axis, extent in training_range.items():
        if not 0.0 < extent < np.inf:
            raise EvaluationError(f"{axis}: the measured training data spans {extent}, so nmpiw is undefined")
    edges = {
        name: round_edges(np.concatenate([result.regimes[name] for result in results])) for name in REGIMES
    }
    curve = [_covered(at_confidence, level) for level in LEVELS]

    def metrics_of(flights: Sequence[FlightResult]) -> dict[str, AxisMetrics]:
        axes = [axis for axis in AXES if all(axis in flight.axes for flight in flights)]
        normal = kind_named(method).normal_errors
        return {
            axis: _evaluate_axis(flights, axis, training_range[axis], confidence, normal, edges, curve)
            for axis in axes
        }

    return Evaluation(
        quadpi_version=__version__,
        model=model,
        vehicle=vehicle,
        method=method,
        adaptive=adaptive,
        confidence=confidence,
        training_range=dict(training_range),
        cwc=CoverageWidthCriterion(mu=confidence),
        calibration_levels=list(LEVELS),
        regime_edges={quantity: values.tolist() for quantity, values in edges.items()},
        groups={
            name: GroupEvaluation([flight.name for flight in flights], metrics_of(flights), _assess(flights))
            for name, flights in members.items()
        },
        flights={
            name: FlightEvaluation(
                float(flight.time[-1] - flight.time[0]),
                metrics_of([flight]),
                _assess([flight]),
                flight.sha256,
                flight.in_sample,
            )
            for name, flight in by_name.items()
        },
    )


def _assess(flights: Sequence[FlightResult]) -> AlarmAssessment | None:
    """The alarm on the flights; None where it was not run on all of them."""
    alarms = [flight.alarm for flight in flights if flight.alarm is not None]
    return assess(alarms) if len(alarms) == len(flights) else None


def _evaluate_axis(
    flights: Sequence[FlightResult],
    axis: str,
    training_range: float,
    confidence: float,
    normal: bool,
    edges: Mapping[str, Array],
    curve: Sequence[Mapping[tuple[str, str], float] | None],
) -> AxisMetrics:
    """Metrics of one axis over the samples of all `flights`."""
    measured, predicted, lower, upper = (
        np.concatenate([flight.column(quantity, axis) for flight in flights])
        for quantity in ("measured", "predicted", "lower", "upper")
    )
    regime = {name: np.concatenate([flight.regimes[name] for flight in flights]) for name in edges}
    labels = np.repeat(np.arange(len(flights)), [len(flight) for flight in flights])
    inside = inside_interval(measured, lower, upper)
    errors = measured - predicted
    std = metrics.implied_std(lower, upper, confidence)
    return AxisMetrics(
        picp=metrics.picp(measured, lower, upper),
        picp_ci=list(coverage_interval(inside, errors, labels)),
        mpiw=metrics.mpiw(lower, upper),
        nmpiw=metrics.nmpiw(lower, upper, training_range),
        rmse=metrics.rmse(measured, predicted),
        r2=metrics.r_squared(measured, predicted),
        winkler=metrics.winkler(measured, lower, upper, confidence),
        cwc=metrics.cwc(measured, lower, upper, training_range, confidence),
        crps=metrics.crps_normal(measured, predicted, std) if normal else None,
        regimes={name: by_bin(regime[name], inside, upper - lower, edges[name]) for name in edges},
        n=len(measured),
        n_eff=effective_sample_size(errors, labels),
        calibration=[_pooled(covered, flights, axis) for covered in curve],
    )


def _covered(
    at_confidence: Callable[[float], Iterable[FlightResult]] | None, level: float
) -> dict[tuple[str, str], float] | None:
    """Coverage by flight and axis at another confidence; None where the model has no such intervals."""
    if at_confidence is None:
        return None
    try:
        return {
            (result.name, axis): metrics.picp(
                *(result.column(quantity, axis) for quantity in ("measured", "lower", "upper"))
            )
            for result in at_confidence(level)
            for axis in result.axes
        }
    except ModelError:
        return None


def _pooled(
    covered: Mapping[tuple[str, str], float] | None, flights: Sequence[FlightResult], axis: str
) -> float | None:
    """Coverage over the samples of all flights."""
    if covered is None:
        return None
    return float(
        np.average(
            [covered[flight.name, axis] for flight in flights], weights=[len(flight) for flight in flights]
        )
    )


def _members(group: str, names: Sequence[str], by_name: Mapping[str, FlightResult]) -> list[FlightResult]:
    if not names:
        raise EvaluationError(f"group {group}: holds no flights")
    for name in names:
        if name not in by_name:
            raise EvaluationError(f"group {group}: no flight {name}; evaluated: {', '.join(by_name)}")
    if len(set(names)) < len(names):
        raise EvaluationError(f"group {group}: a flight is present twice")
    return [by_name[name] for name in names]
