# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A validation as the paper's two tables: for the terminal, and as a self-contained page with its figures."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text
from scipy.stats import t as student_t

from quadpi_core.flight import AXES
from quadpi_core.paper.realisations import Spread
from quadpi_core.paper.validation_case import ValidationCase
from quadpi_core.paper.validation_result import (
    VARIATIONS,
    AxisValidation,
    PublishedAxis,
    Validation,
    Variation,
)
from quadpi_core.report.band_figure import BAND_AXES, LINES, SHOWN, band_figure
from quadpi_core.report.decimation import bins_within
from quadpi_core.report.holding import Coverage, in_cells
from quadpi_core.report.page import (
    figure_of_flight,
    flight_menu,
    footer,
    heading,
    section,
    table,
    write_page,
)
from quadpi_core.report.style import number, unit

_TABLES = {"Forces": AXES[:3], "Moments": AXES[3:]}
# What a row shows, and under which heading.
_COVERAGE = {"training": "train", **dict(zip(VARIATIONS, ("model", "meas.", "both"), strict=True))}
_WIDTH = {key: heading for key, heading in _COVERAGE.items() if key != VARIATIONS[-1]}
# What the paper asks of valid intervals; training and combined stand for reference.
_JUDGED = VARIATIONS[:2]
_NOISE = {
    "velocity_m_s": ("velocity", "m/s"),
    "attitude_rad": ("attitude", "rad"),
    "rates_rad_s": ("rates", "rad/s"),
    "specific_force_m_s2": ("specific force", "m/s²"),
    "rotor_speeds_rad_s": ("rotor speeds", "rad/s"),
}
# All bands together draw so many samples, at about 11 bytes each in the page.
_DRAWN_SAMPLES = 300_000


def validation_tables(result: Validation) -> Group:
    """The two tables, with the paper's numbers below each row where there are some.

    Args:
        result: as :func:`quadpi_core.paper.validation_result.summarise` gives it.
    """
    nominal = f"{100.0 * result.confidence:g} %"
    head = Text(
        f"{nominal} prediction intervals; realisations of noise: {result.realisations}, on each of "
        f"{len(result.flights)} flights",
        style="bold",
    )
    tables = [_rich_table(result, title, axes) for title, axes in _TABLES.items() if _rows(result, axes)]
    notes = [f"▼ covers less than {nominal}"] if _any_short(result) else []
    notes += ["dim: the paper's numbers"] if result.published else []
    return Group(head, *tables, *(Text(note, style="dim") for note in notes))


def _rich_table(result: Validation, title: str, axes: Sequence[str]) -> Table:
    shown = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    shown.add_column("axis")
    shown.add_column("method", no_wrap=True)
    for quantity, columns in (("PICP %", _COVERAGE), ("NMPIW %", _WIDTH)):
        for i, text in enumerate(columns.values()):
            shown.add_column(f"{'' if i else quantity}\n{text}", justify="right", no_wrap=True)
    for axis, name, found, published in _rows(result, axes):
        cells = [
            Text(_coverage_text(found, key, result.confidence), style=_style(found, key, result))
            for key in _COVERAGE
        ]
        shown.add_row(axis, name, *cells, *(_hundredths(found, key, "nmpiw") for key in _WIDTH))
        if published:
            coverage = (_hundredths(published, key, "picp") for key in _COVERAGE)
            width = (_hundredths(published, key, "nmpiw") for key in _WIDTH)
            shown.add_row("", "", *coverage, *width, style="dim")
    return shown


def _style(found: AxisValidation, key: str, result: Validation) -> str:
    return "bold red" if _covers_too_little(found, key, result.confidence) else ""


