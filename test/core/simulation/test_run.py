# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import subprocess
import sys

import pytest

from quadpi_core.errors import OutputError
from quadpi_core.parallel import Progress, Workers
from quadpi_core.simulation.run import simulate
from quadpi_core.simulation.scenario import FlightPlan

HOVER = FlightPlan(name="hover", scenario="test", vehicle="bebop2", seed=1, duration_s=0.5)

# In a process of its own, for the effects to be compiled, or loaded from the cache, by `simulate`.
SEVERAL_WITH_EFFECTS = """
import sys
from pathlib import Path
from quadpi_core.parallel import Workers
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.run import simulate

hover = FlightPlan(name="one", scenario="test", vehicle="bebop2", seed=1, duration_s=0.5)
plans = [hover.overridden(name=f"hover_{k}", effects={"gyroscopic": None}) for k in range(4)]
print(len(simulate(plans, Path(sys.argv[1]), workers=Workers(4))))
"""


def test_several_flights_with_effects_at_a_time_from_a_cold_start(tmp_path):
    command = [sys.executable, "-c", SEVERAL_WITH_EFFECTS, tmp_path / "bags"]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout) == (0, "4\n"), ran.stderr
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
