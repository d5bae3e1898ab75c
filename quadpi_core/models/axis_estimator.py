# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regression of one axis with prediction intervals, by the protocol of scikit-learn."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import FlightErrors, HeldOutRule
from quadpi_core.models.model_kind import Fit

Self = TypeVar("Self", bound="AxisEstimator")

# Number of contiguous parts that replace flights where samples are not grouped.
_PARTS_WITHOUT_GROUPS = 5


def flight_labels(groups: npt.ArrayLike | None, samples: int) -> npt.NDArray[Any]:
    """Labels (N,) of the flights of samples; the number of a contiguous part where flights are not known.

    Raises:
        ModelError: for another number of labels.
    """
    if groups is None:
        return np.arange(samples) * _PARTS_WITHOUT_GROUPS // max(samples, 1)
    labels = np.asarray(groups)
    if labels.shape != (samples,):
        raise ModelError(f"groups has shape {labels.shape}, expected {(samples,)}")
    return labels


def require_finite(X: Array, names: Sequence[str] | None = None) -> None:
    """Refuse inputs (N, D) that are not finite.

    Raises:
        ModelError: naming the sample and the input, by its number unless it has a name.
    """
    if not np.all(np.isfinite(X)):
        sample, column = np.argwhere(~np.isfinite(X))[0]
        raise ModelError(f"sample {sample}: input {column if names is None else names[column]} is not finite")


class AxisEstimator(ABC):
    """Base of the estimators, on plain arrays: all that does not depend on how they are fitted.

    A subclass takes its parameters as constructor arguments of the same names, and has `fit`.

    Attributes:
        fitted_: the identified axis, a `model_kind.FittedAxis`.
        held_out_: errors on each flight of the model without it; None where no flight was left out.
        n_features_in_: columns of the inputs.
        rejected_: rows that were not finite, and were left out.
    """

    fitted_: Any
    held_out_: list[FlightErrors] | None
    n_features_in_: int
    rejected_: int

    def get_params(self, deep: bool = True) -> dict[str, Any]:  # noqa: ARG002 - scikit-learn's signature
        """Constructor arguments by name."""
        return {name: getattr(self, name) for name in inspect.signature(type(self)).parameters}

    def set_params(self: Self, **params: Any) -> Self:
        """Change constructor arguments by name."""
        known = self.get_params()
        for name, value in params.items():
            if name not in known:
                raise ValueError(f"unknown parameter {name!r}; known: {', '.join(known)}")
            setattr(self, name, value)
        return self

    def __sklearn_tags__(self) -> Any:
        """What scikit-learn wants to know; only scikit-learn asks, so it is imported here."""
        from sklearn.utils import RegressorTags, Tags, TargetTags

        return Tags("regressor", TargetTags(required=True), regressor_tags=RegressorTags())

    @abstractmethod
    def centre_and_spread(self, X: Array) -> tuple[Array, Array]:
        """Centre of the interval and its spread (N,), to which the rule gives the factor.

        Raises:
            ModelError: before `fit`, or naming the sample that is not finite.
        """

    def predict(self, X: Array) -> Array:
        """Predictions (N,): the centre of the interval; raises as :meth:`centre_and_spread` does."""
        return self.centre_and_spread(X)[0]

    def predict_interval(self, X: Array, confidence: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper bounds (N,), between which one new measurement lies with `confidence`.

        Raises:
            ModelError: for a confidence that the interval's rule cannot support.
        """
        centre, spread = self.centre_and_spread(X)
        half = self.fitted_.rule.factor(confidence) * spread
        return centre - half, centre + half

    def score(self, X: Array, y: Array) -> float:
        """Coefficient of determination R² of the predictions."""
        residual = y - self.predict(X)
        return float(1.0 - residual @ residual / np.sum((y - np.mean(y)) ** 2))

    def held_out_coverage(self, confidence: float = 0.95) -> Array | None:
        """Coverage (F,) of each flight by model and intervals of the others; None where none was left out."""
        self.require_fitted()
        rule = self.fitted_.rule
        if not isinstance(rule, HeldOutRule) or self.held_out_ is None:
            return None
        return rule.held_out_coverage(self.held_out_, confidence)

    def require_fitted(self) -> None:
        """Refuse an estimator that was not fitted.

        Raises:
            ModelError: before `fit`.
        """
        if not hasattr(self, "fitted_"):
            raise ModelError("the model is not fitted: call fit first")


def fit_of(estimators: Mapping[str, AxisEstimator]) -> Fit:
    """What fitted estimators give, by axis."""
    held_out = {axis: own.held_out_ for axis, own in estimators.items() if own.held_out_ is not None}
    return Fit({axis: own.fitted_ for axis, own in estimators.items()}, held_out)
