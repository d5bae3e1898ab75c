# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Wrench models by the protocol of scikit-learn, in which each flight is one sample."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from quadpi_core import array_checks
from quadpi_core.errors import ArgumentError, ModelError
from quadpi_core.evaluation.metrics import r_squared
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.library import Guessable
from quadpi_core.library.flight_arrays import counted, html_table, new_axes
from quadpi_core.library.flights import Flights, flights_in
from quadpi_core.library.user_regressor import Regressor, RegressorModel, fitted_regressor, is_regressor
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.kind_registry import KINDS, kind_of
from quadpi_core.models.model_folder import damage_named, read_folder
from quadpi_core.models.model_kind import Evaluation, IdentifyOptions, Kind
from quadpi_core.models.regressors import load_pools, select_axes
from quadpi_core.records import brief_repr

Self = TypeVar("Self", bound="WrenchModel")

# A width needs flights left out, and models of the others.
_FEWEST_FLIGHTS = 2
_UNITS = ("N", "N", "N", "Nm", "Nm", "Nm")


class Interval(NamedTuple):
    """Bounds of prediction intervals: lower and upper (N, 6) N and Nm, columns Fx … Mz."""

    lower: Array
    upper: Array

    def __repr__(self) -> str:
        return brief_repr(self)


class ParameterError(ArgumentError, ValueError):
    """A parameter that an estimator does not have; scikit-learn's own raise ValueError."""


class StoredEstimator(str):
    """Name of the estimator of a model folder, which does not hold the estimator's options."""

    __slots__ = ()


def only_axes(values: Array, axes: Sequence[str]) -> Array:
    """Numbers (N, 6) of the axes that a model holds; NaN for the others, which it says nothing of."""
    return np.where(np.isin(AXES, axes), values, np.nan)


