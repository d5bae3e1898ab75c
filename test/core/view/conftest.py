# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A model with a bundled flight that leaves its envelope, judged once for all tests of the page."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.rerun_recording import BagSource, open_bag
from quadpi_core.view.vehicle_view import VehicleView

MODEL_FOLDER = Path(__file__).resolve().parents[2] / "golden" / "model"
BAG = bags_directory() / "extrapolation.mcap"


@pytest.fixture(scope="session")
def model() -> AerodynamicModel:
    return AerodynamicModel.load(MODEL_FOLDER)


@pytest.fixture(scope="session")
def vehicle(model) -> Vehicle:
    return model.load_vehicle()


def read_whole(source: BagSource) -> VehicleView:
    """The view of a bag, once it is read to its end."""
    while not source.finished:
        source.poll()
        time.sleep(0.001)
    source.close()
    if source.error is not None:
        raise source.error
    (view,) = source.vehicles.values()
    return view


@pytest.fixture(scope="session")
def judged_view(model, vehicle) -> VehicleView:
    return read_whole(open_bag(BAG, [model], vehicle))


@pytest.fixture(scope="session")
def results_bag(model, vehicle, tmp_path_factory) -> Path:
    """What `quadpi replay` writes for the flight."""
    output = tmp_path_factory.mktemp("results") / "replayed.mcap"
    replay(model, vehicle, BAG, output)
    return output
