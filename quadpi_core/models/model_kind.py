# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The methods that a model can be identified with, and what each has to provide."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models.interval_rules import AnyRule


class Evaluation(NamedTuple):
    """What a model says of N samples; columns Fx … Mz, zero for axes that the model does not hold.

    Attributes:
        predicted, lower, upper: (N, 6) N and Nm, body forward-right-down.
        leverage: (N, 6) h = z (ZᵀZ)⁻¹ zᵀ.
        relative_width: (N, 6) interval width over its root mean square on the training flights.
    """

    predicted: Array
    lower: Array
    upper: Array
    leverage: Array
    relative_width: Array


class FittedAxis(Protocol):
    """One fitted axis: numbers that a compiled kernel can evaluate, and that can be stored.

    Its interval is centre ± rule.factor(confidence) · spread (see `interval_rules`).
    """

    method: ClassVar[str]

    @property
    def rule(self) -> AnyRule:
        """Gives the interval's factor on the spread."""

    @property
    def terms(self) -> list[str]:
        """What the prediction is made of, in words."""

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""


class CompiledAxes(Protocol):
    """The fitted axes of a model packed for compiled evaluation."""

    def evaluate(self, inputs: Array, factors: Array) -> Evaluation:
        """Evaluate input vectors (N, 19) with what :func:`interval_factors` gave."""


def interval_factors(fitted: Mapping[str, FittedAxis], confidence: float) -> Array:
    """Half width (6,) of each axis' interval per unit of spread; 0 for axes not held.

    Raises:
        ModelError: for a confidence that the calibration cannot support.
    """
    factors = np.zeros(len(AXES))
    for axis, own in fitted.items():
        factors[AXES.index(axis)] = own.rule.factor(confidence)
    return factors


@dataclass(frozen=True)
class Method:
    """How a method's axes are read from a stored model, and packed for evaluation.

    Attributes:
        stored: gives a fitted axis from what its `to_json` and `arrays` gave.
        compile: packs the axes of a model, by name.
    """

    stored: Callable[[dict[str, Any], dict[str, Array]], FittedAxis]
    compile: Callable[[Mapping[str, Any]], CompiledAxes]
