# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import OutputError
from quadpi_core.parallel import Progress, Workers
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.simulated_bags import simulate

HOVER = FlightPlan(name="hover", scenario="test", vehicle="bebop2", seed=1, duration_s=0.5)


def test_several_flights_at_a_time_with_effects_of_the_core_and_of_python(tmp_path, monkeypatch):
    monkeypatch.setitem(EFFECTS, "own", replace(EFFECTS["gyroscopic"], name="own"))
    hover = FlightPlan(name="one", scenario="test", vehicle="bebop2", seed=1, duration_s=0.5)
    effects = ({"gyroscopic": None}, {"own": None}) * 2
    plans = [hover.overridden(name=f"hover_{k}", effects=own) for k, own in enumerate(effects)]
    flights = simulate(plans, tmp_path / "bags", workers=Workers(4))
    for flight in flights:
        np.testing.assert_allclose(flight.truth.wrench, flights[0].truth.wrench, rtol=1e-12, atol=1e-15)
    assert len(list((tmp_path / "bags").iterdir())) == 4


def test_progress_is_reported_until_the_end(tmp_path):
    seen = []
    simulate([HOVER], tmp_path, workers=Workers(progress=seen.append))
    assert seen[-1] == Progress("Flying", 0.5, 0.5, "s", "1 of 1 flights")
    assert [progress.done for progress in seen] == sorted(progress.done for progress in seen)


def test_a_file_in_the_place_of_the_folder(tmp_path):
    (tmp_path / "bags").write_text("mine")
    with pytest.raises(OutputError, match=r"bags.* cannot be written: Not a directory"):
        simulate([HOVER], tmp_path / "bags")
    assert [path.name for path in tmp_path.iterdir()] == ["bags"]
    assert (tmp_path / "bags").read_text() == "mine"
