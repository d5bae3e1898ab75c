# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How good prediction intervals are: the numbers of one model, and of several models side by side.

The names of the attributes are the keys of the JSON file that `--json` writes. A metric that is undefined is
None, `null` in the file, and never NaN.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from quadpi_core.brief_repr import brief_repr
from quadpi_core.evaluation import metrics
from quadpi_core.evaluation.alarm_assessment import AlarmAssessment
from quadpi_core.evaluation.metrics import RegimeBins
from quadpi_core.findings import DataQuality
from quadpi_core.flight_files import FlightLeftOut
from quadpi_core.models.interval_rules import LevelSupport


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
