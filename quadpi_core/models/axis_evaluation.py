# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a model says of samples."""

from __future__ import annotations

from typing import NamedTuple

from quadpi_core.frames import Array


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
