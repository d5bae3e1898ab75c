# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Parameters and vehicle of the physical model as a model folder keeps them, checked when they are read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.physical_regressors import PhysicalVehicle, control_signs
from quadpi_core.models.physical_terms import TERM_INDEX, TERMS
from quadpi_core.records import ROTORS_MAX, Records, record_dtype


class StoredBody(NamedTuple):
    """What moves a body.

    Attributes:
        values: (P,) parameters in the order of TERMS; zero where the folder has none.
        covariance: (P, P) of them.
        vehicle: PHYSICAL_VEHICLE (1,).
        inertia: (3, 3) kg m².
    """

    values: Array
    covariance: Array
    vehicle: Records
    inertia: Array

    def arrays(self, values: str) -> dict[str, Array]:
        """What a stored model keeps, the parameters by the name of `values`."""
        return {
            values: self.values,
            "covariance": np.ascontiguousarray(self.covariance),
            "vehicle": _stored_vehicle(self.vehicle),
            "inertia": np.ascontiguousarray(self.inertia),
        }

    @classmethod
    def read(cls, names: Sequence[str], arrays: Mapping[str, Array], values: str) -> StoredBody:
        """Read what :meth:`arrays` gave, for parameters of these names.

        Raises:
            ModelError: for parameters that this version does not know, and numbers that no fit gives.
        """
        require_known(names)
        order, count = [TERM_INDEX[name] for name in names], len(names)
        shapes = {values: (count,), "covariance": (count, count), "inertia": (3, 3)}
        require_arrays(arrays, shapes)
        parameters, covariance = np.zeros(len(TERMS)), np.zeros((len(TERMS), len(TERMS)))
        parameters[order], covariance[np.ix_(order, order)] = arrays[values], arrays["covariance"]
        vehicle = _read_vehicle(arrays)
        if np.any(np.diag(covariance) < 0.0):
            raise ModelError("covariance: a negative variance")
        for name in ("mass", "reference_thrust", "disc"):
            if not vehicle[name][0] > 0.0:
                raise ModelError(f"vehicle: {name} must be positive, is {vehicle[name][0]:g}")
        control_signs(vehicle)
        inertia = arrays["inertia"]
        if not np.allclose(inertia, inertia.T) or np.any(np.linalg.eigvalsh(inertia) <= 0.0):
            raise ModelError("inertia: not that of a body")
        return cls(parameters, covariance, vehicle, inertia)


def _stored_vehicle(vehicle: Records) -> Array:
    """Mass, reference thrust, disc, places and spins of a PHYSICAL_VEHICLE (1,): (3 + 4 rotors,)."""
    numbers = [vehicle[name].ravel() for name in ("mass", "reference_thrust", "disc", "positions", "spins")]
    return np.concatenate(numbers)


def _read_vehicle(arrays: Mapping[str, Array]) -> Records:
    """What :func:`_stored_vehicle` gave."""
    count = (np.size(arrays.get("vehicle", ())) - 3) // 4
    if not 1 <= count <= ROTORS_MAX:
        count = 4
    require_arrays(arrays, {"vehicle": (3 + 4 * count,)})
    numbers, vehicle = arrays["vehicle"], np.zeros(1, record_dtype(PhysicalVehicle, count))
    vehicle["mass"], vehicle["reference_thrust"], vehicle["disc"] = numbers[:3]
    vehicle["rotors"], vehicle["spins"] = count, numbers[3 + 3 * count :]
    vehicle["positions"] = numbers[3 : 3 + 3 * count].reshape(count, 3)
    return vehicle


def require_known(names: Sequence[str]) -> None:
    """Refuse names that are not of parameters.

    Raises:
        ModelError: naming the first of them.
    """
    if unknown := [name for name in names if name not in TERM_INDEX]:
        raise ModelError(f"parameter {unknown[0]!r} is not known to this version")


def require_arrays(arrays: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse arrays of other shapes, or that are not finite.

    Raises:
        ModelError: naming the first of them.
    """
    for name, wanted in shapes.items():
        if name not in arrays:
            raise ModelError(f"{name} is missing")
        if arrays[name].shape != wanted or not np.all(np.isfinite(arrays[name])):
            raise ModelError(f"{name} of shape {arrays[name].shape}, expected finite numbers {wanted}")
