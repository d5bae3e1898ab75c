# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Residuals of sound flights of a vehicle, each under a model identified without it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array

# Smallest eigenvalue of a stored covariance beside its largest: what rounding leaves.
_ROUNDING = 1e-9


@dataclass(frozen=True, eq=False)
class SoundFlights:
    """The errors of a model on flights that it was identified without: noise, and errors that are known.

    A known error is a parameter of an effect that these flights show, such as the inertia of rotors.

    Attributes:
        flights: number of them.
        edges_hz: edges of C bands of frequency.
        noise: (6, C) variance of the noise in these bands, N² and (Nm)², beside the known errors.
        left: (6, C) the same with the known errors in it.
        differ: (6,) standard deviation between flights of their squares over those of `left`.
        names: of E known errors: the candidate of a search, and its parameter.
        mean: (E,) of what all flights share, in the unit of the parameter.
        covariance: (E, E) of that mean.
        of_flight: (E,) standard deviation of what each flight has of its own.
    """

    flights: int
    edges_hz: tuple[float, ...]
    noise: Array
    left: Array
    differ: Array
    names: tuple[tuple[str, str], ...]
    mean: Array
    covariance: Array
    of_flight: Array

    def __post_init__(self) -> None:
        """Refuse arrays that do not belong together, or that no flights leave."""
        bands, errors = len(self.edges_hz) - 1, len(self.names)
        shapes = {
            "noise": (len(AXES), bands),
            "left": (len(AXES), bands),
            "differ": (len(AXES),),
            "mean": (errors,),
            "covariance": (errors, errors),
            "of_flight": (errors,),
        }
        for name, shape in shapes.items():
            if np.shape(getattr(self, name)) != shape:
                raise ModelError(f"sound flights: {name}: expected shape {shape}")
        if self.flights < 1:
            raise ModelError("sound flights: none")
        if np.any(self.noise <= 0.0) or np.any(self.left <= 0.0):
            raise ModelError("sound flights: noise without a variance")
        if np.any(self.differ < 0.0) or np.any(self.of_flight < 0.0):
            raise ModelError("sound flights: a negative standard deviation")
        scaled, _ = self._scaled()
        values = np.linalg.eigvalsh(scaled)
        if not np.array_equal(self.covariance, self.covariance.T) or np.any(values < -_ROUNDING * errors):
            raise ModelError("sound flights: covariance: not one of any numbers")

    def deviations(self, flights: int) -> Array:
        """Columns (E, ·) of independent deviations of the known errors of a flight, one of several.

        Their covariance is that of the mean and what is of each flight. What flights share varies as much in
        their mean, if each deviates for itself by the square root of their number times it.
        """
        scaled, unit = self._scaled()
        values, vectors = np.linalg.eigh(scaled)
        root = unit[:, np.newaxis] * vectors * np.sqrt(np.maximum(flights * values, 0.0))
        return np.column_stack((root, np.diag(self.of_flight)))

    def _scaled(self) -> tuple[Array, Array]:
        """Correlation matrix and standard deviations of the mean: units differ by orders of magnitude."""
        unit = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        unit = np.where(unit > 0.0, unit, 1.0)
        return self.covariance / np.outer(unit, unit), unit

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        return {
            "flights": self.flights,
            "edges_hz": list(self.edges_hz),
            "known_errors": [list(name) for name in self.names],
        }

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        named = ("noise", "left", "differ", "mean", "covariance", "of_flight")
        return {name: np.ascontiguousarray(getattr(self, name)) for name in named}

    @classmethod
    def stored(cls, data: Mapping[str, Any], arrays: Mapping[str, Array]) -> SoundFlights:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for arrays that are missing, do not belong together, or that no flights leave.
        """
        return cls(
            flights=int(data["flights"]),
            edges_hz=tuple(float(edge) for edge in data["edges_hz"]),
            names=tuple((str(candidate), str(parameter)) for candidate, parameter in data["known_errors"]),
            **arrays,
        )
