# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A validation under noise: two tables as in the paper, for the terminal, and a page with its figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

from rich.console import Group
from rich.text import Text
from scipy.stats import t as student_t

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.report.coverage_verdict import Coverage, count_verdicts
from quadpi_core.report.figure import Band, Figure, Layer, Line, Panel, Scale
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
from quadpi_core.report.table import Cell, Column, Mark, Table, Value, terminal_table
from quadpi_core.validation.realisations import HIGHEST, LOWEST, Spread
from quadpi_core.validation.validation_case import ValidationCase
from quadpi_core.validation.validation_result import (
    VARIATIONS,
    AxisValidation,
    Validation,
    Variation,
)

_TITLES = {"Forces": AXES[:3], "Moments": AXES[3:]}
# Headings of the columns of both tables.
_COVERAGE = ("train", "model", "meas.", "both")
_WIDTH = _COVERAGE[:-1]
# The variations that the paper judges intervals by; combined variation is for reference.
_JUDGED = VARIATIONS[:2]
_NOISE = {
    "velocity_m_s": ("velocity", "m/s"),
    "attitude_rad": ("attitude", "rad"),
    "rates_rad_s": ("rates", "rad/s"),
    "specific_force_m_s2": ("specific force", "m/s²"),
    "rotor_speeds_rad_s": ("rotor speeds", "rad/s"),
}
# The axes of the paper's figures.
BAND_AXES = ("Fz", "Fx", "My")
# Number of realisations whose extremes are drawn: those of 20 lie about two standard deviations from their
# mean (1.87 expected for normal noise), as the bounds of a 95 % interval do.
SHOWN = 20


def validation_table(result: Validation, axes: Sequence[str], *, title: str = "") -> Table:
    """Coverage and width under noise of each model, axis by axis."""
    columns = [
        Column("axis", is_text=True, once=True),
        Column("method", is_text=True),
        *(Column(heading, hundredths, group="PICP %") for heading in _COVERAGE),
        *(Column(heading, hundredths, group="NMPIW %") for heading in _WIDTH),
    ]
    rows = [
        [axis, name, *_cells(model.axes[axis], result.confidence)]
        for axis in axes
        for name, model in result.models.items()
        if axis in model.axes
    ]
    return Table(columns, rows, title=title)


def _cells(found: AxisValidation, confidence: float) -> list[Cell | Value]:
    """Coverage and width of one row; a coverage below the confidence is marked."""
    variations: dict[str, Variation] = {key: getattr(found, key) for key in VARIATIONS}
    covered = [
        Cell(part.picp, Mark.SHORT if key in _JUDGED and part.picp < confidence else None)
        for key, part in variations.items()
    ]
    # The flights that a model learned from are not known.
    return [None, *covered, None, *(variations[key].nmpiw for key in _JUDGED)]


def _tables(result: Validation) -> list[Table]:
    tables = [validation_table(result, axes, title=title) for title, axes in _TITLES.items()]
    return [table for table in tables if table.rows]


def validation_summary(result: Validation) -> Group:
    """The two tables for the terminal."""
    tables = _tables(result)
    marked = any(cell.mark is Mark.SHORT for table in tables for row in table.cells for cell in row)
    notes = [f"▼ covers less than {nominal(result.confidence)}"] if marked else []
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
        coverages[f"the {key.replace('_', ' ')}"] = of_key = []
        for axis in AXES:
            for name, model in result.models.items():
                if axis in model.axes:
                    variation = getattr(model.axes[axis], key)
                    interval = _over_realisations(variation, result.realisations)
                    of_key.append(Coverage(f"{name} {axis}", variation.picp, interval))
    verdicts = count_verdicts(coverages, result.confidence)
    return f"On these flights {nominal(result.confidence)} intervals {verdicts}."


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
            flight.name: {"bands": band_figure(case, place, spreads[flight.name], result)}
            for place, flight in enumerate(case.flights)
        },
    ).write(
        path,
        "validation.html",
        nominal=nominal(result.confidence),
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


def band_figure(case: ValidationCase, place: int, spread: Spread, result: Validation) -> Figure:
    """Bounds of each model (columns) on Fz, Fx and My (rows), and the variations that they have to cover.

    Args:
        case: that was validated.
        place: index of the flight in the case.
        spread: of the flight over realisations.
        result: of the validation, for the coverage of the flight.
    """
    flight = case.flights[place]
    time, known = flight.time, case.samples(flight).wrench
    modelled = {axis for model in case.models.values() for axis in model.axes}
    axes = [axis for axis in BAND_AXES if axis in modelled] or [axis for axis in AXES if axis in modelled][:1]
    panels = []
    for axis in axes:
        k, y = AXES.index(axis), Scale(f"{axis} [{unit(axis)}]")
        for name, colour in method_colours(case.models).items():
            title = name if axis == axes[0] else ""
            if axis not in case.models[name].axes:
                panels.append(Panel([], Scale("time [s]"), y, 190.0, title))
                continue
            reference = case.references[name][place]
            layers: list[Layer] = [
                Band("noisy measurements", MEASURED, time, *_ends(spread.measured, k), opacity=0.35),
                Band("noisy predictions", PREDICTED, time, *_ends(spread.predicted[name], k), 0.35, 1),
                Line("without noise", INK, time, known[:, k]),
            ]
            layers += [
                Line(f"{name} interval", colour, time, bound[:, k], dash="dashed")
                for bound in (reference.lower, reference.upper)
            ]
            covered = result.models[name].flights[flight.name][axis].measurement_variation
            notes = [f"{100.0 * covered:.1f} % covered"]
            panels.append(Panel(layers, Scale("time [s]"), y, 190.0, title, notes))
    return Figure("Intervals and noise", panels, len(case.models), over_time=True, shared=True)


def _ends(extremes: Array, axis: int) -> tuple[Array, Array]:
    """The lowest and the highest of realisations."""
    return extremes[LOWEST][..., axis], extremes[HIGHEST][..., axis]