class WrenchModel(Guessable):
    """Aerodynamic forces and moments of a quadrotor, with prediction intervals calibrated by flight.

    By the protocol of scikit-learn, where X are :class:`Flights` and each flight is one sample: `clone`,
    `cross_val_score(model, flights, cv=LeaveOneOut())` and `GridSearchCV` split by flight. The same numbers
    as `quadpi identify` gives. scikit-learn itself is not needed.

    Args:
        estimator: "physical" (rotors, airframe; extrapolates best), "polynomial", "bootstrap" or another kind
            of model by name; a kind with its options, such as `Polynomial(stop="pse")`; or any regressor with
            `fit(X, y)` and `predict(X)`, of which each axis gets a copy: X (N, 19), y (N,).
        confidence: coverage of the intervals unless another is asked for.
        candidates: pools that some kinds choose from: a name in config/candidates, or a YAML file.
        axes: of the wrench, such as `["Fx", "Fz"]`; all unless given.
        keep_flawed: also learn from flights with a finding that says to leave them out.

    Attributes:
        model_: the fitted model: an `AerodynamicModel`, or the regressors by axis.
        axes_: names of its axes.
        left_out_: names of flights that were given to `fit` and not learned from.
    """

    model_: AerodynamicModel | RegressorModel
    left_out_: tuple[str, ...]

    def __init__(
        self,
        estimator: str | Kind | Regressor = "physical",
        confidence: float = 0.95,
        *,
        candidates: str | Path = "quadrotor",
        axes: Sequence[str] | None = None,
        keep_flawed: bool = False,
    ) -> None:
        self.estimator = estimator
        self.confidence = confidence
        self.candidates = candidates
        self.axes = axes
        self.keep_flawed = keep_flawed

    def fit(self: Self, flights: Flights, y: None = None) -> Self:
        """Identify the model; each flight is left out in turn to calibrate the intervals.

        Args:
            flights: two or more.
            y: None: flights hold what they measured.

        Raises:
            ArgumentError: for what are no flights, a `y`, and no estimator.
            ModelError: for what cannot be identified, naming flight or axis; for the estimator of a folder,
                whose options are not known.
        """
        given = flights_in("flights", flights)
        if y is not None:
            raise ArgumentError("y: expected None, as flights hold the wrench that they measured")
        array_checks.instance("keep_flawed", self.keep_flawed, bool)
        if isinstance(self.axes, str):
            raise ArgumentError(f"axes: expected a list of names, found {self.axes!r}")
        axes = self.axes.tolist() if isinstance(self.axes, np.ndarray) else self.axes
        if axes is not None and not (axes := array_checks.several("axes", axes, str)):
            raise ArgumentError(f"axes: expected some of {', '.join(AXES)}, found none; None is all")
        pools = select_axes(load_pools(self.candidates), None if axes is None else ",".join(axes))
        if isinstance(self.estimator, StoredEstimator):
            raise ModelError(
                f"estimator {self.estimator}: read from a folder, which does not hold its options, so it "
                "cannot be fitted again: WrenchModel(estimator=…) makes a model anew"
            )
        kind = self.estimator if isinstance(self.estimator, str | Kind) else None
        if kind is None and (isinstance(self.estimator, WrenchModel) or not is_regressor(self.estimator)):
            raise ArgumentError(
                "estimator: expected the name of a kind of model, a kind, or a regressor with fit and "
                f"predict, found {array_checks.description(self.estimator)}"
            )
        options = IdentifyOptions(cutoff_hz=given.cutoff_hz, method=kind, confidence=self.confidence)
        used = self._learned(given, 0.0 if kind is None else kind_of(options).shortest_s)
        self.left_out_ = tuple(name for name in given.names if name not in used.names)
        if not isinstance(self.estimator, str | Kind):
            self.model_ = fitted_regressor(
                self.estimator,
                used.prepared,
                used.vehicle,
                cutoff_hz=used.cutoff_hz,
                confidence=options.confidence,
                axes=[axis for axis in AXES if axis in pools],
            )
        else:
            self.model_ = identify(used.prepared, used.vehicle, pools, options)
            if self.model_.kind.is_simulation:
                # No other kind needs the room of the search.
                from quadpi_core.discrepancy.sound_learning import learned_from

                self.model_ = learned_from(self.model_, used.prepared)
        return self

    def _learned(self, flights: Flights, shortest_s: float) -> Flights:
        """The flights without those that no model should learn from, each of which is a warning."""
        usable = []
        for place, flight in enumerate(flights.prepared):
            if (why := flight.unfit(shortest_s, keep_flawed=self.keep_flawed)) is None:
                usable.append(place)
                continue
            hint = "; keep_flawed=True learns from it" if why == str(flight.quality.flaw) else ""
            warnings.warn(f"flight {flight.name} left out: {why}{hint}", stacklevel=3)
        if len(usable) < _FEWEST_FLIGHTS:
            others = "; the warnings say why others are left out" if len(usable) < len(flights) else ""
            raise ModelError(
                f"too few flights: {len(usable)} given, {_FEWEST_FLIGHTS} or more needed to calibrate{others}"
            )
        return flights[usable]

    def predict(self, flights: Flights) -> Array:
        """Forces and moments (N, 6) N and Nm of all samples, columns Fx … Mz; NaN for axes not held.

        Raises:
            ArgumentError: for what are no flights, such as bare arrays, and the lists of `cross_val_predict`.
            ModelError: before `fit`, and for flights of another vehicle or low-pass.
        """
        if isinstance(flights, list | tuple):
            raise ArgumentError(
                "flights: predictions are by sample, and cross_val_predict counts flights: loop over flights"
            )
        return self._held(self.evaluations(flights, None), "predicted")

    def predict_interval(self, flights: Flights, confidence: float | None = None) -> Interval:
        """Bounds between which a measurement lies with a confidence, the model's own unless given; or NaN.

        Raises:
            ArgumentError, ModelError: see :meth:`predict`; for a confidence that cannot be calibrated.
        """
        evaluations = self.evaluations(flights, confidence)
        return Interval(*(self._held(evaluations, name) for name in Interval._fields))

    def _held(self, evaluations: Sequence[Evaluation], name: str) -> Array:
        return only_axes(np.concatenate([getattr(one, name) for one in evaluations]), self.axes_)

    def evaluations(self, flights: Flights, confidence: float | None) -> list[Evaluation]:
        """Those of each flight, zero for axes not held; errors are those of :meth:`predict_interval`."""
        given = flights_in("flights", flights)
        model = self.fitted
        model.require(given.vehicle)
        if given.cutoff_hz != model.cutoff_hz:
            raise ModelError(
                f"flights: low-passed at {given.cutoff_hz:g} Hz, the model at {model.cutoff_hz:g}: "
                f"load_flights(…, cutoff_hz={model.cutoff_hz:g})"
            )
        if confidence is not None:
            confidence = array_checks.number("confidence", confidence)
        for flight in given.prepared:
            flight.require_finite()
        prepared = given.prepared
        if isinstance(model, AerodynamicModel) and model.wind is not None:
            # Slow to import, and most models have no wind to find.
            from quadpi_core.identification.found_wind import in_found_wind

            prepared = tuple(in_found_wind(flight, model.wind, given.vehicle) for flight in prepared)
        return [model.evaluate(flight, confidence) for flight in prepared]

    def score(self, flights: Flights, y: None = None) -> float:
        """Coefficient of determination R², the mean over the axes held; each over the samples of all flights.

        Raises:
            ArgumentError, ModelError: see :meth:`predict`; for an axis whose measurement is constant.
        """
        if y is not None:
            raise ArgumentError("y: expected None, as flights hold the wrench that they measured")
        predicted = self._held(self.evaluations(flights, None), "predicted")
        measured = flights_in("flights", flights).wrench
        scores = []
        for axis in self.axes_:
            column = AXES.index(axis)
            r2 = r_squared(measured[:, column], predicted[:, column])
            if r2 is None:
                raise ModelError(f"{axis}: constant in these flights, so R² is undefined")
            scores.append(r2)
        return float(np.mean(scores))

    def save(self: Self, folder: str | Path) -> Self:
        """Write the model as a folder of data, which `load_model` and every command of quadpi read.

        A regressor of your own is written where it is affine or made of trees, and read by `load_model`
        alone.

        Raises:
            ModelError: before `fit`; for any other regressor, which would be code.
            OutputError: if the folder cannot be written, or holds what is not part of a model.
        """
        model = self.fitted
        if isinstance(model, AerodynamicModel):
            self.model_ = model.save(folder)
        else:
            model.save(array_checks.path("folder", folder))
        return self

    @property
    def axes_(self) -> tuple[str, ...]:
        """Names of the axes held, in the order Fx … Mz."""
        return self.fitted.axes

    @property
    def fitted(self) -> AerodynamicModel | RegressorModel:
        """The fitted model; ModelError before `fit`."""
        if not hasattr(self, "model_"):
            raise ModelError("the model is not fitted: call fit(flights) first")
        return self.model_

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Constructor arguments by name; with `deep`, options of the estimator too, as `estimator__NAME`."""
        settings = {name: getattr(self, name) for name in inspect.signature(type(self)).parameters}
        if not deep:
            return settings
        if hasattr(self.estimator, "get_params"):
            nested = self.estimator.get_params(deep=True)
        else:
            nested = {} if (kind := self._kind()) is None else vars(kind)
        return settings | {f"estimator__{name}": value for name, value in nested.items()}

    def _kind(self) -> Kind | None:
        """The kind of model that `estimator` is or names; None for a regressor and what `fit` refuses."""
        if isinstance(self.estimator, str) and not isinstance(self.estimator, StoredEstimator):
            return KINDS.named(self.estimator)
        return self.estimator if isinstance(self.estimator, Kind) else None

    def set_params(self: Self, **params: Any) -> Self:
        """Change constructor arguments by name, `estimator` before what is nested in it.

        Raises:
            ParameterError: for a name that there is not.
        """
        for name, value in sorted(params.items(), key=lambda item: "__" in item[0]):
            if name not in self.get_params():
                raise ParameterError(f"unknown parameter {name!r}; known: {', '.join(self.get_params())}")
            inner = name.partition("__")[2]
            if not inner:
                setattr(self, name, value)
            elif (kind := self._kind()) is not None:
                self.estimator = replace(kind, **{inner: value})
            else:
                self.estimator.set_params(**{inner: value})  # type: ignore[union-attr]
        return self

    def __sklearn_tags__(self) -> Any:
        """What scikit-learn wants to know; only scikit-learn asks, so it is imported here."""
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            "regressor",
            TargetTags(required=False, multi_output=True),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(two_d_array=False),
        )

    def __sklearn_is_fitted__(self) -> bool:
        """Whether `fit` was called, for scikit-learn."""
        return hasattr(self, "model_")

    def __repr__(self) -> str:
        estimator = self.estimator if isinstance(self.estimator, str) else type(self.estimator).__name__
        if not hasattr(self, "model_"):
            return f"<WrenchModel {estimator:.40}, confidence {self.confidence!s:.12}, not fitted>"
        model = self.model_
        return (
            f"<WrenchModel {estimator:.40}, confidence {model.confidence:g}: {model.vehicle:.40}, "
            f"{' '.join(model.axes)}, {counted(len(model.flights))}>"
        )

    def _repr_html_(self) -> str:
        if not hasattr(self, "model_"):
            return html_table(repr(self), (), ())
        rows = [
            (axis, f"{np.mean(shares):.1%}", f"{min(shares):.1%}")
            for axis, shares in self.model_.held_out_coverage.items()
            if shares
        ]
        headings = ("axis", "coverage of flights left out", "of the worst of them")
        return html_table(f"{self!r} {self.model_.calibration()}", headings, rows)

    def plot(self, flights: Flights, confidence: float | None = None, axes: Any = None) -> Any:
        """Draw what one flight measured, and the intervals, over time; returns the axes of matplotlib.

        Args:
            flights: one flight.
            confidence: of the intervals; the model's own unless given.
            axes: of matplotlib, one for each axis of the wrench; a new figure unless given.

        Raises:
            ArgumentError, ModelError: see :meth:`predict`; for several flights.
            LogError: without matplotlib.
        """
        given = flights_in("flights", flights)
        if len(given) != 1:
            raise ArgumentError(f"flights: expected one to draw, found {len(given)}: flights[0] is the first")
        interval, measured = self.predict_interval(given, confidence), given.wrench
        axes = new_axes(axes, len(self.axes_))
        for own, axis in zip(axes, self.axes_, strict=True):
            column = AXES.index(axis)
            bounds = (bound[:, column] for bound in interval)
            own.fill_between(given.time, *bounds, alpha=0.4, label="interval")
            own.plot(given.time, measured[:, column], linewidth=0.7, color="black", label="measured")
            own.set_ylabel(f"{axis} [{_UNITS[column]}]")
        axes[0].legend(loc="upper right")
        axes[-1].set_xlabel("time [s]")
        return axes


def load_model(folder: str | Path) -> WrenchModel:
    """A model of `quadpi identify` or `WrenchModel.save`; nothing in the folder is executed.

    It predicts and is judged, but not fitted again: the folder does not hold the options of its estimator.

    Raises:
        ModelError: naming the file that is missing, altered or not understood.
    """
    folder = array_checks.path("folder", folder)
    content, _ = read_folder(folder)
    model: AerodynamicModel | RegressorModel
    if "regressor" in content.description:
        with damage_named(folder):
            model = RegressorModel.stored(content)
        estimator = model.regressor
    else:
        model = AerodynamicModel.load(folder)
        estimator = model.method
    read = WrenchModel(StoredEstimator(estimator), model.confidence, axes=list(model.axes))
    read.model_, read.left_out_ = model, ()
    return read
