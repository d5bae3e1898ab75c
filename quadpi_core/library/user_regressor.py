# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A wrench model made of a user's own regressor, one per axis, with intervals calibrated by flight.

The intervals are those of :mod:`quadpi_core.models.interval_rules`: each flight is left out in turn, and the
width is what covers the flights left out, the same at every input. Such a model is for use offline: the
monitor takes kinds of model alone (docs/add-a-kind-of-model.md).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Protocol

import numpy as np

from quadpi_core import array_checks
from quadpi_core.config_schema import NotEmpty, OneOf, Real, Text, parse_config
from quadpi_core.errors import ModelError, QuadpiError, one_line
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.library.stored_regressor import StoredRegressor, stored_form
from quadpi_core.models.aerodynamic import TrainingFlight
from quadpi_core.models.interval_rules import (
    FlightErrors,
    HeldOutRule,
    StoredRule,
    calibrate,
    inside_range,
    require_confidence,
)
from quadpi_core.models.model_folder import FolderContent, write_folder
from quadpi_core.models.model_kind import Evaluation, named_arrays
from quadpi_core.parallel import one_blas_thread
from quadpi_core.vehicle import Vehicle


class Regressor(Protocol):
    """What is needed of a regressor; those of scikit-learn are such."""

    def fit(self, X: Array, y: Array, /) -> Any:
        """Fit inputs (N, 19) to one axis (N,) of the wrench."""

    def predict(self, X: Array, /) -> Any:
        """Predictions (N,)."""


def is_regressor(given: object) -> bool:
    """Whether it is an object that can be fitted and predicts."""
    return not isinstance(given, type) and all(callable(getattr(given, n, None)) for n in ("fit", "predict"))


@dataclass(frozen=True)
class _Axis:
    """What a folder keeps of an axis beside arrays."""

    form: Text
    rule: StoredRule
    training_range: Real
    held_out_coverage: tuple[Real, ...]


@dataclass(frozen=True, kw_only=True)
class _Description:
    """The content of model.json."""

    regressor: Text
    vehicle: Text
    vehicle_fingerprint: Text
    cutoff_hz: Real
    confidence: Real
    axes: Annotated[dict[Annotated[str, OneOf(*AXES)], _Axis], NotEmpty()]
    flights: tuple[TrainingFlight, ...]
    arrays_sha256: str


