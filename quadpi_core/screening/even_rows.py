# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bounded number of rows, evenly spread over all that came: for the quantiles of a long flight."""

from __future__ import annotations

import numpy as np

from quadpi_core.frames import Array

# Samples up to which a flight is judged by all of them: nearly 9 minutes at 500 Hz.
FEW_SAMPLES = 1 << 18


class EvenRows:
    """Keeps all rows up to FEW_SAMPLES of them, then every second, every fourth and so on.

    Which are kept does not depend on the parts that they come in.
    """

    def __init__(self) -> None:
        self._parts: list[Array] = []
        self._stride = 1
        self._count = 0

    def add(self, rows: Array) -> None:
        """Take the rows (N, C), or numbers (N,), that come next."""
        self._parts.append(rows[-self._count % self._stride :: self._stride].copy())
        self._count += len(rows)
        while self._count > FEW_SAMPLES * self._stride:
            self._parts = [self.rows()[::2].copy()]
            self._stride *= 2

    def rows(self) -> Array:
        """Those that were kept.

        Raises:
            ValueError: if nothing was added.
        """
        if len(self._parts) != 1:
            self._parts = [np.concatenate(self._parts)]
        return self._parts[0]
