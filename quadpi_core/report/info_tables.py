# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and JSON of `quadpi info` for a log, a bag or a model."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.columns import Columns
from rich.console import RenderableType
from rich.text import Text

from quadpi_core.field.other_logs import named_vehicle
from quadpi_core.flight import STREAM_KINDS, Recording
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import blocks_of, decode_recording, identify_format, open_in_blocks
from quadpi_core.logs.inspect import (
    Inspection,
    inspect_blocks,
    inspect_recording,
    inspect_topics,
    with_names_of_bag,
)
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.alarm_limits import change_sentence
from quadpi_core.models.model_folder import MODEL_FILE
from quadpi_core.reading_options import MappingOrOptions, ReadingOptions, reading_options
from quadpi_core.report.model_tables import fact_tables, term_tables
from quadpi_core.report.style import number, percent
from quadpi_core.report.table import Cell, Column, Mark, Row, Table, terminal_table
from quadpi_core.screening.flight_runs import in_range, in_range_of_blocks
from quadpi_core.vehicle import Vehicle


def describe(
    path: Path, vehicle: str | None, mapping: MappingOrOptions = None
) -> tuple[Sequence[RenderableType], dict[str, Any]]:
    """Tables for a log, a bag or a model folder, and the same content as JSON.

    Args:
        path: of the log, bag or model folder.
        vehicle: name or file; None for that which a bag names, without which limits are not checked.
        mapping: of the columns or messages, as `import` takes it.

    Raises:
        QuadpiError: if the path cannot be read. Of a bag without `imu` the topics are shown nevertheless.
    """
    if (path / MODEL_FILE).is_file():
        model = AerodynamicModel.load(path)
        return model_summary(model), _model_json(model)
    container = identify_format(path).container
    stamps = None
    if container and reading_options(mapping) == ReadingOptions():
        stamps = container.topic_stamps(path)
    if stamps is not None:
        inspection = inspect_topics(path, stamps)
        tables = [_topic_table(inspection), _finding_table(inspection)]
    else:
        known = Vehicle.load(vehicle) if vehicle else None
        if container:
            known = known or named_vehicle(container.vehicle_name(path))
            inspection = _inspect_in_blocks(path, known, mapping)
        else:
            recording = in_range(decode_recording(path, known, mapping), reading_options(mapping).part)
            inspection = inspect_recording(recording, known)
        tables = inspection_tables(inspection)
    return list(map(terminal_table, tables)), {"kind": "recording", **asdict(inspection)}


def _inspect_in_blocks(path: Path, vehicle: Vehicle | None, mapping: MappingOrOptions) -> Inspection:
    """Inspect a log block by block, without holding it in memory, by the names of its topics."""
    with open_in_blocks(path, vehicle, mapping) as log:

        def blocks() -> Iterator[Recording]:
            return in_range_of_blocks(blocks_of(log), log.source, reading_options(mapping).part)

        inspection = inspect_blocks(blocks, vehicle)
        names = {
            STREAM_KINDS[field].topic: name.lstrip("/")
            for field, name in log.sources.items()
            if field in STREAM_KINDS
        }
    return with_names_of_bag(inspection, names)


def inspection_tables(inspection: Inspection) -> list[Table]:
    """Topics, envelope and findings of a recording."""
    return [_topic_table(inspection), _envelope_table(inspection), _finding_table(inspection)]


def _topic_table(inspection: Inspection) -> Table:
    vehicle = inspection.vehicle or "not given"
    columns = [
        Column("topic", is_text=True, wraps=True),
        Column("samples"),
        *(Column(heading, number) for heading in ("s", "Hz", "±ms")),
        Column("gaps"),
        Column("max ms", number),
        Column("unsorted"),
        Column("NaN"),
    ]
    rows: list[Row] = [
        [
            *(topic.topic, topic.count, topic.duration_s, topic.rate_hz, topic.jitter_ms),
            _fault_count(topic.gaps),
            topic.longest_gap_s * 1e3,
            _fault_count(topic.repeated + topic.backward),
            _fault_count(topic.not_finite),
        ]
        for topic in inspection.topics
    ]
    note = "±ms: jitter of the intervals; max ms: longest interval; unsorted: repeated or backward stamps"
    return Table(columns, rows, title=f"{inspection.name} · vehicle {vehicle}", note=note)


def _fault_count(value: int) -> Cell:
    return Cell(value, Mark.FAULT if value else Mark.SOFT)


def _envelope_table(inspection: Inspection) -> Table:
    columns = [
        Column("quantity", is_text=True),
        Column("unit", is_text=True),
        *(Column(heading, number) for heading in ("lowest", "median", "highest")),
    ]
    rows: list[Row] = [
        [row.quantity, row.unit, row.lowest, row.median, row.highest] for row in inspection.envelope
    ]
    return Table(columns, rows, title="envelope")


def _finding_table(inspection: Inspection) -> Table:
    rows = [[Cell(finding, Mark.WARNING)] for finding in inspection.findings]
    rows = rows or [[Cell("nothing suspicious", Mark.GOOD)]]
    return Table([Column("", is_text=True, wraps=True)], rows, title="findings")


def model_summary(model: AerodynamicModel) -> list[RenderableType]:
    """A model's settings, terms or inputs, training flights and envelope, for the terminal."""
    heading = Text(
        f"{model.identity or model.name} · vehicle {model.vehicle} · {model.method}, {model.settings} "
        f"settings · {percent(model.confidence)} intervals · low-pass {model.cutoff_hz:g} Hz",
        style="bold",
    )
    sentences = (model.calibration(), model.alarm_limits.sentence(), change_sentence(model.change_limits))
    calibration = Text("; ".join(sentences), style="dim")
    flights = Table(
        [Column("flight", is_text=True), Column("samples"), Column("sha256", is_text=True)],
        [[flight.name, flight.samples, flight.sha256[:12]] for flight in model.flights],
        title="identified on",
    )
    bounds = zip(INPUT_NAMES, model.envelope.lower, model.envelope.upper, strict=True)
    envelope = Table(
        [Column("input", is_text=True), Column("lowest", number), Column("highest", number)],
        [[name, float(lower), float(upper)] for name, lower, upper in bounds],
        title="training envelope",
    )
    terms = Columns(map(terminal_table, term_tables(model)), padding=(0, 3))
    facts = map(terminal_table, fact_tables(model))
    return [heading, calibration, terms, *facts, terminal_table(flights), terminal_table(envelope)]


def _model_json(model: AerodynamicModel) -> dict[str, Any]:
    limits = model.alarm_limits
    return {
        "kind": "model",
        "name": model.name,
        "identity": model.identity,
        "vehicle": model.vehicle,
        "settings": model.settings,
        "cutoff_hz": model.cutoff_hz,
        "alarm": limits.to_json()
        | {
            "calibrated": limits.calibrated,
            "rate_bound_per_hour": limits.rate_bound_per_hour,
            "rate_extrapolated": limits.rate_extrapolated,
        },
        "change": None if model.change_limits is None else model.change_limits.to_json(),
        "confidence": model.confidence,
        "axes": {axis: model.fitted.axes[axis].terms for axis in model.axes},
        "facts": {
            facts.title: [dict(zip(facts.columns, row, strict=True)) for row in facts.rows]
            for facts in model.fitted.facts(model.rollouts)
        },
        "flights": [flight.to_json() for flight in model.flights],
        "envelope": {
            name: [float(lower), float(upper)]
            for name, lower, upper in zip(
                INPUT_NAMES, model.envelope.lower, model.envelope.upper, strict=True
            )
        },
    }