def write_validation_page(
    path: Path, result: Validation, case: ValidationCase, spreads: Mapping[str, Spread]
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        result: as :func:`quadpi_core.paper.validation_result.summarise` gives it.
        case: that was validated.
        spreads: of its flights, by name, over SHOWN realisations.

    Raises:
        OutputError: if `path` cannot be written.
    """
    bins = bins_within(_DRAWN_SAMPLES, LINES * len(BAND_AXES) * len(case.models) * len(case.flights))
    figures = {
        f"bands {flight.name}": band_figure(case, place, spreads[flight.name], result, bins)
        for place, flight in enumerate(case.flights)
    }
    parts = [_header(result), _tables(result), _bands(result, bins), _flights(result), _definitions(result)]
    write_page(path, "quadpi: validation under noise", parts, figures)


def _header(result: Validation) -> str:
    cells: dict[str, list[Coverage]] = {f"the {key.replace('_', ' ')}": [] for key in _JUDGED}
    for axis, name, found, _ in _rows(result, AXES):
        for group, key in zip(cells, _JUDGED, strict=True):
            variation = getattr(found, key)
            interval = _over_realisations(variation, result.realisations)
            cells[group].append(Coverage(f"{name} {axis}", variation.picp, interval))
    confidence = result.confidence
    verdict = f"On these flights {100.0 * confidence:g}\u00a0% intervals {in_cells(cells, confidence)}."
    facts = {
        "models": ", ".join(f"{name} ({model.settings})" for name, model in result.models.items()),
        "vehicle": result.vehicle,
        "realisations": str(result.realisations),
        "flights": str(len(result.flights)),
        "seed": str(result.seed),
    }
    return heading("do the intervals hold under noise?", verdict, facts)


def _over_realisations(found: Variation, realisations: int) -> tuple[float, float] | None:
    """95 % confidence interval of a mean coverage over realisations of noise; None for a single one."""
    if found.picp_sd is None:
        return None
    margin = float(student_t.ppf(0.975, realisations - 1)) * found.picp_sd / math.sqrt(realisations)
    return max(found.picp - margin, 0.0), min(found.picp + margin, 1.0)


def _tables(result: Validation) -> str:
    tables = "".join(
        f"<h3>{title}</h3>{_html_table(result, axes)}"
        for title, axes in _TABLES.items()
        if _rows(result, axes)
    )
    paper = (
        " In the second row of each method, what van Beers and de Visser found." if result.published else ""
    )
    return section(
        "Coverage and width under noise",
        "PICP: share of predictions from noisy inputs (model), or of noisy measurements (meas.), inside "
        "the interval at the noise-free inputs; both: noisy measurements inside the interval at the "
        "noisy inputs, as in flight; train: the same on the training flights. NMPIW: mean width over the "
        f"range of what is to be covered. ▼ less than {100.0 * result.confidence:g} %.{paper}",
        tables,
    )


def _html_table(result: Validation, axes: Sequence[str]) -> str:
    top = (
        f'<tr><th></th><th></th><th colspan="{len(_COVERAGE)}" class="group">PICP [%]</th>'
        f'<th colspan="{len(_WIDTH)}" class="group">NMPIW [%]</th></tr>'
    )
    headings = "".join(f"<th>{text}</th>" for text in (*_COVERAGE.values(), *_WIDTH.values()))
    rows = []
    for axis, name, found, published in _rows(result, axes):
        cells = [
            f"<td{_mark(found, key, result)}>{_coverage_text(found, key, result.confidence)}</td>"
            for key in _COVERAGE
        ]
        cells += [f"<td>{_hundredths(found, key, 'nmpiw')}</td>" for key in _WIDTH]
        rows.append(f'<td>{axis}</td><td class="text">{escape(name)}</td>{"".join(cells)}')
        if published:
            values = [_hundredths(published, key, "picp") for key in _COVERAGE]
            values += [_hundredths(published, key, "nmpiw") for key in _WIDTH]
            rows.append(
                '<td></td><td class="text unit">paper</td>'
                + "".join(f'<td class="unit">{value}</td>' for value in values)
            )
    return table(f'{top}<tr><th>axis</th><th class="text">method</th>{headings}</tr>', rows)


def _mark(found: AxisValidation, key: str, result: Validation) -> str:
    return ' class="short"' if _covers_too_little(found, key, result.confidence) else ""


def _bands(result: Validation, bins: int) -> str:
    return section(
        "Intervals and what they have to cover",
        "Bounds at the noise-free inputs (lines, a colour per model) around the spread over "
        f"{SHOWN} realisations of the noisy measurements (grey) and of the predictions from noisy inputs "
        f"(pink). Of each of {bins} equal parts of a flight the extremes are drawn. Drag to zoom, "
        "double-click to reset.",
        flight_menu({"": list(result.flights)}) + figure_of_flight("bands"),
    )


def _flights(result: Validation) -> str:
    """Coverage of the measurements flight by flight: flights differ more than realisations do."""
    axes = [axis for axis in AXES if any(axis in model.axes for model in result.models.values())]
    head = "".join(f"<th>{axis}</th>" for axis in axes)
    rows = []
    for flight in result.flights:
        for name, model in result.models.items():
            shares = (model.flights[flight].get(axis) for axis in axes)
            cells = "".join(
                "<td>–</td>" if share is None else f"<td>{100.0 * share.measurement_variation:.2f}</td>"
                for share in shares
            )
            rows.append(f'<td>{escape(flight)}</td><td class="text">{escape(name)}</td>{cells}')
    return section(
        "Flight by flight",
        "Measured variation inside the interval, in percent. Realisations of one flight share its model "
        "error, so a thousand of them say no more about new flights than one does: the flights do.",
        table(f'<tr><th>flight</th><th class="text">method</th>{head}</tr>', rows),
    )


def _definitions(result: Validation) -> str:
    levels = asdict(result.noise)
    noise = ", ".join(f"{what} {number(levels[key])} {of}" for key, (what, of) in _NOISE.items())
    ranges = ", ".join(
        f"{axis} {number(found.measurement_variation.range)} {unit(axis)}"
        for axis, found in next(iter(result.models.values())).axes.items()
    )
    return footer(
        {
            "Noise": f"White, standard deviations: {noise}; independent in every realisation.",
            "NMPIW": "Of model variation over the range of the predictions, of measured variation over that "
            f"of the measurements ({ranges}), of training over that of the training measurements.",
            "Model variation": "An interval that is wide enough for the measurements covers it almost by "
            "construction: judge by the measurements.",
        }
    )


def _rows(
    result: Validation, axes: Sequence[str]
) -> list[tuple[str, str, AxisValidation, PublishedAxis | None]]:
    """Axis, model, what was found, and what the paper found."""
    published = result.published or {}
    return [
        (axis, name, model.axes[axis], published.get(name, {}).get(axis))
        for axis in axes
        for name, model in result.models.items()
        if axis in model.axes
    ]


def _any_short(result: Validation) -> bool:
    return any(
        _covers_too_little(found, key, result.confidence)
        for _, _, found, _ in _rows(result, AXES)
        for key in _JUDGED
    )


def _covers_too_little(found: AxisValidation, key: str, confidence: float) -> bool:
    return key in _JUDGED and bool(getattr(found, key).picp < confidence)


def _coverage_text(found: AxisValidation, key: str, confidence: float) -> str:
    return ("▼ " if _covers_too_little(found, key, confidence) else "") + _hundredths(found, key, "picp")


def _hundredths(found: AxisValidation | PublishedAxis, key: str, quantity: str) -> str:
    """A fraction in percent with the two decimals of the paper; a dash for what is undefined."""
    value = getattr(getattr(found, key, None), quantity, None)
    return "–" if value is None else f"{100.0 * value:.2f}"
