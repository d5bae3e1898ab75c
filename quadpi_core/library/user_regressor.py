# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A wrench model made of a user's own regressor, one per axis, with intervals calibrated by flight.

The intervals are those of :mod:`quadpi_core.models.interval_rules`: each flight is left out in turn, and the
width is what covers the flights left out, the same at every input. Such a model is for use offline: the
monitor takes kinds of model alone (docs/add-a-kind-of-model.md).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, fields, replace
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

# How far a stored form may be from its regressor, as a share of the spread of its predictions: rounding of
# sums in another order, and nothing that a user could see. It is compared on the samples that it was fitted
# to, and as many times further from their mean.
_SAME = 1e-9
_FAR = 10.0
_INPUTS = len(INPUT_NAMES)


class StoredRegressor(ABC):
    """Base of the forms; each is a frozen dataclass of arrays."""

    form: ClassVar[str]

    @abstractmethod
    def predict(self, X: Array) -> Array:
        """Predictions (N,) for inputs (N, 19)."""

    def fit(self, X: Array, y: Array) -> Any:  # noqa: ARG002 - the signature of all regressors
        """Refused by a ModelError: only the result of a fit is stored."""
        raise ModelError("a regressor read from a folder cannot be fitted again: make the model anew")

    def arrays(self) -> dict[str, Array]:
        """The arrays of a folder, by name."""
        return {name: np.asarray(values, dtype=float) for name, values in vars(self).items()}

    @staticmethod
    def stored(form: str, arrays: Mapping[str, Array]) -> StoredRegressor:
        """A regressor of a folder.

        Raises:
            ModelError: for an unknown form, and arrays that do not fit each other.
        """
        known: dict[str, type[Affine | Trees]] = {form.form: form for form in (Affine, Trees)}
        if form not in known:
            raise ModelError(f"unknown form of a regressor {form!r}; known: {', '.join(known)}")
        names = [column.name for column in fields(known[form])]
        if set(arrays) != set(names):
            raise ModelError(f"{form}: expected arrays {', '.join(names)}, found {', '.join(arrays)}")
        return known[form](**arrays)


@dataclass(frozen=True)
class Affine(StoredRegressor):
    """coefficients (20,): of the 19 inputs, and a constant."""

    form: ClassVar[str] = "affine"
    coefficients: Array

    def __post_init__(self) -> None:
        """Refuse another number of coefficients."""
        if self.coefficients.shape != (_INPUTS + 1,):
            raise ModelError(f"affine: coefficients of shape {self.coefficients.shape}")

    def predict(self, X: Array) -> Array:
        """See the base class."""
        return X @ self.coefficients[:-1] + self.coefficients[-1]


@dataclass(frozen=True)
class Trees(StoredRegressor):
    """Sum of decision trees; M nodes of all trees, whose children come after them.

    Attributes:
        feature: (M,) input that a node asks for; negative in a leaf.
        threshold: (M,) an input up to it goes left, as a number of single precision.
        left, right: (M,) children.
        value: (M,) of a leaf, as it adds to the sum.
        roots: (T,) first node of each tree.
        constant: (1,) added to the sum.
    """

    form: ClassVar[str] = "trees"
    feature: Array
    threshold: Array
    left: Array
    right: Array
    value: Array
    roots: Array
    constant: Array

    def __post_init__(self) -> None:
        """Refuse what is no tree: every walk must end, at a node that there is."""
        nodes = self.feature.size
        numbers = np.arange(nodes)
        asks = self.feature >= 0
        fits = (
            all(
                getattr(self, name).shape == (nodes,)
                for name in ("feature", "threshold", "left", "right", "value")
            )
            and self.constant.shape == (1,)
            and self.roots.ndim == 1
            and all(
                np.all(np.isfinite(at) & (at == np.rint(at)))
                for at in (self.feature, self.left, self.right, self.roots)
            )
            and np.all(self.feature < _INPUTS)
            and np.all((self.roots >= 0) & (self.roots < nodes))
            and all(np.all((to > numbers)[asks] & (to < nodes)[asks]) for to in (self.left, self.right))
        )
        if not fits:
            raise ModelError("trees: arrays that are no decision trees")

    def predict(self, X: Array) -> Array:
        """See the base class."""
        feature, left, right = (column.astype(np.int64) for column in (self.feature, self.left, self.right))
        single, rows = X.astype(np.float32), np.arange(len(X))
        total = np.full(len(X), self.constant[0])
        for root in self.roots.astype(np.int64):
            node = np.full(len(X), root)
            asking = rows
            while len(asking := asking[feature[node[asking]] >= 0]):
                at = node[asking]
                goes_left = single[asking, feature[at]] <= self.threshold[at]
                node[asking] = np.where(goes_left, left[at], right[at])
            total += self.value[node]
        return total


