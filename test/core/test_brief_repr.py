# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records with long arrays show themselves in one line."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.regressors import load_pools
from quadpi_core.paths import bags_directory
from quadpi_core.records import LONGEST, brief_repr
from quadpi_core.vehicle import Vehicle


@dataclass
class Record:
    __repr__ = brief_repr
    name: str
    values: np.ndarray
    rate_hz: float = 500.0
    parts: tuple = (1, 2)
    rest: None = None


def test_one_line():
    assert (
        repr(Record("a", np.zeros((5, 3))))
        == "Record(name='a', values=array(5, 3), rate_hz=500.0, parts=<tuple of 2>, rest=None)"
    )
    assert len(repr(Record("a" * 1000, np.zeros(3)))) < LONGEST


@pytest.fixture(scope="module")
def vehicle():
    return Vehicle.load("bebop2")


def test_public_records(vehicle, physical_folder):
    bag = bags_directory() / "interpolation.mcap"
    recording = read_recording(bag, vehicle)
    (flight,) = prepare_flights(bag, vehicle)
    model = AerodynamicModel.load(physical_folder)
    said = model.evaluate(flight)
    for record in (
        vehicle,
        recording,
        recording.imu,
        flight,
        flight.live,
        said,
        load_pools("quadrotor")["Fx"],
    ):
        text = repr(record)
        assert text.startswith(f"{type(record).__name__}(")
        assert len(text) <= LONGEST, text
        assert "\n" not in text
    assert repr(model) == (
        "<AerodynamicModel flown: physical of bebop2, Fx Fy Fz Mx My Mz, 4 flights, confidence 0.95>"
    )
    assert len(repr(replace(model, name="a" * 500, vehicle="b" * 500))) <= LONGEST
