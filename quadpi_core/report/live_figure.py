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
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from quadpi_core.evaluation.flight_results import FlightResult
from quadpi_core.frames import Array
from quadpi_core.report.plots import extreme_samples, series, styled
from quadpi_core.report.style import GROUPS, INK, INPUT_LABELS, LEVELS, count, number, percent

_SPEED_BINS = 800
_EVIDENCE_FLOOR = 0.05
_EVIDENCE_TICKS = [0.1, 1, 10, 100, 1000]
_BAR_WIDTH = 12


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
    """

    flight: str
    statistics: dict[str, float | None]
    time: Array
    level: npt.NDArray[np.uint8]
    leverage: Array
    width: Array
    inputs_outside: Sequence[tuple[str, ...]]

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


def alarm_figure(live: LiveReplay, result: FlightResult | None) -> go.Figure:
    """Timeline of a live replay: airspeed, alarm level, evidence, and inputs outside the envelope.

    Args:
        live: with at least one alarm message.
        result: the same flight evaluated offline, for its airspeed; None leaves that row out.
    """
    names = _inputs_by_time_outside(live)
    rows = ["speed"] * (result is not None) + ["level", "evidence"] + ["inputs"] * bool(names)
    heights = {"speed": 90.0, "level": 80.0, "evidence": 130.0, "inputs": 26.0 * len(names) + 20.0}
    figure = make_subplots(
        rows=len(rows),
        cols=1,
        shared_xaxes=True,
        vertical_spacing=0.05,
        row_heights=[heights[row] for row in rows],
    )
    cells = {row: {"row": i + 1, "col": 1} for i, row in enumerate(rows)}
    if result is not None:
        shown = extreme_samples(result.speed, result.speed, _SPEED_BINS)
        line = series(result.time[shown], result.speed[shown]) | {"line": {"color": INK, "width": 1.2}}
        figure.add_scatter(**line, name="airspeed", showlegend=False, **cells["speed"])
        figure.update_yaxes(title_text=INPUT_LABELS["speed"], rangemode="tozero", **cells["speed"])
    levels = [
        _Bar(name, name, live.level == level, colour) for level, (name, colour) in enumerate(LEVELS.items())
    ]
    _add_bars(figure, live.time, levels[::-1], cells["level"])
    _add_evidence(figure, live, cells["evidence"])
    if names:
        inputs = [
            _Bar(
                name,
                INPUT_LABELS[name].split(" [")[0],
                np.array([name in outside for outside in live.inputs_outside]),
                LEVELS["alarm"],
            )
            for name in names
        ]
        _add_bars(figure, live.time, inputs, cells["inputs"])
    figure.update_xaxes(title_text="time [s]", row=len(rows), col=1)
    return styled(figure, height=int(120 + 1.15 * sum(heights[row] for row in rows)))


class _Bar(NamedTuple):
    """One row of bars, which are drawn where `on` (M,), by message, is true."""

    name: str
    label: str
    on: npt.NDArray[np.bool_]
    colour: str


def _inputs_by_time_outside(live: LiveReplay) -> list[str]:
    counts = Counter(name for inputs in live.inputs_outside for name in inputs)
    return [name for name, _ in counts.most_common()]


def _add_evidence(figure: go.Figure, live: LiveReplay, cell: dict[str, int]) -> None:
    for name, evidence, colour in (("leverage", live.leverage, GROUPS[0]), ("width", live.width, GROUPS[3])):
        # Zero has no place on a logarithmic scale.
        worst = np.maximum(evidence.max(axis=1), _EVIDENCE_FLOOR)
        line = series(live.time, worst) | {"line": {"color": colour, "width": 1.5, "shape": "hv"}}
        figure.add_scatter(**line, name=f"{name}, worst axis", hovertemplate="%{y:.2f}", **cell)
    figure.add_hline(y=1.0, line={"color": INK, "width": 1, "dash": "dash"}, **cell)
    # As text: plotly writes powers of ten in another size.
    ticks = {"tickvals": _EVIDENCE_TICKS, "ticktext": [f"{value:g}" for value in _EVIDENCE_TICKS]}
    figure.update_yaxes(title_text="over threshold", type="log", **ticks, **cell)


def _add_bars(figure: go.Figure, time: Array, rows: Sequence[_Bar], cell: dict[str, int]) -> None:
    """Draw rows of bars, the first on top; each ends at the first message without it."""
    for height, row in enumerate(rows):
        edges = np.flatnonzero(np.diff(np.concatenate(([False], row.on, [False])).astype(np.int8)))
        spans: list[float | None] = []
        for start, stop in edges.reshape(-1, 2):
            spans += [float(time[start]), float(time[min(stop, len(time) - 1)]), None]
        figure.add_scatter(
            x=spans,
            y=[height] * len(spans),
            mode="lines",
            line={"color": row.colour, "width": _BAR_WIDTH},
            name=row.name,
            showlegend=False,
            hovertemplate="%{x:.1f} s",
            **cell,
        )
    labels = {"tickvals": list(range(len(rows))), "ticktext": [row.label for row in rows]}
    figure.update_yaxes(**labels, range=[len(rows) - 0.4, -0.6], showgrid=False, **cell)
