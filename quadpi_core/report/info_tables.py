# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables and JSON of `quadpi info` for a log, a bag or a model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import chain, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from quadpi_core.report.table import (
    Cell,
    Column,
    Mark,
    Row,
    Table,
    number,
    number_columns,
    percent,
    soft,
    terminal_table,
    text_columns,
)
from quadpi_core.screening.flight_runs import in_range, in_range_of_blocks
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.models.small_model import Headline

# Columns of what a kind says of its parameters, as far as they are shown in short.
_BY_AIR = "by the air"
_NUMBERS = ("value", "standard error")
_PARAMETER = ("parameter", *_NUMBERS, "unit")
# Steps of a selection, as `kinds.polynomial` gives them.
SelectionLog = Sequence[Mapping[str, Any]]


def selection_table(log: SelectionLog, title: str = "") -> Table:
    """Steps of the stepwise selection; a term that is not in the final model has no coefficient."""
    columns = [*text_columns("term", wraps=True), Column("coefficient", "{:.4e}".format)]
    columns += [Column("R² reached", "{:.4f}".format), Column("criterion", number)]
    rows = []
    for step in log:
        removed = f" (removed {', '.join(step['removed'])})" if step.get("removed") else ""
        known = ("" if value is None else value for value in (step["r2"], step.get("criterion")))
        row = [f"{step['term']}{removed}", step["coefficient"], *known]
        rows.append(soft(*row) if step["fixed"] else row)
    return Table(columns, rows, title=title)


def structure_table(selection: Mapping[str, SelectionLog], axes: Sequence[str]) -> Table:
    """Terms, coefficients and R² of the polynomials of some axes side by side, as in the paper."""
    columns = [
        column
        for axis in axes
        for column in (
            *(*text_columns(axis, is_code=True), Column("coefficient", "{:.3e}".format)),
            Column("R²", "{:.4f}".format),
        )
    ]
    empty: list[Cell | str | float | None] = ["", "", ""]
    steps = zip_longest(*(_final_terms(selection[axis]) for axis in axes), fillvalue=empty)
    return Table(columns, [list(chain.from_iterable(row)) for row in steps])


def _final_terms(log: SelectionLog) -> list[list[Cell | str | float | None]]:
    """Name, coefficient and R² of each term, in the order in which selection added them for good."""
    last = {row["term"]: place for place, row in enumerate(log)}
    return [
        [
            Cell(row["term"], Mark.SOFT) if row["fixed"] else row["term"],
            row["coefficient"],
            # Not left empty, which would mean that there is no term: fixed terms are fitted together.
            "–" if row["r2"] is None else row["r2"],
        ]
        for place, row in enumerate(log)
        if row["coefficient"] is not None and place == last[row["term"]]
    ]


def headline_table(model: AerodynamicModel) -> Table | None:
    """What matters first, in ten lines at most, beside the vehicle file; None if the model tells nothing."""
    from quadpi_core.models.small_model import headlines

    rows: list[Row] = [
        [one.quantity, one.value, _error(one), "" if one.known is None else one.known, one.unit]
        for one in headlines(model, model.load_vehicle())
    ]
    columns = [*text_columns(""), *number_columns("found"), *text_columns("±")]
    columns += [*number_columns("vehicle file"), *text_columns("unit")]
    note = "±: standard error"
    if any(_BY_AIR in str(row[2]) for row in rows):
        note += (
            f"; {_BY_AIR}: interval of 95 % at the density of the vehicle file, as logs do not tell that of "
            "the air flown in (log pressure and temperature, or set air_density_kg_m3)"
        )
    return Table(columns, rows, title="What the flights tell", note=note) if rows else None


def _error(one: Headline) -> str:
    ends = one.interval()
    if ends is not None and one.by_air != (1.0, 1.0):
        return f"{number(one.error or 0.0)}; {number(ends[0])} to {number(ends[1])} {_BY_AIR}"
    return one.note or ("" if one.error is None else number(one.error))


