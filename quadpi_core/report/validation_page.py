# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A validation under noise as the paper's two tables: for the terminal, and as a page with its figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.text import Text
from scipy.stats import t as student_t

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.paper.realisations import HIGHEST, LOWEST, Spread
from quadpi_core.paper.validation_case import ValidationCase
from quadpi_core.paper.validation_result import (
    VARIATIONS,
    AxisValidation,
    PublishedAxis,
    Validation,
    Variation,
)
from quadpi_core.report.coverage_verdict import Coverage, count_verdicts
from quadpi_core.report.figure import Band, Figure, Layer, Line, Panel, Scale
from quadpi_core.report.figure_data import bins_within, blocks, thinned_line
from quadpi_core.report.page import Page
from quadpi_core.report.style import (
    INK,
    MEASURED,
    PREDICTED,
    hundredths,
    method_colours,
    nominal,
    number,
    unit,
)
from quadpi_core.report.table import Cell, Column, Mark, Table, Value, soft, terminal_table

_PUBLISHED = "published"
_TITLES = {"Forces": AXES[:3], "Moments": AXES[3:]}
# Attributes of a result that are columns of the tables, with their headings.
_COVERAGE = {"training": "train", **dict(zip(VARIATIONS, ("model", "meas.", "both"), strict=True))}
_WIDTH = {key: heading for key, heading in _COVERAGE.items() if key != VARIATIONS[-1]}
# The variations that the paper judges intervals by; training and combined variation are for reference.
_JUDGED = VARIATIONS[:2]
_NOISE = {
    "velocity_m_s": ("velocity", "m/s"),
    "attitude_rad": ("attitude", "rad"),
    "rates_rad_s": ("rates", "rad/s"),
    "specific_force_m_s2": ("specific force", "m/s²"),
    "rotor_speeds_rad_s": ("rotor speeds", "rad/s"),
}
# The axes of the paper's figures, and the lines of each axis and model: two bands, interval and truth.
BAND_AXES = ("Fz", "Fx", "My")
_LINES = 4
# Number of realisations whose extremes are drawn: those of 20 lie about two standard deviations from their
# mean (1.87 expected for normal noise), as the bounds of a 95 % interval do.
SHOWN = 20


def validation_table(
    results: Sequence[Validation], axes: Sequence[str], *, title: str = "", with_settings: bool = False
) -> Table:
    """Coverage and width under noise, with the paper's numbers below each method where there are some.

    Args:
        results: of models of the same names, such as one result for each settings.
        axes: to show.
        title: of the table.
        with_settings: whether a column names the settings, which distinguish the results of a model.
    """
    columns = [
        Column("axis", is_text=True, once=True),
        Column("method", is_text=True, once=with_settings),
        *([Column("settings", is_text=True)] if with_settings else []),
        *(Column(heading, hundredths, group="PICP %") for heading in _COVERAGE.values()),
        *(Column(heading, hundredths, group="NMPIW %") for heading in _WIDTH.values()),
    ]
    published = results[0].published or {}
    rows: list[list[Cell | Value]] = []
    for axis in axes:
        for name in results[0].models:
            held = [result for result in results if axis in result.models[name].axes]
            for result in held:
                model = result.models[name]
                settings = [model.settings] if with_settings else []
                rows.append([axis, name, *settings, *_cells(model.axes[axis], result.confidence)])
            if held and (known := published.get(name, {}).get(axis)):
                label = [name, *soft(_PUBLISHED)] if with_settings else soft(_PUBLISHED)
                rows.append([axis, *label, *soft(*_cells(known, None))])
    return Table(columns, rows, title=title)


def _cells(found: AxisValidation | PublishedAxis, confidence: float | None) -> list[Cell | Value]:
    """Coverage and width of one row; a coverage below the confidence, unless that is None, is marked."""
    parts: dict[str, Any] = {key: getattr(found, key, None) for key in _COVERAGE}
    cells: list[Cell | Value] = []
    for key, part in parts.items():
        short = part is not None and confidence is not None and key in _JUDGED and part.picp < confidence
        cells.append(Cell(part.picp, Mark.SHORT) if short else getattr(part, "picp", None))
    return [*cells, *(getattr(parts[key], "nmpiw", None) for key in _WIDTH)]


def _tables(result: Validation) -> list[Table]:
    tables = [validation_table([result], axes, title=title) for title, axes in _TITLES.items()]
    return [table for table in tables if table.rows]


def validation_summary(result: Validation) -> Group:
    """The two tables for the terminal, with the paper's numbers below each row where there are some."""
    tables = _tables(result)
    marked = any(cell.mark is Mark.SHORT for table in tables for row in table.cells for cell in row)
    notes = [f"▼ covers less than {nominal(result.confidence)}"] if marked else []
    notes += ["dim: the paper's numbers"] if result.published else []
    return Group(
        Text(
            f"{nominal(result.confidence)} prediction intervals; realisations of noise: "
            f"{result.realisations}, on each of {len(result.flights)} flights",
            style="bold",
        ),
        *map(terminal_table, tables),
        *(Text(note, style="dim") for note in notes),
    )


def validation_verdict(result: Validation) -> str:
    """The page's headline: in how many axes of all models the intervals hold under each variation."""
    coverages: dict[str, list[Coverage]] = {}
    for key in _JUDGED:
        coverages[f"the {key.replace('_', ' ')}"] = own = []
        for axis in AXES:
            for name, model in result.models.items():
                if axis in model.axes:
                    variation = getattr(model.axes[axis], key)
                    interval = _over_realisations(variation, result.realisations)
                    own.append(Coverage(f"{name} {axis}", variation.picp, interval))
    found = count_verdicts(coverages, result.confidence)
    return f"On these flights {nominal(result.confidence)} intervals {found}."


