# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A model identified on simulated flights, and a strict reader of JSON."""

from __future__ import annotations

import json

import pytest

from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="session")
def model(bags, pool, tmp_path_factory):
    """Folder of a model of the first two flights."""
    folder, vehicle = tmp_path_factory.mktemp("identified") / "model", Vehicle.load("neurobem")
    options = IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ["default"])
    flights = prepare_flights(bags[:2], vehicle, options.cutoff_hz)
    identify(flights, vehicle, load_pools(pool), options).save(folder)
    return folder


@pytest.fixture
def read_json():
    """read_json(path) → its content, which holds no number that JSON does not know."""

    def refuse(constant):
        raise AssertionError(f"{constant} is no JSON")

    return lambda path: json.loads(path.read_text(), parse_constant=refuse)
