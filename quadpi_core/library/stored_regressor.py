# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Regressors as arrays, so that a model folder holds data and never code: affine maps, and sums of trees."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES

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
        """Refused: only the result of a fit is stored.

        Raises:
            ModelError: always.
        """
        raise ModelError("a regressor read from a folder cannot be fitted again: make the model anew")

    def arrays(self) -> dict[str, Array]:
        """What a folder keeps, by name."""
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
        values: Array = X @ self.coefficients[:-1] + self.coefficients[-1]
        return values


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
            and all(_is_whole(places) for places in (self.feature, self.left, self.right, self.roots))
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


def _is_whole(places: Array) -> bool:
    return bool(np.all(np.isfinite(places) & (places == np.rint(places))))


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
    spread = float(np.square(total - total.mean()).sum())
    scale = float((total - total.mean()) @ (expected - expected.mean())) / spread if spread else 1.0
    for share in (1.0 / len(trees), scale):
        values = {**vars(summed), "value": share * summed.value}
        constant = np.mean(expected - share * total)
        yield Trees(**values | {"constant": np.zeros(1)})
        yield Trees(**values | {"constant": np.array([constant])})