# Compared and hashed by identity: arrays have no truth value.
@dataclass(frozen=True, eq=False)
class RegressorModel:
    """Fitted regressors by axis, and all that belongs to them.

    Attributes:
        regressor: name of its class.
        fitted: regressors by axis, in the order of `AXES`.
        rules: of the intervals, by axis; the spread is 1 N or Nm everywhere.
        training_range: per axis, range (max − min) of the measured training data.
        held_out_coverage: per axis, the coverage of each flight by regressor and intervals of the others.
        flights: that it was fitted to.
        sample: (M, 19) inputs that it was fitted to, by which a stored form is checked; none where it was
            read from a folder.
    """

    method: ClassVar[str] = "regressor"
    regressor: str
    vehicle: str
    vehicle_fingerprint: str
    cutoff_hz: float
    confidence: float
    fitted: Mapping[str, Regressor]
    rules: Mapping[str, HeldOutRule]
    training_range: Mapping[str, float]
    held_out_coverage: Mapping[str, list[float]]
    flights: tuple[TrainingFlight, ...]
    sample: Array

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes held, in the order of `AXES`."""
        return tuple(axis for axis in AXES if axis in self.fitted)

    def require(self, vehicle: Vehicle) -> None:
        """Refuse a vehicle other than the one of its flights.

        Raises:
            ModelError: if name or numbers differ.
        """
        if vehicle.fingerprint != self.vehicle_fingerprint:
            raise ModelError(f"the model is of vehicle {self.vehicle} as its flights had it: {vehicle.name}")

    def evaluate(self, flight: PreparedFlight, confidence: float | None = None) -> Evaluation:
        """Predictions and bounds (N, 6) of a flight; no evidence for an alarm.

        Raises:
            ModelError: for a confidence that cannot be calibrated, and predictions that are not finite.
        """
        level = self.confidence if confidence is None else confidence
        evaluation = Evaluation(*np.zeros((5, len(flight.time), len(AXES))))
        with one_blas_thread():
            for axis, regressor in self.fitted.items():
                column, half = AXES.index(axis), self.rules[axis].factor(level)
                centre = predictions(regressor, flight.inputs)
                evaluation.predicted[:, column] = centre
                evaluation.lower[:, column], evaluation.upper[:, column] = centre - half, centre + half
        return evaluation

    def calibration(self) -> str:
        """A sentence that says how the width of the intervals was calibrated."""
        total, inside = len(self.flights), min(rule.flights_inside for rule in self.rules.values())
        return f"intervals calibrated on {inside} of {total} flights, each left out in turn"

    def save(self, folder: str | Path) -> None:
        """Write the model as a folder of numbers.

        Raises:
            ModelError: for a regressor that is no numbers to quadpi, see :func:`.stored_form`.
            OutputError: if the folder cannot be written.
        """
        axes: dict[str, Any] = {}
        arrays: dict[str, Array] = {}
        for axis, fitted in self.fitted.items():
            form = stored_form(fitted, self.sample, self.regressor)
            axes[axis] = {
                "form": form.form,
                "rule": self.rules[axis].to_json(),
                "training_range": self.training_range[axis],
                "held_out_coverage": self.held_out_coverage[axis],
            }
            arrays |= {f"{axis}.{name}": values for name, values in form.arrays().items()}
        names = ("regressor", "vehicle", "vehicle_fingerprint", "cutoff_hz", "confidence")
        description = {name: getattr(self, name) for name in names}
        flights = [flight.to_json() for flight in self.flights]
        write_folder(FolderContent({**description, "axes": axes, "flights": flights}, arrays), Path(folder))

    @classmethod
    def stored(cls, content: FolderContent) -> RegressorModel:
        """What :meth:`save` wrote.

        Raises:
            ModelError: for what no fit gives.
        """
        described = parse_config(_Description, content.description, "model.json", ModelError)
        rules = {axis: own.rule for axis, own in described.axes.items()}
        if not all(isinstance(rule, HeldOutRule) for rule in rules.values()):
            raise ModelError("model.json: a regressor has intervals of held-out flights alone")
        return cls(
            regressor=described.regressor,
            vehicle=described.vehicle,
            vehicle_fingerprint=described.vehicle_fingerprint,
            cutoff_hz=described.cutoff_hz,
            confidence=described.confidence,
            fitted={
                axis: StoredRegressor.stored(own.form, named_arrays(content.arrays, axis))
                for axis, own in described.axes.items()
            },
            rules={axis: rule for axis, rule in rules.items() if isinstance(rule, HeldOutRule)},
            training_range={axis: own.training_range for axis, own in described.axes.items()},
            held_out_coverage={axis: list(own.held_out_coverage) for axis, own in described.axes.items()},
            flights=described.flights,
            sample=np.empty((0, len(INPUT_NAMES))),
        )


def predictions(regressor: Regressor, X: Array) -> Array:
    """Predictions (N,) of a regressor.

    Raises:
        ModelError: for predictions of another shape or not finite, and for any error of the regressor.
    """
    name = type(regressor).__name__
    with _named(regressor):
        values = np.asarray(regressor.predict(X))
    if values.size != len(X) or values.dtype.kind not in "iuf":
        raise ModelError(f"{name}: predicts {array_checks.found(values)} for {len(X)} samples")
    if not np.isfinite(values).all():
        raise ModelError(f"{name}: sample {np.argmin(np.isfinite(values.ravel()))}: prediction is not finite")
    return values.astype(float).reshape(len(X))


@contextmanager
def _named(regressor: Regressor) -> Iterator[None]:
    """Name the regressor in what it raises, which remains the cause."""
    try:
        yield
    except QuadpiError:
        raise
    except Exception as error:
        name, kind = type(regressor).__name__, type(error).__name__
        raise ModelError(f"estimator {name}: {kind}: {one_line(error)}") from error


def fitted_regressor(
    regressor: Regressor,
    flights: Sequence[PreparedFlight],
    vehicle: Vehicle,
    *,
    cutoff_hz: float,
    confidence: float,
    axes: Sequence[str],
) -> RegressorModel:
    """Fit a copy of a regressor to each axis, and calibrate its intervals on each flight left out in turn.

    Raises:
        ModelError: for samples that are not finite, and a confidence that cannot be
            calibrated.
    """
    require_confidence(confidence, calibrated=True)
    for flight in flights:
        flight.require_finite()
    X = np.concatenate([flight.inputs for flight in flights])
    wrench = np.concatenate([flight.wrench for flight in flights])
    of = np.repeat(np.arange(len(flights)), [len(flight.time) for flight in flights])
    places = [of == k for k in range(len(flights))]
    fitted, rules, coverage = {}, {}, {}
    with one_blas_thread():
        for axis in axes:
            y = wrench[:, AXES.index(axis)]
            held_out = [
                _errors(_fit(regressor, X[~out], y[~out]), X[out], y[out], inside_range(X[out], of=X[~out]))
                for out in places
            ]
            fitted[axis] = _fit(regressor, X, y)
            everywhere = [np.ones(int(place.sum()), dtype=np.bool_) for place in places]
            trained = [
                _errors(fitted[axis], X[own], y[own], inside)
                for own, inside in zip(places, everywhere, strict=True)
            ]
            rules[axis] = calibrate(held_out, trained)
            coverage[axis] = rules[axis].held_out_coverage(held_out, confidence).tolist()
    return RegressorModel(
        regressor=type(regressor).__name__,
        vehicle=vehicle.name,
        vehicle_fingerprint=vehicle.fingerprint,
        cutoff_hz=cutoff_hz,
        confidence=confidence,
        fitted=fitted,
        rules=rules,
        training_range={axis: float(np.ptp(wrench[:, AXES.index(axis)])) for axis in axes},
        held_out_coverage=coverage,
        flights=tuple(TrainingFlight(f.name, f.sha256, len(f.time), f.air) for f in flights),
        sample=X,
    )


def _fit(regressor: Regressor, X: Array, y: Array) -> Regressor:
    copy = deepcopy(regressor)
    with _named(copy):
        copy.fit(X, y)
    return copy


def _errors(regressor: Regressor, X: Array, y: Array, inside: Any) -> FlightErrors:
    """Errors on one flight, with a spread of 1 N or Nm: the rule makes it as wide as they need."""
    return FlightErrors(y - predictions(regressor, X), np.ones(len(y)), inside)