def stored_form(regressor: Any, X: Array, name: str) -> StoredRegressor:
    """The arrays that predict as a fitted regressor does on the inputs (N, 19) that it was fitted to.

    Affine maps are found by what they predict, whatever they are made of; trees by the attribute `tree_` that
    those of scikit-learn have, alone or in an ensemble that sums or averages them.

    Raises:
        ModelError: for any other regressor: its folder would have to hold code.
    """
    if isinstance(regressor, StoredRegressor):
        return regressor
    # Far from the samples too: what is affine among them alone is another regressor.
    X = np.vstack((X, X.mean(axis=0) + _FAR * (X - X.mean(axis=0))))
    expected = np.asarray(regressor.predict(X), dtype=float).ravel()
    allowed = _SAME * max(float(np.ptp(expected)), np.finfo(float).tiny)
    for form in _forms(regressor, X, expected):
        if np.max(np.abs(form.predict(X) - expected)) <= allowed:
            return form
    raise ModelError(
        f"estimator {name}: neither affine nor made of trees, so it can be stored as code alone, which model "
        "folders never hold: keep it in memory, or see docs/add-a-kind-of-model.md"
    )


def _forms(regressor: Any, X: Array, expected: Array) -> Iterator[StoredRegressor]:
    """Forms that may be right, the simplest first."""
    # Around the middle of the samples: far from them trees are constant, and roundings large.
    middle, step = X.mean(axis=0), np.maximum(X.std(axis=0), np.finfo(float).tiny)
    asked = np.asarray(regressor.predict(np.vstack((middle, middle + np.diag(step)))), dtype=float).ravel()
    slopes = (asked[1:] - asked[0]) / step
    yield Affine(np.append(slopes, asked[0] - slopes @ middle))
    members = getattr(regressor, "estimators_", [regressor])
    trees: list[Any] = [
        getattr(member, "tree_", None) for member in np.ravel(np.array(members, dtype=object))
    ]
    if None in trees or any(tree.n_features != _INPUTS for tree in trees):
        return
    begins = np.cumsum([0, *(tree.node_count for tree in trees)])
    parts = zip(trees, begins, strict=False)
    left, right = zip(*((tree.children_left + b, tree.children_right + b) for tree, b in parts), strict=True)
    summed = Trees(
        np.concatenate([tree.feature for tree in trees]).astype(float),
        np.concatenate([tree.threshold for tree in trees]).astype(float),
        np.concatenate(left).astype(float),
        np.concatenate(right).astype(float),
        np.concatenate([tree.value[:, 0, 0] for tree in trees]),
        begins[:-1].astype(float),
        np.zeros(1),
    )
    # A mean of trees, a sum that learns slowly, with a constant or without: told by what is predicted.
    total = summed.predict(X)
    columns = np.stack((total, np.ones_like(total)), axis=1)
    scale, constant = np.linalg.lstsq(columns, expected, rcond=None)[0]
    yield replace(summed, value=scale * summed.value, constant=np.array([constant]))


class Regressor(Protocol):
    """What is needed of a regressor; those of scikit-learn are such."""

    def fit(self, X: Array, y: Array, /) -> Any:
        """Fit inputs (N, 19) to one axis (N,) of the wrench."""

    def predict(self, X: Array, /) -> Any:
        """Predictions (N,)."""


def is_regressor(given: object) -> bool:
    """Whether it is an object that can be fitted and predicts."""
    return not isinstance(given, type) and all(callable(getattr(given, n, None)) for n in ("fit", "predict"))


# What model.json says as it is.
_SAID = ("regressor", "vehicle", "vehicle_fingerprint", "cutoff_hz", "confidence")


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
        description = {name: getattr(self, name) for name in _SAID}
        flights = [flight.to_json() for flight in self.flights]
        write_folder(FolderContent({**description, "axes": axes, "flights": flights}, arrays), Path(folder))

    @classmethod
    def stored(cls, content: FolderContent) -> RegressorModel:
        """What :meth:`save` wrote.

        Raises:
            ModelError: for what no fit gives.
        """
        described = parse_config(_Description, content.description, "model.json", ModelError)
        rules = {axis: own.rule for axis, own in described.axes.items() if isinstance(own.rule, HeldOutRule)}
        if len(rules) < len(described.axes):
            raise ModelError("model.json: a regressor has intervals of held-out flights alone")
        return cls(
            **{name: getattr(described, name) for name in _SAID},
            fitted={
                axis: StoredRegressor.stored(own.form, named_arrays(content.arrays, axis))
                for axis, own in described.axes.items()
            },
            rules=rules,
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
    with _named(name):
        values = np.asarray(regressor.predict(X))
    if values.size != len(X) or values.dtype.kind not in "iuf":
        raise ModelError(f"{name}: predicts {array_checks.description(values)} for {len(X)} samples")
    if not np.isfinite(values).all():
        raise ModelError(f"{name}: sample {np.argmin(np.isfinite(values.ravel()))}: prediction is not finite")
    return values.astype(float).reshape(len(X))


@contextmanager
def _named(regressor: str) -> Iterator[None]:
    """Name the regressor in what it raises, which remains the cause."""
    try:
        yield
    except QuadpiError:
        raise
    except Exception as error:
        raise ModelError(f"estimator {regressor}: {type(error).__name__}: {one_line(error)}") from error


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
            trained = [_errors(fitted[axis], X[own], y[own], np.ones(own.sum(), np.bool_)) for own in places]
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
    with _named(type(copy).__name__):
        copy.fit(X, y)
    return copy


def _errors(regressor: Regressor, X: Array, y: Array, inside: Any) -> FlightErrors:
    """Errors on one flight, with a spread of 1 N or Nm: the rule makes it as wide as they need."""
    return FlightErrors(y - predictions(regressor, X), np.ones(len(y)), inside)