def best_known_table(model: AerodynamicModel, most: int) -> Table | None:
    """The parameters that its flights tell best, by value over standard error; None of a model without these.

    Args:
        model: of any kind.
        most: parameters to show.
    """
    for facts in model.fitted.facts(model.rollouts):
        if not set(_PARAMETER) <= set(facts.columns):
            continue
        places = [facts.columns.index(heading) for heading in _PARAMETER]
        rows = [[row[place] for place in places] for row in facts.rows]
        known = [row for row in rows if float(row[2]) > 0.0]
        known.sort(key=lambda row: abs(float(row[1])) / float(row[2]), reverse=True)
        columns = [*text_columns("parameter"), *number_columns(*_NUMBERS), *text_columns("unit")]
        title = f"{min(most, len(known))} of {len(known)} parameters, those known best"
        return Table(columns, [list(row) for row in known[:most]], title=title)
    return None


def fact_tables(model: AerodynamicModel) -> list[Table]:
    """What the kind of the model has to say of it."""
    tables = []
    for facts in model.fitted.facts(model.rollouts):
        numeric = [not isinstance(cell, str) for cell in facts.rows[0]] if facts.rows else []
        columns = [
            Column(heading, number) if is_number else Column(heading, is_text=True, wraps=True)
            for heading, is_number in zip(facts.columns, numeric, strict=False)
        ]
        tables.append(Table(columns, [list(row) for row in facts.rows], title=facts.title, note=facts.note))
    return tables


def term_tables(model: AerodynamicModel) -> list[Table]:
    """Terms of each axis of a polynomial; of other kinds, one table with the inputs of all axes."""
    if not all(model.selection[axis] for axis in model.axes):
        columns = [*text_columns("axis"), *text_columns("inputs", wraps=True)]
        return [Table(columns, [[axis, ", ".join(model.fitted.axes[axis].terms)] for axis in model.axes])]
    return [structure_table(model.selection, [axis]) for axis in model.axes]


def least_held_out(model: AerodynamicModel) -> str:
    """The least coverage of a training flight by a model of the others; empty if no flight was left out."""
    coverages = [
        (share, f"{flight.name}, {axis}")
        for axis in model.axes
        for flight, share in zip(model.flights, model.held_out_coverage[axis], strict=False)
    ]
    if not coverages:
        return ""
    least, where = min(coverages)
    middle = sorted(share for share, _ in coverages)[len(coverages) // 2]
    return (
        f"coverage of each flight by a model of the others: {percent(least)} at least ({where}), "
        f"median {percent(middle)}"
    )


def held_out_table(model: AerodynamicModel) -> Table | None:
    """Coverage of each training flight by a model of the others; None if no flight was left out."""
    if not all(model.held_out_coverage[axis] for axis in model.axes):
        return None
    rows: list[Row] = [
        [flight.name, *(model.held_out_coverage[axis][k] for axis in model.axes)]
        for k, flight in enumerate(model.flights)
    ]
    columns = [*text_columns("flight", wraps=True), *number_columns(*model.axes, shown=percent)]
    return Table(columns, rows, title="Coverage of each flight by a model of the others")


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
        *(*text_columns("topic", wraps=True), Column("samples"), *number_columns("s", "Hz", "±ms")),
        *(Column("gaps"), *number_columns("max ms"), Column("unsorted"), Column("NaN")),
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
    columns = [*text_columns("quantity", "unit"), *number_columns("lowest", "median", "highest")]
    rows: list[Row] = [
        [row.quantity, row.unit, row.lowest, row.median, row.highest] for row in inspection.envelope
    ]
    return Table(columns, rows, title="envelope")


def _finding_table(inspection: Inspection) -> Table:
    rows = [[Cell(finding, Mark.WARNING)] for finding in inspection.findings]
    rows = rows or [[Cell("nothing suspicious", Mark.GOOD)]]
    return Table(text_columns("", wraps=True), rows, title="findings")


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
        [*text_columns("flight"), Column("samples"), *text_columns("sha256")],
        [[flight.name, flight.samples, flight.sha256[:12]] for flight in model.flights],
        title="identified on",
    )
    columns = [*text_columns("input"), *number_columns("lowest", "highest")]
    envelope = Table(columns, _bounds(model), title="training envelope")
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
        "envelope": {name: [lower, upper] for name, lower, upper in _bounds(model)},
    }


def _bounds(model: AerodynamicModel) -> list[tuple[str, float, float]]:
    """Each input with its range in training."""
    bounds = model.envelope.lower.tolist(), model.envelope.upper.tolist()
    return list(zip(INPUT_NAMES, *bounds, strict=True))
