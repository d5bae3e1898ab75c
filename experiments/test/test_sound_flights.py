# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from page_tables import ROOT
from sound_flights import SIMULATED, Judged, judged

from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle


def test_alarms_of_flights_add_up() -> None:
    row = Judged.total([Judged(1, 0.5, 1, 0, 2, 1), Judged(19, 9.5, 0, 1, 0, 1)]).row(SIMULATED, "all")
    assert row == [
        *(SIMULATED, "all", "20", "10.00", "1 (0.13 to 25 %)", "1", "2", "0.3 (0.062 to 0.88)", "2"),
    ]


def test_a_flight_outside_the_envelope_raises_an_alarm() -> None:
    model, vehicle = AerodynamicModel.load(ROOT / "test" / "golden" / "model"), Vehicle.load("bebop2")
    found = judged(model, vehicle, [read_recording(bags_directory() / "extrapolation.mcap", vehicle)])
    assert (found.flights, found.with_any) == (1, 1)
    assert found.extrapolation > 0
