# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Timeline of the alarms that the live nodes published for a replayed flight."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.frames import Array
from quadpi_core.report.figure import Boxes, Figure, Layer, Limit, Line, Panel, Scale
from quadpi_core.report.figure_data import thinned_line
from quadpi_core.report.style import GROUPS, INK, INPUT_LABELS, LEVELS, count, number, percent

_SPEED_BINS = 800
_EVIDENCE_FLOOR = 0.05
_EVIDENCE_TICKS = tuple((float(value), f"{value:g}") for value in (0.1, 1, 10, 100, 1000))
# Half of the height of a bar, where rows are 1 apart.
_HALF_BAR = 0.32


@dataclass(frozen=True)
class LiveReplay:
    """The alarms that the live nodes published while a flight was replayed; one row per message.

    Attributes:
        flight: file stem of the flight.
        statistics: the `live` keys of the demo's summary: samples_in, predictions_out, dropped,
            alarm_fraction, alarm_first_s, warning_first_s (None without one), latency_ms_p50, latency_ms_p99.
        time: (M,) seconds since the first sample of the flight.
        level: (M,) 0 ok, 1 warning, 2 alarm.
        leverage, width: (M, 6) evidence per axis over its alarm threshold.
        inputs_outside: M tuples of the names of the inputs outside the training envelope.
        begins_s: first prediction, from which the time of an evaluated flight counts.
    """

    flight: str
    statistics: dict[str, float | None]
    time: Array
    level: npt.NDArray[np.uint8]
    leverage: Array
    width: Array
    inputs_outside: Sequence[tuple[str, ...]]
    begins_s: float = 0.0

    @property
    def tiles(self) -> dict[str, str]:
        """The statistics as text, by name."""
        found = self.statistics
        formats: dict[str, tuple[str, Callable[[float], str]]] = {
            "first warning": ("warning_first_s", "{:.2f} s".format),
            "first alarm": ("alarm_first_s", "{:.2f} s".format),
            "time in alarm": ("alarm_fraction", percent),
            "samples in": ("samples_in", count),
            "predictions out": ("predictions_out", count),
            "dropped": ("dropped", count),
            "latency, median": ("latency_ms_p50", _milliseconds),
            "latency, 99 %": ("latency_ms_p99", _milliseconds),
        }
        tiles = {}
        for name, (key, text) in formats.items():
            value = found[key]
            undefined = "none" if name.startswith("first") else "–"
            tiles[name] = undefined if value is None else text(value)
        return tiles


def _milliseconds(value: float) -> str:
    return f"{number(value)} ms"


def alarm_figure(live: LiveReplay, result: FlightResult | None) -> Figure:
    """Timeline of a live replay: airspeed, alarm level, evidence, and inputs outside the envelope.

    Args:
        live: with at least one alarm message.
        result: the same flight evaluated offline, for its airspeed; None leaves that row out.
    """
    panels: list[tuple[float, Sequence[Layer], Scale]] = []
    if result is not None:
        speed = thinned_line(
            live.begins_s + result.time, result.speed, _SPEED_BINS, name="airspeed", colour=INK
        )
        panels.append((80.0, [speed], Scale(INPUT_LABELS["speed"], low=0.0)))
    levels = [
        _Bar(name, name, live.level == level, colour) for level, (name, colour) in enumerate(LEVELS.items())
    ]
    panels.append((75.0, *_bars(live.time, levels[::-1])))
    panels.append((120.0, *_evidence(live)))
    if names := _inputs_by_time_outside(live):
        inputs = [
            _Bar(
                name,
                INPUT_LABELS[name].split(" [")[0],
                np.array([name in outside for outside in live.inputs_outside]),
                LEVELS["alarm"],
            )
            for name in names
        ]
        panels.append((22.0 * len(names) + 8.0, *_bars(live.time, inputs)))
    return Figure(
        "Alarm over time",
        [Panel(layers, Scale("time [s]"), y, row=row) for row, (_, layers, y) in enumerate(panels)],
        [height for height, *_ in panels],
        over_time=True,
        flight=live.flight,
        begins_s=live.begins_s,
    )


class _Bar(NamedTuple):
    """One row of bars, which are drawn where `on` (M,), by message, is true."""

    name: str
    label: str
    on: npt.NDArray[np.bool_]
    colour: str


def _inputs_by_time_outside(live: LiveReplay) -> list[str]:
    counts = Counter(name for inputs in live.inputs_outside for name in inputs)
    return [name for name, _ in counts.most_common()]


def _evidence(live: LiveReplay) -> tuple[list[Layer], Scale]:
    layers: list[Layer] = [Limit("", INK, 1.0)]
    for name, evidence, colour, dash in (
        ("leverage", live.leverage, GROUPS[0], ""),
        ("width", live.width, GROUPS[3], "dashed"),
    ):
        # Zero has no place on a logarithmic scale.
        worst = np.maximum(evidence.max(axis=1), _EVIDENCE_FLOOR)
        layers.append(Line(f"{name}, worst axis", colour, live.time, worst, dash=dash, stepped=True))
    return layers, Scale("over threshold", logarithmic=True, ticks=_EVIDENCE_TICKS)


def _bars(time: Array, rows: Sequence[_Bar]) -> tuple[list[Layer], Scale]:
    """Rows of bars, the first on top; each bar ends at the first message without it."""
    layers: list[Layer] = []
    for place, row in enumerate(rows):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], row.on, [False])).astype(np.int8)))
        starts, stops = edges.reshape(-1, 2).T
        level = np.full(len(starts), -float(place))
        spans = time[starts], time[np.minimum(stops, len(time) - 1)]
        layers.append(Boxes(row.name, row.colour, *spans, level - _HALF_BAR, level + _HALF_BAR))
    ticks = [(-float(place), row.label) for place, row in enumerate(rows)]
    return layers, Scale("", 0.4 - len(rows), 0.6, ticks=ticks)
