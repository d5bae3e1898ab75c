# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a vehicle in a model folder, checked when they are read."""

from __future__ import annotations

import numpy as np

from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.physical_regressors import control_signs
from quadpi_core.records import Records


def require_body(vehicle: Records, inertia: Array) -> None:
    """Refuse a PHYSICAL_VEHICLE (1,) or an inertia (3, 3) that no vehicle has.

    Raises:
        ModelError: naming the number.
    """
    for name in ("mass", "reference_thrust", "disc"):
        if not vehicle[name][0] > 0.0:
            raise ModelError(f"vehicle: {name} must be positive, is {vehicle[name][0]:g}")
    control_signs(vehicle)
    if not np.allclose(inertia, inertia.T) or np.any(np.linalg.eigvalsh(inertia) <= 0.0):
        raise ModelError("inertia: not that of a body")
