# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Timeline of the alarms that the live nodes published for a replayed flight."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.frames import Array
from quadpi_core.report.figure import Boxes, Figure, Layer, Limit, Line, Panel, Scale
from quadpi_core.report.style import GROUPS, INK, INPUT_LABELS, LEVELS, count, number, percent

_EVIDENCE_FLOOR = 0.05
_EVIDENCE_SCALE = Scale(
    "over threshold",
    logarithmic=True,
    ticks=[(value, f"{value:g}") for value in (0.1, 1.0, 10.0, 100.0, 1000.0)],
)
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
    time, panels = Scale("time [s]"), []
    if result is not None:
        speed = Line("airspeed", INK, live.begins_s + result.time, result.speed)
        panels.append(Panel([speed], time, Scale(INPUT_LABELS["speed"], low=0.0), 80.0))
    levels = [(name, name, live.level == k, colour) for k, (name, colour) in enumerate(LEVELS.items())]
    panels.append(Panel(*_bars(live.time, levels[::-1]), 75.0))
    panels.append(Panel(_evidence(live), time, _EVIDENCE_SCALE, 120.0))
    outside = Counter(name for inputs in live.inputs_outside for name in inputs)
    if outside:
        inputs = [
            (
                name,
                INPUT_LABELS[name].split(" [")[0],
                np.array([name in own for own in live.inputs_outside]),
                LEVELS["alarm"],
            )
            for name, _ in outside.most_common()
        ]
        panels.append(Panel(*_bars(live.time, inputs), 22.0 * len(inputs) + 8.0))
    return Figure("Alarm over time", panels, over_time=True, flight=live.flight, begins_s=live.begins_s)


def _evidence(live: LiveReplay) -> list[Layer]:
    layers: list[Layer] = [Limit("", INK, 1.0)]
    for name, evidence, colour, dash in (
        ("leverage", live.leverage, GROUPS[0], ""),
        ("width", live.width, GROUPS[3], "dashed"),
    ):
        # Zero has no place on a logarithmic scale.
        worst = np.maximum(evidence.max(axis=1), _EVIDENCE_FLOOR)
        layers.append(Line(f"{name}, worst axis", colour, live.time, worst, dash=dash, stepped=True))
    return layers


def _bars(
    time: Array, rows: Sequence[tuple[str, str, npt.NDArray[np.bool_], str]]
) -> tuple[list[Layer], Scale, Scale]:
    """Layers and axes of rows of bars, the first on top; each bar ends at the first message without it.

    Args:
        time: (M,) of the messages.
        rows: name, label, whether it holds by message (M,), and colour.
    """
    layers: list[Layer] = []
    for place, (name, _, on, colour) in enumerate(rows):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(np.int8)))
        starts, stops = edges.reshape(-1, 2).T
        level = np.full(len(starts), -float(place))
        spans = time[starts], time[np.minimum(stops, len(time) - 1)]
        layers.append(Boxes(name, colour, *spans, level - _HALF_BAR, level + _HALF_BAR))
    ticks = [(-float(place), label) for place, (_, label, *_) in enumerate(rows)]
    return layers, Scale("time [s]"), Scale("", 0.4 - len(rows), 0.6, ticks=ticks)
