# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of an evaluation: coverage, time histories, the training envelope, residuals against airspeed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import numpy.typing as npt

from quadpi_core.evaluation.evaluation_result import AxisMetrics, Evaluation, FlightResult
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX
from quadpi_core.models.envelope import Envelope
from quadpi_core.report.page import DASHES, Band, Boxes, Figure, Layer, Limit, Line, Panel, Points, Scale
from quadpi_core.report.table import (
    GROUPS,
    INK,
    INPUT_LABELS,
    LEVELS,
    MEASURED,
    TRAINING,
    count,
    group_colours,
    number,
    percent,
    percent_range,
    unit,
)
from quadpi_core.screening.rotors_in_flight import runs_of

ENVELOPE_INPUTS = ("speed", "omega_avg", "mu_x", "mu_y", "mu_z", "p", "q", "r")
_HISTOGRAM_BINS = 60
# Share of the samples on either side that lies beyond the bins of a histogram.
_TAIL = 0.001
# Lowest share on the logarithmic axis [%].
_SHARE_FLOOR = 0.03
_SHARE_TICKS = ((0.1, "0.1 %"), (1.0, "1 %"), (10.0, "10 %"), (100.0, "100 %"))
_COLUMNS = 4
# Share of the samples outside the training range from which on it is written in the figure.
_WORTH_NOTING = 0.01
# Bins of airspeed, and samples that one needs for its quantiles to be drawn.
_SPEED_BINS, _FEWEST_SAMPLES = 14, 50

Groups = Mapping[str, Sequence[FlightResult]]


def time_history_figure(result: FlightResult, metrics: Mapping[str, AxisMetrics], colour: str) -> Figure:
    """Measured and predicted wrench of one flight with the prediction interval as a band, axis by axis.

    Args:
        result: the flight.
        metrics: its metrics per axis, as in the evaluation.
        colour: of prediction and band.
    """
    panels = []
    for axis in metrics:
        measured, predicted, lower, upper = (
            result.column(quantity, axis) for quantity in ("measured", "predicted", "lower", "upper")
        )
        layers: list[Layer] = [
            Band("prediction interval", colour, result.time, lower, upper),
            Line("measured", MEASURED, result.time, measured, width=0.8),
            Line("predicted", colour, result.time, predicted, width=2.0),
        ]
        y, notes = Scale(f"{axis} [{unit(axis)}]"), [f"PICP {percent(metrics[axis].picp)}"]
        panels.append(Panel(layers, Scale("time [s]"), y, 110.0, notes=notes))
    return Figure("Measured wrench in its prediction interval over time", panels, over_time=True)


def coverage_figure(evaluation: Evaluation) -> Figure:
    """Coverage of each axis and group with its confidence interval, beside the nominal coverage."""
    groups = evaluation.groups
    axes = list(dict.fromkeys(axis for part in groups.values() for axis in part.axes))
    nominal = 100.0 * evaluation.confidence
    layers: list[Layer] = [Limit("", INK, nominal, vertical=True, label=f"nominal {nominal:g} %")]
    for i, (group, colour) in enumerate(group_colours(groups).items()):
        held = groups[group].axes
        places = [axes.index(axis) + 0.5 * (i + 0.5) / len(groups) - 0.25 for axis in held]
        layers.append(
            Points(
                group,
                colour,
                100.0 * np.array([metrics.picp for metrics in held.values()]),
                -np.array(places),
                100.0 * np.array([metrics.picp_ci for metrics in held.values()]).reshape(-1, 2),
                vertical=False,
                texts=[f"{axis}: {percent(m.picp)} ({percent_range(m.picp_ci)})" for axis, m in held.items()],
                symbol=i % 4,
            )
        )
    bounds = [m.picp_ci[0] for part in groups.values() for m in part.axes.values()]
    lowest = min(nominal, 100.0 * min(bounds, default=1.0))
    ticks = [(float(-place), axis) for place, axis in enumerate(axes)]
    y = Scale("", 0.5 - len(axes), 0.5, ticks=ticks)
    panel = Panel(layers, Scale("PICP [%]", lowest - 2.0, 101.0), y, 20.0 + 44.0 * len(axes))
    return Figure("Coverage of each axis by group", [panel])


def envelope_figure(groups: Groups, envelope: Envelope) -> Figure:
    """Distributions of the main inputs by group over the range of the training flights.

    Shares have a logarithmic scale, as only the tails of a distribution leave the envelope. The range of the
    airspeed, which is not an input, is drawn if training flights are among those of the groups.
    """
    training = [f for flights in groups.values() for f in flights if f.in_sample]
    panels = []
    for name in ENVELOPE_INPUTS:
        values = {
            group: np.concatenate(
                [f.speed if name == "speed" else f.inputs[:, INPUT_INDEX[name]] for f in flights]
            )
            for group, flights in groups.items()
        }
        layers, notes = _histograms(values), []
        limits = _training_limits(name, envelope, training)
        if limits is not None:
            whole = np.array([np.nan])
            low, high = (np.array([limit]) for limit in limits)
            layers.insert(0, Boxes("flown in training", TRAINING, low, high, whole, whole, outlined=True))
            notes = _outside(values, limits)
        shares = Scale("", _SHARE_FLOOR, 100.0, logarithmic=True, ticks=_SHARE_TICKS)
        panels.append(Panel(layers, Scale(), shares, 150.0, INPUT_LABELS[name], notes))
    return Figure("Share of samples by input", panels, _COLUMNS, shared=True)


