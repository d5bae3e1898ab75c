# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fitted models that the compiled core evaluates, alone or as a stage of the monitor."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from quadpi_core.core import compiled
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.inputs import DERIVATIVES
from quadpi_core.models.model_kind import Evaluation, Fitted
from quadpi_core.models.regressors import check_inputs
from quadpi_core.records import Records

_NO_DERIVATIVES = np.empty(0, DERIVATIVES)


class CompiledFitted(Fitted):
    """Base of fitted models whose arrays the core takes once.

    Attributes:
        needs_derivatives: whether its predictions need them.
    """

    needs_derivatives: ClassVar[bool] = False

    @property
    @abstractmethod
    def compiled(self) -> compiled.Model:
        """The model as the core has it; always the same."""

    def evaluate(self, inputs: Array, factors: Array, derivatives: Records | None = None) -> Evaluation:
        """See the base class.

        Raises:
            ModelError: for inputs of another shape, and without derivatives where they are needed.
        """
        check_inputs(inputs)
        if derivatives is None:
            if self.needs_derivatives:
                raise ModelError(f"the {self.method} model needs the derivatives of the motion")
            derivatives = _NO_DERIVATIVES
        out = np.zeros((5, len(inputs), len(AXES)))
        inputs, derivatives = np.ascontiguousarray(inputs), np.ascontiguousarray(derivatives)
        compiled.evaluate(self.compiled, inputs, derivatives, np.ascontiguousarray(factors), out)
        # Faster one by one than by *out.
        return Evaluation(out[0], out[1], out[2], out[3], out[4])


def compiled_model(fitted: Fitted) -> compiled.Model | None:
    """The model as the core evaluates it; None for another kind, or another `evaluate`: Python does that."""
    if isinstance(fitted, CompiledFitted) and type(fitted).evaluate is CompiledFitted.evaluate:
        return fitted.compiled
    return None
