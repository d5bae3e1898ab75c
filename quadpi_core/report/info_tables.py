# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What `quadpi info` shows of a log, a bag or a model."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from rich import box
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from quadpi_core.errors import VehicleError
from quadpi_core.flight import STREAM_KINDS
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import FORMATS, blocks_of, decode_recording, identify_format, reading
from quadpi_core.logs.bags import bag_vehicle, has_topic, open_recording
from quadpi_core.logs.inspect import (
    Inspection,
    inspect_blocks,
    inspect_recording,
    inspect_topics,
    with_names_of_bag,
)
from quadpi_core.messages.adapters import AdapterSettings
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_folder import MODEL_FILE
from quadpi_core.report.style import number, percent
from quadpi_core.report.terminal_tables import structure_tables
from quadpi_core.vehicle import Vehicle


def describe(
    path: Path, vehicle: str | None, mapping: str | None
) -> tuple[Sequence[RenderableType], dict[str, Any]]:
    """Tables and the same content as JSON, for a log, a bag or a model folder.

    A bag names its vehicle itself; `vehicle` is for logs that do not, and vehicles of one's own. Without a
    vehicle nothing is compared with its limits. Of a bag without `imu` only the topics are shown.

    Raises:
        QuadpiError: for what cannot be read.
    """
    if (path / MODEL_FILE).is_file():
        model = AerodynamicModel.load(path)
        return model_tables(model), _model_json(model)
    is_bag = identify_format(path) is FORMATS["bag"]
    if is_bag and mapping is None and not has_topic(path, "imu"):
        inspection = inspect_topics(path)
        return [_topic_table(inspection), _finding_table(inspection)], _inspection_json(inspection)
    known = Vehicle.load(vehicle) if vehicle else _named_vehicle(bag_vehicle(path) if is_bag else "")
    if is_bag:
        inspection = _inspect_bag(path, known, mapping)
    else:
        inspection = inspect_recording(decode_recording(path, known, mapping), known)
    return inspection_tables(inspection), _inspection_json(inspection)


def _inspect_bag(path: Path, vehicle: Vehicle | None, mapping: str | None) -> Inspection:
    """What a bag holds, by the names of its topics relative to its root; it is never held whole."""
    with ExitStack() as opened:
        with reading(path):
            adapters = None if mapping is None else AdapterSettings.load(mapping)
            bag = opened.enter_context(open_recording(path, vehicle, adapters))
        inspection = inspect_blocks(partial(blocks_of, bag), vehicle)
        names = {STREAM_KINDS[field].topic: name.lstrip("/") for field, name in bag.sources.items()}
    return with_names_of_bag(inspection, names)


def _inspection_json(inspection: Inspection) -> dict[str, Any]:
    return {"kind": "recording", **asdict(inspection)}


def _named_vehicle(name: str) -> Vehicle | None:
    """The vehicle that a bag names, where its file is at hand."""
    try:
        return Vehicle.load(name) if name else None
    except VehicleError:
        return None


def inspection_tables(inspection: Inspection) -> list[Table]:
    """Topics, envelope and findings of a recording."""
    return [_topic_table(inspection), _envelope_table(inspection), _finding_table(inspection)]


def _topic_table(inspection: Inspection) -> Table:
    vehicle = inspection.vehicle or "not given"
    table = Table(title=f"{inspection.name} · vehicle {vehicle}", box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("topic", overflow="fold")
    for heading in ("samples", "s", "Hz", "±ms", "gaps", "max ms", "unsorted", "NaN"):
        table.add_column(heading, justify="right", no_wrap=True)
    for topic in inspection.topics:
        table.add_row(
            topic.topic,
            str(topic.count),
            number(topic.duration_s),
            number(topic.rate_hz),
            number(topic.jitter_ms),
            _count(topic.gaps),
            number(topic.longest_gap_s * 1e3),
            _count(topic.repeated + topic.backward),
            _count(topic.not_finite),
        )
    table.caption = "±ms: jitter of the intervals; max ms: the longest; unsorted: repeated or backward stamps"
    return table


def _count(value: int) -> Text:
    return Text(str(value), style="bold red" if value else "dim")


def _envelope_table(inspection: Inspection) -> Table:
    table = Table(title="envelope", box=box.SIMPLE_HEAD)
    table.add_column("quantity")
    table.add_column("unit")
    for heading in ("lowest", "median", "highest"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in inspection.envelope:
        table.add_row(row.quantity, row.unit, number(row.lowest), number(row.median), number(row.highest))
    return table


def _finding_table(inspection: Inspection) -> Table:
    table = Table(title="findings", box=box.SIMPLE_HEAD, show_header=False)
    table.add_column("finding")
    for finding in inspection.findings:
        table.add_row(Text(f"▲ {finding}", style="yellow"))
    if not inspection.findings:
        table.add_row(Text("nothing suspicious", style="green"))
    return table


def model_tables(model: AerodynamicModel) -> list[RenderableType]:
    """What a model is, its terms or inputs, training flights and envelope."""
    heading = Text(
        f"{model.identity or model.name} · vehicle {model.vehicle} · {model.method}, {model.settings} "
        f"settings · {percent(model.confidence)} intervals · low-pass {model.cutoff_hz:g} Hz",
        style="bold",
    )
    calibration = Text(f"{model.calibration()}; {model.alarm_limits.sentence()}", style="dim")
    flights = Table(title="identified on", box=box.SIMPLE_HEAD)
    flights.add_column("flight")
    flights.add_column("samples", justify="right")
    flights.add_column("sha256")
    for flight in model.flights:
        flights.add_row(flight.name, str(flight.samples), flight.sha256[:12])
    envelope = Table(title="training envelope", box=box.SIMPLE_HEAD)
    envelope.add_column("input")
    envelope.add_column("lowest", justify="right")
    envelope.add_column("highest", justify="right")
    for name, lower, upper in zip(INPUT_NAMES, model.envelope.lower, model.envelope.upper, strict=True):
        envelope.add_row(name, number(float(lower)), number(float(upper)))
    return [heading, calibration, structure_tables(model) or _input_table(model), flights, envelope]


def _input_table(model: AerodynamicModel) -> Table:
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("axis")
    table.add_column("inputs")
    for axis in model.axes:
        table.add_row(axis, Text(", ".join(model.fitted[axis].terms)))
    return table


def _model_json(model: AerodynamicModel) -> dict[str, Any]:
    return {
        "kind": "model",
        "name": model.name,
        "identity": model.identity,
        "vehicle": model.vehicle,
        "settings": model.settings,
        "cutoff_hz": model.cutoff_hz,
        "alarm": model.alarm_limits.to_json() | {"calibrated": model.alarm_limits.calibrated},
        "confidence": model.confidence,
        "axes": {axis: model.fitted[axis].terms for axis in model.axes},
        "flights": [asdict(flight) for flight in model.flights],
        "envelope": {
            name: [float(lower), float(upper)]
            for name, lower, upper in zip(
                INPUT_NAMES, model.envelope.lower, model.envelope.upper, strict=True
            )
        },
    }
