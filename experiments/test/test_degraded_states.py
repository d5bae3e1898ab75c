# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Slow states of real flights, and windy flights of another simulator: drag, thrust, inertia as published."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.identification.prepared_flights import prepare_recording
from quadpi_core.logs import read_recording
from quadpi_core.vehicle import Vehicle

DATA = Path(os.environ.get("QUADPI_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.mark.slow
def test_gps_gives_the_drag_of_motion_capture():
    import degraded_states as program

    path = DATA / "neurobem"
    if not path.is_dir():
        pytest.skip("no real flights: QUADPI_DATA")
    vehicle = Vehicle.load("neurobem")
    recordings = [read_recording(one, vehicle) for one in sorted(path.iterdir())[:2]]
    truth = [prepare_recording(one, vehicle, program.CUTOFF) for one in recordings]
    rng = np.random.default_rng(11)
    slow = [
        prepare_recording(program.degraded(one, own.flight, rng, 5.0), vehicle, program.CUTOFF)
        for one, own in zip(recordings, truth, strict=True)
    ]
    assert program.drag(slow, recordings) == pytest.approx(program.drag(truth, recordings), rel=0.05)


@pytest.mark.slow
def test_intervals_by_gps_and_commands_hold_the_truth(tmp_path):
    for needed in ("rotorpy", "torch", "roma"):
        pytest.importorskip(needed)
    import gps_flights as program

    told = [
        program.judged(one, program.vehicle_file()) for one in program.stored(range(500, 504), 60, tmp_path)
    ]
    known = [(true, one) for flight in told for true, one in flight if one.low is not None]
    assert len(known) == 20
    assert sum(one.low <= true <= one.high for true, one in known) >= 17
