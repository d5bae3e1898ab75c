# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The tool that renews the table of results/intervals.md."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_has_a_place_for_the_table(tool: ModuleType) -> None:
    assert re.findall(r"^<!-- table: (\S+) -->$", tool.PAGE.read_text(), flags=re.MULTILINE) == ["live"]


def test_interval_of_a_mean_over_flights(tool: ModuleType) -> None:
    # Student's quantile of two degrees of freedom, 4.303, times 0.01 / √3.
    assert tool.cell(np.array([0.94, 0.95, 0.96])) == "95.0 ± 2.5"


def test_coverage_of_either_states(tool: ModuleType) -> None:
    model = AerodynamicModel.load(ROOT / "test" / "golden" / "model")
    bag = bags_directory() / "interpolation.mcap"
    (flight,) = prepare_flights([bag], Vehicle.load("bebop2"), model.cutoff_hz)
    smoothed, live = tool.coverage(model, flight)
    assert not np.array_equal(smoothed, live)
    np.testing.assert_array_equal(tool.coverage(model, replace(flight, live=None)), [smoothed, smoothed])
    nowhere = flight.judged._replace(wrench=flight.judged.wrench + 1e3)
    np.testing.assert_array_equal(
        tool.coverage(model, replace(flight, live=nowhere)), [smoothed, np.zeros(6)]
    )
