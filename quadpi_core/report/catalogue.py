# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What there is to simulate: scenarios, and effects that can be switched on."""

from __future__ import annotations

from rich import box
from rich.table import Table
from rich.text import Text

from quadpi_core.paths import config_directory
from quadpi_core.report.style import number
from quadpi_core.simulation.effect_registry import EFFECTS
from quadpi_core.simulation.scenario import load_scenario


def catalogue() -> list[Table]:
    """Tables of the scenarios in config/scenarios, and of the effects with their parameters' defaults."""
    scenarios = Table(title="scenarios", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    scenarios.add_column("name", no_wrap=True)
    scenarios.add_column("flights", justify="right")
    scenarios.add_column("s", justify="right")
    scenarios.add_column("")
    for path in sorted((config_directory() / "scenarios").glob("*.yaml")):
        scenario = load_scenario(path.stem)
        total = sum(plan.duration_s for plan in scenario.flights)
        scenarios.add_row(
            scenario.name, str(len(scenario.flights)), number(total), Text(scenario.description)
        )
    effects = Table(title="effects", title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    effects.add_column("name", no_wrap=True)
    effects.add_column("where it shows, what it does, and its parameters as they are unless given")
    for name, effect in EFFECTS.items():
        parameters = ", ".join(f"{parameter.name}={parameter.default:g}" for parameter in effect.parameters)
        axes = f"{' '.join(effect.axes)}: " if effect.axes else ""
        text = Text(f"{axes}{effect.summary}").append(f"\n{parameters}" if parameters else "", style="dim")
        effects.add_row(name, text)
    return [scenarios, effects]
