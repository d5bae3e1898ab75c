# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights with a drag and thrust that are known, as files, prepared, and a model identified on three."""

from __future__ import annotations

import pytest

from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs.bags import write_bag
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import CandidatePool
from quadpi_core.vehicle import Vehicle

CUTOFF_HZ = 20.0
DRAG_KG_S, THRUST_N_S2 = 0.5, 2.0e-6
POOLS = {
    "Fz": CandidatePool.parse(["w"], ["P^2(omega_avg)", "P^2(|u|, |v|)"]),
    "Fx": CandidatePool.parse(["u"], ["P^2(u, |v|, w)", "P^1(q)·{1, omega_avg}"]),
}


@pytest.fixture(scope="session")
def dragged_paths(fly, tmp_path_factory):
    """Bags of five flights of the vehicle neurobem."""
    folder = tmp_path_factory.mktemp("dragged")
    paths = [folder / f"flight{seed}.mcap" for seed in range(5)]
    for seed, path in enumerate(paths):
        write_bag(path, fly(seed, drag_kg_s=DRAG_KG_S, thrust_n_s2=THRUST_N_S2))
    return paths


@pytest.fixture(scope="session")
def dragged_flights(dragged_paths):
    """The flights, prepared for identification."""
    return prepare_flights(dragged_paths, Vehicle.load("neurobem"), CUTOFF_HZ)


@pytest.fixture(scope="session")
def dragged_model(dragged_flights):
    """A model of Fx and Fz identified on the first three."""
    options = IdentifyOptions(method="polynomial", cutoff_hz=CUTOFF_HZ)
    return identify(dragged_flights[:3], Vehicle.load("neurobem"), POOLS, options)