def _histograms(values: Mapping[str, Array]) -> list[Layer]:
    edges = _edges(list(values.values()))
    layers: list[Layer] = []
    for i, (group, colour) in enumerate(group_colours(values).items()):
        counts, _ = np.histogram(values[group], edges)
        share = np.maximum(100.0 * np.append(counts, counts[-1]) / len(values[group]), _SHARE_FLOOR)
        floor = np.full(len(edges), _SHARE_FLOOR)
        layers.append(Band("", colour, edges, floor, share, 0.12, stepped=True))
        layers.append(Line(group, colour, edges, share, dash=DASHES[i % len(DASHES)], stepped=True))
    return layers


def _outside(values: Mapping[str, Array], limits: tuple[float, float]) -> list[str]:
    notes = []
    for group, own in values.items():
        outside = float(np.mean((own < limits[0]) | (own > limits[1])))
        if outside >= _WORTH_NOTING:
            notes.append(f"{group}: {100 * outside:.0f} % outside")
    return notes


def residual_figure(groups: Groups, axes: Sequence[str], confidence: float) -> Figure:
    """Residuals over airspeed: band of the central share `confidence`, and the mean interval, dashed."""
    fastest = max(float(f.speed.max()) for flights in groups.values() for f in flights)
    edges = np.linspace(0.0, fastest, _SPEED_BINS + 1)
    tail = 0.5 - 0.5 * confidence
    panels = []
    for axis in axes:
        layers: list[Layer] = []
        for i, (group, colour) in enumerate(group_colours(groups).items()):
            speed, low, high, below, above = _residual_bands(groups[group], axis, edges, tail)
            layers.append(Band(group, colour, speed, low, high, pattern=i % 4))
            layers += [Line("", colour, speed, bound, dash="dashed") for bound in (below, above)]
        layers.append(Limit("", MEASURED, 0.0, dash=""))
        panels.append(Panel(layers, Scale(INPUT_LABELS["speed"]), Scale(), 180.0, f"{axis} [{unit(axis)}]"))
    return Figure("Residuals against airspeed", panels, min(3, len(axes)))


def _residual_bands(flights: Sequence[FlightResult], axis: str, edges: Array, tail: float) -> Array:
    """By bin of airspeed (5, K): mean speed, two quantiles of the residual, mean bounds − prediction."""
    measured, predicted, lower, upper = (
        np.concatenate([f.column(quantity, axis) for f in flights])
        for quantity in ("measured", "predicted", "lower", "upper")
    )
    speed = np.concatenate([f.speed for f in flights])
    bins = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, len(edges) - 2)
    columns = []
    for k in np.flatnonzero(np.bincount(bins, minlength=len(edges) - 1) >= _FEWEST_SAMPLES):
        chosen = bins == k
        residual = np.quantile(measured[chosen] - predicted[chosen], [tail, 1.0 - tail])
        below = np.mean(lower[chosen] - predicted[chosen])
        above = np.mean(upper[chosen] - predicted[chosen])
        columns.append((np.mean(speed[chosen]), *residual, below, above))
    return np.array(columns).reshape(-1, 5).T


def _training_limits(
    name: str, envelope: Envelope, training: Sequence[FlightResult]
) -> tuple[float, float] | None:
    if name != "speed":
        index = INPUT_INDEX[name]
        return float(envelope.lower[index]), float(envelope.upper[index])
    if not training:
        return None
    return min(float(f.speed.min()) for f in training), max(float(f.speed.max()) for f in training)


