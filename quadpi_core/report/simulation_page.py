# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The flights of a simulation as one self-contained page."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from quadpi_core.report.decimation import bins_within
from quadpi_core.report.flight_summary import FlightSummary, effects_text, faults_text, summarise
from quadpi_core.report.flown_figures import LINES, effort_figure, tracking_figure
from quadpi_core.report.page import (
    cells,
    figure_of_flight,
    flight_menu,
    footer,
    heading,
    section,
    table,
    write_page,
)
from quadpi_core.report.style import number, percent
from quadpi_core.report.trajectory_figures import trajectory_figure
from quadpi_core.simulation.truth import Truth

if TYPE_CHECKING:
    from quadpi_core.simulation.flight_plan import FlightPlan

# All time histories together draw so many samples, at about 11 bytes each in the page.
_DRAWN_SAMPLES = 370_000


def write_simulation_page(path: Path, flights: Sequence[tuple[FlightPlan, Truth]]) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        flights: what was planned and what was flown; at least one, of different names.

    Raises:
        OutputError: if `path` cannot be written.
    """
    summaries = [summarise(plan, truth) for plan, truth in flights]
    bins = bins_within(_DRAWN_SAMPLES, LINES * len(flights))
    figures = {}
    for plan, truth in flights:
        figures[f"trajectory {plan.name}"] = trajectory_figure(truth)
        figures[f"tracking {plan.name}"] = tracking_figure(truth, bins)
        figures[f"effort {plan.name}"] = effort_figure(truth, bins)
    scenarios = ", ".join(dict.fromkeys(plan.scenario for plan, _ in flights))
    parts = [
        _header(scenarios, summaries),
        _flights(summaries),
        f"<nav>{flight_menu({'': [summary.name for summary in summaries]})}</nav>",
        _trajectory(),
        _effort(bins),
        _definitions(),
    ]
    write_page(path, f"quadpi: simulation of {scenarios}", parts, figures)


def _header(scenarios: str, summaries: Sequence[FlightSummary]) -> str:
    total = sum(summary.duration_s for summary in summaries)
    fastest = max(summaries, key=lambda summary: summary.airspeed_max_m_s)
    worst = max(summaries, key=lambda summary: summary.tracking_rms_m)
    flights = "One simulated flight" if len(summaries) == 1 else f"{len(summaries)} simulated flights"
    verdict = (
        f"{flights}, {number(total)}\u00a0s, at up to {number(fastest.airspeed_max_m_s)}\u00a0m/s "
        f"({fastest.name}); worst tracking error {number(worst.tracking_rms_m)}\u00a0m rms ({worst.name})."
    )
    facts = {
        "scenario": scenarios,
        "vehicle": _distinct(summary.vehicle for summary in summaries),
        "noise": _distinct(summary.noise for summary in summaries),
    }
    common = {name: column[0] for name, column in _alterations(summaries).items() if _is_common(column)}
    return heading("simulated flights", verdict, facts | common)


def _alterations(summaries: Sequence[FlightSummary]) -> dict[str, list[str]]:
    """What alters flights, a text for each; without what alters none."""
    texts = {
        "effects": [effects_text(summary.effects) for summary in summaries],
        "faults": [faults_text(summary.faults) for summary in summaries],
    }
    return {name: column for name, column in texts.items() if any(column)}


def _is_common(column: Sequence[str]) -> bool:
    return len(set(column)) == 1


def _distinct(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(names))


def _flights(summaries: Sequence[FlightSummary]) -> str:
    """A row per flight; what alters none or all of them alike is left out."""
    columns = {
        "flight": [_chooser(s.name) for s in summaries],
        "time [s]": [number(s.duration_s) for s in summaries],
        "airspeed [m/s]": [number(s.airspeed_max_m_s) for s in summaries],
        "error rms [m]": [number(s.tracking_rms_m) for s in summaries],
        "max [m]": [number(s.tracking_max_m) for s in summaries],
        "tilt [deg]": [f"{s.tilt_max_deg:.0f}" for s in summaries],
        "rotors [rad/s]": [
            "–".join(f"{speed:.0f}" for speed in s.rotor_speed_range_rad_s) for s in summaries
        ],
        "at limit": [percent(s.saturated_fraction) for s in summaries],
        "seed": [str(s.seed) for s in summaries],
    }
    if any(s.head_wind_m_s for s in summaries):
        columns["wind [m/s]"] = [number(s.head_wind_m_s) for s in summaries]
    texts = {name: column for name, column in _alterations(summaries).items() if not _is_common(column)}
    head = cells("th", columns) + "".join(f'<th class="text">{name}</th>' for name in texts)
    rows = [
        cells("td", (column[i] for column in columns.values()))
        + "".join(f'<td class="text">{escape(column[i]) or "–"}</td>' for column in texts.values())
        for i in range(len(summaries))
    ]
    return section(
        "Flights",
        "Greatest airspeed and tilt of the thrust axis from the vertical; distance from the reference "
        "position; range of the rotor speeds, and the share of time in which a rotor turns as fast as it can "
        "or stands still. Choose a flight to see it below.",
        f'<div class="dense">{table(f"<tr>{head}</tr>", rows)}</div>',
    )


def _chooser(flight: str) -> str:
    return f'<button data-flight="{escape(flight)}">{escape(flight)}</button>'


def _trajectory() -> str:
    return section(
        "Path and reference",
        "The path in space, coloured by airspeed, over its shadow; the vehicle is drawn at equal distances "
        "along it, larger than life. Drag to turn, scroll to zoom. Beside it the same flight over time.",
        f'<div class="pair">{figure_of_flight("trajectory")}{figure_of_flight("tracking")}</div>',
    )


def _effort(bins: int) -> str:
    return section(
        "Rotors and wrench",
        "The truth, before any sensor: body axes forward-right-down, aerodynamics and effects, gravity not "
        f"included. Of each of {bins} equal parts of a flight the lowest and highest samples are drawn, so "
        "peaks are kept. Drag to zoom all rows together, double-click to reset.",
        figure_of_flight("effort"),
    )


def _definitions() -> str:
    return footer(
        {
            "Tracking error": "Distance from the reference position at that instant; what wind, effects and "
            "demands put on top of the controller do to it is part of it.",
            "Airspeed": "Of the vehicle relative to the air, gusts included.",
            "Seed": "With the scenario and the version of quadpi it makes the same bag again, byte for byte.",
        }
    )
