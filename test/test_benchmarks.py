# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Benchmarks of the simulation run; what they give on this machine is not judged here."""

from __future__ import annotations

import importlib.metadata
from io import StringIO

import pytest
from rich.console import Console

from benchmarks import (
    Result,
    UnavailableError,
    simulate_bags,
    simulation_realtime,
    simulation_vs_rotorpy,
    soak,
)
from benchmarks.__main__ import as_page, summary
from quadpi_core.simulation.flying import SimulatedVehicle


def test_figures_are_shown_beside_their_goals_on_terminal_and_page() -> None:
    results = [
        Result("slow_us", 12.345, "µs", "a quiet [machine]", goal=10.0, at_most=True),
        Result("fast", 3.0, "times", "the other", goal=2.0),
        Result("plain", 1.0, "files", "nothing"),
    ]
    console = Console(width=80, file=StringIO())
    console.print(summary(results, {"absent": "skipped: no rotorpy"}))
    shown = console.file.getvalue()
    assert [line.split() for line in shown.splitlines()[3:6]] == [
        ["slow_us", "12.3", "µs", "at", "most", "10", "no"],
        ["fast", "3", "times", "at", "least", "2", "yes"],
        ["plain", "1", "files"],
    ]
    assert "slow_us: a quiet [machine]" in shown
    page = as_page(results, {"absent": "skipped: no rotorpy"})
    assert "Not reached: slow_us." in page
    assert "| `slow_us` | 12.3 µs | at most 10 | **no** |\n| `fast` | 3 times | at least 2 | yes |" in page
    assert "- `absent`: skipped: no rotorpy" in page


def test_flight_against_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulation_realtime, "REPETITIONS", 1)
    (result,) = simulation_realtime.run()
    assert result.name in simulation_realtime.NAMES
    assert result.value > 1.0
    assert result.goal == 200.0


def test_flights_against_bags(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulate_bags, "SCENARIOS", ("dash",))
    monkeypatch.setattr(simulate_bags, "REPEATS", 1)
    (result,) = simulate_bags.run()
    assert result.name in simulate_bags.NAMES
    assert 0.0 < result.value < simulate_bags.FLOWN_S
    assert "1 flights of 40 s" in result.baseline


def test_circle_is_flown() -> None:
    plan = simulation_vs_rotorpy.circle_plan()
    simulation_vs_rotorpy.circle(plan, SimulatedVehicle.load(plan.vehicle))


def test_without_rotorpy_its_benchmark_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(name: str) -> str:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "version", absent)
    with pytest.raises(UnavailableError, match="rotorpy"):
        simulation_vs_rotorpy.run()


def test_soak_counts_what_is_missing_between_and_at_the_end() -> None:
    begun_ns, sample_ns = 1_700_000_000_000_000_000, 2_000_000
    heard = soak.Heard(begun_ns)
    for sample in (500, 501, 503, 504):
        heard.take(b"\0" * 4 + soak.STAMP.pack(*divmod(begun_ns + sample * sample_ns, 1_000_000_000)))
    assert heard.lost(begun_ns + 504 * sample_ns) == 1
    assert heard.lost(begun_ns + 510 * sample_ns) == 7
    assert heard.flown_s == pytest.approx(4 * 0.002)