def _over_realisations(found: Variation, realisations: int) -> tuple[float, float] | None:
    """95 % confidence interval of a mean coverage over realisations of noise; None for a single one."""
    if found.picp_sd is None:
        return None
    margin = float(student_t.ppf(0.975, realisations - 1)) * found.picp_sd / math.sqrt(realisations)
    return max(found.picp - margin, 0.0), min(found.picp + margin, 1.0)


def write_validation_page(
    path: Path, result: Validation, case: ValidationCase, spreads: Mapping[str, Spread]
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        result: of the validation.
        case: that was validated.
        spreads: of its flights, by name, over SHOWN realisations.

    Raises:
        OutputError: if `path` cannot be written.
    """
    bins = bins_within(_LINES * len(BAND_AXES) * len(case.models) * len(case.flights))
    Page(
        title="quadpi: validation under noise",
        about="do the intervals hold under noise?",
        verdict=validation_verdict(result),
        facts={
            "models": ", ".join(f"{model.model} ({model.settings})" for model in result.models.values()),
            "vehicle": result.vehicle,
            "realisations": str(result.realisations),
            "flights": str(len(result.flights)),
            "seed": str(result.seed),
        },
        definitions=_definitions(result),
        figures={},
        flight_figures={
            flight.name: {"bands": band_figure(case, place, spreads[flight.name], result, bins)}
            for place, flight in enumerate(case.flights)
        },
    ).write(
        path,
        "validation.html",
        nominal=nominal(result.confidence),
        bins=bins,
        published=result.published,
        tables=_tables(result),
        by_flight=_flight_table(result),
        flights=list(result.flights),
        realisations_shown=SHOWN,
    )


def _flight_table(result: Validation) -> Table:
    """Coverage of the measurements of each flight: flights differ by more than realisations of noise do."""
    axes = [axis for axis in AXES if any(axis in model.axes for model in result.models.values())]
    columns = [
        Column("flight", is_text=True, once=True),
        Column("method", is_text=True),
        *(Column(axis, hundredths) for axis in axes),
    ]
    rows = []
    for flight in result.flights:
        for name, model in result.models.items():
            shares = (model.flights[flight].get(axis) for axis in axes)
            covered = (None if share is None else share.measurement_variation for share in shares)
            rows.append([flight, name, *covered])
    return Table(columns, rows)


def _definitions(result: Validation) -> dict[str, str]:
    levels = asdict(result.noise)
    noise = ", ".join(f"{name} {number(levels[key])} {of}" for key, (name, of) in _NOISE.items())
    ranges = ", ".join(
        f"{axis} {number(found.measurement_variation.range)} {unit(axis)}"
        for axis, found in next(iter(result.models.values())).axes.items()
    )
    return {
        "Noise": f"White, standard deviations: {noise}; independent in every realisation.",
        "NMPIW": "Of model variation over the range of the predictions, of measured variation over that "
        f"of the measurements ({ranges}), of training over that of the training measurements.",
        "Model variation": "An interval that is wide enough for the measurements covers it almost by "
        "construction: judge by the measurements.",
    }


def band_figure(case: ValidationCase, place: int, spread: Spread, result: Validation, bins: int) -> Figure:
    """Bounds of each model (columns) on Fz, Fx and My (rows), and the variations that they have to cover.

    Args:
        case: that was validated.
        place: index of the flight in the case.
        spread: of the flight over realisations.
        result: of the validation, for the coverage of the flight.
        bins: number of parts that the flight is cut into, of which the extremes are drawn.
    """
    flight = case.flights[place]
    held = {axis for model in case.models.values() for axis in model.axes}
    axes = [axis for axis in BAND_AXES if axis in held] or [axis for axis in AXES if axis in held][:1]
    panels = []
    for column, (name, colour) in enumerate(method_colours(case.models).items()):
        reference = case.references[name][place]
        for row, axis in enumerate(axes):
            if axis not in case.models[name].axes:
                continue
            k = AXES.index(axis)
            layers: list[Layer] = [
                Band(of, shade, *blocks(flight.time, low, high, bins), opacity=0.35, pattern=pattern)
                for of, (low, high), shade, pattern in (
                    ("noisy measurements", _ends(spread.measured, k), MEASURED, 0),
                    ("noisy predictions", _ends(spread.predicted[name], k), PREDICTED, 1),
                )
            ]
            truth = reference.wrench[:, k]
            layers.append(thinned_line(flight.time, truth, bins, name="without noise", colour=INK))
            found = blocks(flight.time, reference.lower[:, k], reference.upper[:, k], bins)
            layers += [
                Line(f"{name} interval", colour, found.x, bound, dash="dashed")
                for bound in (found.low, found.high)
            ]
            covered = result.models[name].flights[flight.name][axis].measurement_variation
            notes = [f"{100.0 * covered:.1f} % covered"]
            title, y = "" if row else name, Scale(f"{axis} [{unit(axis)}]")
            panels.append(Panel(layers, Scale("time [s]"), y, title, notes, row, column))
    return Figure("Intervals and noise", panels, [190.0] * len(axes), over_time=True, shared=True)


def _ends(extremes: Array, axis: int) -> tuple[Array, Array]:
    """The lowest and the highest of realisations."""
    return extremes[LOWEST][..., axis], extremes[HIGHEST][..., axis]