def _edges(values: Sequence[Array]) -> Array:
    """Bin edges between extreme quantiles of all groups, so that a single spike does not set the scale."""
    low = min(float(np.quantile(v, _TAIL)) for v in values)
    high = max(float(np.quantile(v, 1.0 - _TAIL)) for v in values)
    return np.linspace(low, high if high > low else low + 1.0, _HISTOGRAM_BINS + 1)


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
        formats: dict[str, tuple[str, Callable[[float], str]]] = {
            "first warning": ("warning_first_s", "{:.2f} s".format),
            "first alarm": ("alarm_first_s", "{:.2f} s".format),
            "time in alarm": ("alarm_fraction", percent),
            "samples in": ("samples_in", count),
            "predictions out": ("predictions_out", count),
            "dropped": ("dropped", count),
            "latency, median": ("latency_ms_p50", lambda value: f"{number(value)} ms"),
            "latency, 99 %": ("latency_ms_p99", lambda value: f"{number(value)} ms"),
        }
        undefined = {name: "none" if name.startswith("first") else "–" for name in formats}
        return {
            name: undefined[name] if (value := self.statistics[key]) is None else text(value)
            for name, (key, text) in formats.items()
        }


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
        holds = {name: np.array([name in own for own in live.inputs_outside]) for name in outside}
        inputs = [
            (name, INPUT_LABELS[name].split(" [")[0], holds[name], LEVELS["alarm"])
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
        starts, stops = np.array([*runs_of(on)], dtype=np.int64).reshape(-1, 2).T
        level = np.full(len(starts), -float(place))
        spans = time[starts], time[np.minimum(stops, len(time) - 1)]
        layers.append(Boxes(name, colour, *spans, level - _HALF_BAR, level + _HALF_BAR))
    ticks = [(-float(place), label) for place, (_, label, *_) in enumerate(rows)]
    return layers, Scale("time [s]"), Scale("", 0.4 - len(rows), 0.6, ticks=ticks)


# How far below the nominal coverage intervals still hold: 93 % instead of 95 % serves the same decisions.
TOLERANCE = 0.02
# A confidence interval narrower than 10 points tells 95 % coverage from 90 %; a wider one does not.
WIDEST = 0.10


class Holding(Enum):
    """Verdict on intervals from a measured coverage; the value of a member is the verb of the sentence."""

    HOLDS = "hold"
    NOT_SHOWN = "are not shown to hold"
    FAILS = "do not hold"


@dataclass(frozen=True)
class Coverage:
    """A share of measurements inside their interval.

    Attributes:
        subject: name in a sentence, such as that of an axis.
        estimate: the share.
        interval: 95 % confidence interval of the share (low, high); None where it is not known.
    """

    subject: str
    estimate: float
    interval: tuple[float, float] | None

    def holding(self, confidence: float) -> Holding:
        """Verdict on intervals of a nominal coverage.

        They hold if the estimate is at most :data:`TOLERANCE` below the nominal coverage and the confidence
        interval is narrower than :data:`WIDEST`. Else they fail if the whole confidence interval lies below
        the nominal coverage. In all other cases neither is shown.
        """
        if self.interval is None:
            return Holding.NOT_SHOWN
        low, high = self.interval
        if self.estimate >= confidence - TOLERANCE and high - low < WIDEST:
            return Holding.HOLDS
        return Holding.FAILS if high < confidence else Holding.NOT_SHOWN

    def sentence(self) -> str:
        """Subject and numbers, such as "Fx 83.4 %, 95 % confidence interval 61.9 % to 95.5 %"."""
        if self.interval is None:
            return f"{self.subject} {percent(self.estimate)}, its precision unknown"
        low, high = self.interval
        precision = f"95 % confidence interval {percent(low)} to {percent(high)}"
        return f"{self.subject} {percent(self.estimate)}, {precision}"


def axis_coverages(axes: Mapping[str, AxisMetrics]) -> list[Coverage]:
    """The coverage of each axis of a group or flight."""
    return [Coverage(axis, found.picp, (found.picp_ci[0], found.picp_ci[1])) for axis, found in axes.items()]


def joint_verdict(coverages: Sequence[Coverage], confidence: float) -> tuple[Holding, list[Coverage]]:
    """The worst of several verdicts, and the coverages that it applies to, the lowest first."""
    for verdict in (Holding.FAILS, Holding.NOT_SHOWN, Holding.HOLDS):
        found = [coverage for coverage in coverages if coverage.holding(confidence) is verdict]
        if found:
            return verdict, sorted(found, key=lambda coverage: coverage.estimate)
    raise ValueError("no coverage to judge")


def count_verdicts(groups: Mapping[str, Sequence[Coverage]], confidence: float) -> str:
    """A clause that counts, by group, the coverages that hold, are not shown to hold, and do not hold.

    The lowest one of the last two kinds is named with its numbers.
    """
    clauses = []
    for verdict in Holding:
        parts = []
        for group, coverages in groups.items():
            found = [coverage for coverage in coverages if coverage.holding(confidence) is verdict]
            if verdict is Holding.HOLDS:
                parts.append(f"{len(found)} of {len(coverages)} on {group}")
            elif found:
                lowest = min(found, key=lambda coverage: coverage.estimate)
                parts.append(f"{len(found)} on {group} ({lowest.sentence()})")
        if parts:
            clauses.append(f"{verdict.value} in {listing(parts)}")
    return "; ".join(clauses)


def listing(parts: Sequence[str], conjunction: str = "and") -> str:
    """Names as a sentence lists them: "a, b and c"."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} {conjunction} {parts[-1]}"
