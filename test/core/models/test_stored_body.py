# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.models.physical_regressors import physical_vehicle
from quadpi_core.models.stored_body import require_body
from test.core.models.physical_flights import REFERENCE, VEHICLE


def test_a_vehicle_passes() -> None:
    require_body(physical_vehicle(VEHICLE, REFERENCE), VEHICLE.inertia)


@pytest.mark.parametrize("name", ["mass", "reference_thrust", "disc"])
def test_a_number_that_is_not_positive_is_refused(name: str) -> None:
    vehicle = physical_vehicle(VEHICLE, REFERENCE)
    vehicle[name] = 0.0
    with pytest.raises(ModelError, match=f"{name} must be positive, is 0"):
        require_body(vehicle, VEHICLE.inertia)


def test_an_inertia_of_no_body_is_refused() -> None:
    vehicle = physical_vehicle(VEHICLE, REFERENCE)
    for inertia in (-VEHICLE.inertia, VEHICLE.inertia + np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]])):
        with pytest.raises(ModelError, match="inertia"):
            require_body(vehicle, inertia)
