# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables as records, drawn in terminals, pages and text; words, numbers, colours of results; the bar."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from itertools import cycle, groupby, pairwise
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar
from rich.table import Table as RichTable
from rich.text import Text

from quadpi_core.models.kind_registry import KINDS
from quadpi_core.parallel import Progress, ReportProgress

Value = str | float | None


class Mark(Enum):
    """Why a cell stands out; the value of a member is the class of the cell in HTML."""

    SHORT = "short"
    FAULT = "fault"
    SOFT = "soft"
    WARNING = "warning"
    GOOD = "good"


_STYLES = {
    Mark.SHORT: "bold red",
    Mark.FAULT: "bold red",
    Mark.SOFT: "dim",
    Mark.WARNING: "yellow",
    Mark.GOOD: "green",
}
_SYMBOLS = {Mark.SHORT: "▼ ", Mark.WARNING: "▲ "}
_MISSING = "–"
# Between columns of the terminal that share a heading.
_GAP = " "


@dataclass(frozen=True)
class Cell:
    """A value of a table.

    Attributes:
        value: text, or a number that the column formats; None where it is undefined.
        mark: why the cell stands out.
        unit: shown after the value.
        detail: a second line below the value.
    """

    value: Value
    mark: Mark | None = None
    unit: str = ""
    detail: str = ""


Row = Sequence[Cell | Value]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        heading: above the column.
        format: text of a number.
        is_text: whether to align to the left, as text, rather than to the right, as numbers.
        wraps: whether long text is broken into lines.
        group: heading shared by adjacent columns; empty for none.
        colour: of the shared heading in HTML.
        once: whether to leave a value out if the row above has the same one, here and in all such columns to
            the left.
        is_section: as `once`, but on the terminal, where width is scarce, values are headings between rows.
        is_soft: whether the column is less prominent than the others.
        is_code: whether the values are expressions, which Markdown shows as code.
        chooses_flight: whether the values are flights, which a click in HTML selects in the menu of the page.
    """

    heading: str
    format: Callable[[Any], str] = str
    is_text: bool = False
    wraps: bool = False
    group: str = ""
    colour: str = ""
    once: bool = False
    is_section: bool = False
    is_soft: bool = False
    is_code: bool = False
    chooses_flight: bool = False

    @property
    def css(self) -> str:
        """Classes of its cells in HTML."""
        names = {"text": self.is_text, "wraps": self.wraps, "soft": self.is_soft}
        return " ".join(name for name, applies in names.items() if applies)

    def text(self, cell: Cell) -> str:
        """The text of a cell, without its unit."""
        symbol = _SYMBOLS.get(cell.mark, "") if cell.mark else ""
        if cell.value is None:
            return _MISSING
        return symbol + (cell.value if isinstance(cell.value, str) else self.format(cell.value))


def text_columns(*headings: str, **options: Any) -> list[Column]:
    """A column of text for each heading."""
    return [Column(heading, is_text=True, **options) for heading in headings]


def number_columns(*headings: str, shown: Callable[[Any], str] | None = None, **options: Any) -> list[Column]:
    """A column of numbers for each heading; `shown` is their format, unless given :func:`number`."""
    return [Column(heading, shown or number, **options) for heading in headings]


@dataclass(frozen=True)
class Table:
    """Rows of cells below headings.

    Attributes:
        columns: from left to right.
        rows: a cell or value for each column.
        title: above the table.
        note: below the table.
        cells: the rows as they are drawn, repeated values of `once` columns left out.
    """

    columns: Sequence[Column]
    rows: Sequence[Row]
    title: str = ""
    note: str = ""
    cells: tuple[tuple[Cell, ...], ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        rows = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in self.rows]
        repeated = [place for place, column in enumerate(self.columns) if column.once or column.is_section]
        for before, row in reversed(list(pairwise(rows))):
            for place in repeated:
                if row[place].value != before[place].value:
                    break
                row[place] = Cell("")
        object.__setattr__(self, "cells", tuple(map(tuple, rows)))

    def without(self, *headings: str, title: str = "") -> Table:
        """The same table without some columns, under another title."""
        places = [place for place, column in enumerate(self.columns) if column.heading not in headings]
        rows = [[row[place] for place in places] for row in self.rows]
        return Table([self.columns[place] for place in places], rows, title=title)

    @property
    def groups(self) -> list[tuple[Column, list[int]]]:
        """The first column below each shared heading, and the places of all of them.

        A column without a shared heading is a group of its own.
        """
        places = range(len(self.columns))
        keyed = groupby(places, key=lambda place: self.columns[place].group or place)
        return [(self.columns[members[0]], members) for members in (list(own) for _, own in keyed)]


def soft(*values: Cell | Value) -> list[Cell | Value]:
    """Cells that are less prominent than others; empty ones stay as they are."""
    return [
        Cell(value, Mark.SOFT) if isinstance(value, str | float) and value != "" else value
        for value in values
    ]


def terminal_table(table: Table) -> RichTable:
    """Draw a table for the terminal."""
    shown = RichTable(
        title=Text(table.title) if table.title else None,
        title_justify="left",
        caption=Text(table.note) if table.note else None,
        caption_justify="left",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
        show_header=any(column.heading for column in table.columns),
    )
    groups = [(column, places) for column, places in table.groups if not column.is_section]
    grouped = any(column.group for column, _ in groups)
    widths = [
        max(cell_len(line) for line in (column.heading, *(column.text(row[place]) for row in table.cells)))
        for place, column in enumerate(table.columns)
    ]
    for column, places in groups:
        headings = _GAP.join(f"{table.columns[place].heading:>{widths[place]}}" for place in places)
        shown.add_column(
            Text(f"{column.group:^{cell_len(headings)}}\n{headings}", justify="left")
            if column.group
            else column.heading,
            justify="left" if column.is_text else "right",
            vertical="bottom" if grouped else "top",
            # Text gives way before a figure loses a digit.
            no_wrap=not (column.wraps or column.is_text or column.group),
            overflow="fold",
        )
    sections = [place for place, column in enumerate(table.columns) if column.is_section]
    for row in table.cells:
        for place in sections:
            if row[place].value:
                shown.add_section()
                text = _with_unit(table.columns[place], row[place])
                shown.add_row(Text.assemble((text, "bold")))
        shown.add_row(*(_terminal_cell(table, row, places, widths) for _, places in groups))
    return shown


def _terminal_cell(table: Table, row: Sequence[Cell], places: Sequence[int], widths: Sequence[int]) -> Text:
    shown = Text()
    for place in places:
        column, cell = table.columns[place], row[place]
        text = column.text(cell)
        if place != places[0]:
            shown.append(_GAP)
        if len(places) > 1:
            shown.append(" " * (widths[place] - cell_len(text)))
        shown.append(text, _STYLES[cell.mark] if cell.mark else "dim" if column.is_soft else "")
        if cell.unit:
            shown.append(f" {cell.unit}", "dim")
        if cell.detail:
            shown.append(f"\n{cell.detail}", "dim")
    return shown


def _with_unit(column: Column, cell: Cell) -> str:
    return f"{column.text(cell)} [{cell.unit}]" if cell.unit else column.text(cell)


def markdown_table(table: Table) -> str:
    """Draw a table as Markdown, without its title and note; undefined values are left empty."""
    headings = [f"{column.group} {column.heading}".strip() for column in table.columns]
    rule = [":--" if column.is_text else "--:" for column in table.columns]
    rows = [
        [_markdown_cell(column, cell) for column, cell in zip(table.columns, row, strict=True)]
        for row in table.cells
    ]
    lines = [[text.replace("|", "\\|") for text in line] for line in (headings, rule, *rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _markdown_cell(column: Column, cell: Cell) -> str:
    if cell.value is None or cell.value == "":
        return ""
    text = _with_unit(column, cell)
    text = f"`{text}`" if column.is_code else text
    emphasis = {Mark.SOFT: "*", Mark.FAULT: "**"}.get(cell.mark, "") if cell.mark else ""
    return f"{emphasis}{text}{emphasis}"


# Names of colours in assets/look.css.
MEASURED, INK, RULE, TRAINING, PREDICTED = "measured", "ink", "rule", "training", "predicted"
GROUPS = ("model-1", "model-2", "model-3", "model-4", "model-5", "model-6")
LEVELS = {"ok": "trusted-line", "warning": "warning-line", "alarm": "alarm-line"}
# The set of Okabe and Ito, and the indigo of Tol: the style sheet has a form of each for every ground.
_NAMES = dict(
    zip(
        ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#332288"),
        (*GROUPS, "model-7"),
        strict=True,
    )
)

INPUT_LABELS = {
    "u": "u [m/s]",
    "v": "v [m/s]",
    "w": "w [m/s]",
    "v_in": "v_in [m/s]",
    "p": "p [rad/s]",
    "q": "q [rad/s]",
    "r": "r [rad/s]",
    "omega_avg": "ω_avg [rad/s]",
    "sin_phi": "sin φ",
    "cos_phi": "cos φ",
    "sin_theta": "sin θ",
    "cos_theta": "cos θ",
    "U_p": "U_p [rad/s]",
    "U_q": "U_q [rad/s]",
    "U_r": "U_r [rad/s]",
    "mu_x": "μ_x",
    "mu_y": "μ_y",
    "mu_z": "μ_z",
    "mu_v_in": "μ_v,in",
    "speed": "airspeed [m/s]",
}


def group_colours(groups: Iterable[str]) -> dict[str, str]:
    """A colour for each group in order; they repeat after the last."""
    return {name: GROUPS[i % len(GROUPS)] for i, name in enumerate(groups)}


def method_colours(names: Iterable[str]) -> dict[str, str]:
    """A colour per model, that of its kind where it is named after one; the others share what is left."""
    distinct = dict.fromkeys(names)
    colours = {name: _NAMES.get(kind.colour, kind.colour) for name in distinct if (kind := KINDS.named(name))}
    taken = {*colours.values(), GROUPS[3]}
    spare = cycle(colour for colour in GROUPS if colour not in taken)
    return {name: colours.get(name) or next(spare) for name in distinct}


def css_colour(colour: str) -> str:
    """A colour for a style sheet: #rrggbb as it is, a name as the variable."""
    return colour if colour.startswith("#") else f"var(--{colour})"


def unit(axis: str) -> str:
    """Unit of an axis of the wrench."""
    return "N" if axis.startswith("F") else "Nm"


def nominal(confidence: float) -> str:
    """The nominal coverage of intervals, in percent."""
    return f"{100.0 * confidence:g}\u00a0%"


def count(value: float) -> str:
    """A whole number with thin spaces between thousands."""
    return f"{value:,.0f}".replace(",", "\u202f")


def percent(fraction: float) -> str:
    """A fraction in percent with one decimal; only 1 and 0 are shown as 100 and 0."""
    return f"{_in_percent(fraction, 1)} %"


def hundredths(fraction: float) -> str:
    """A fraction in percent with two decimals, as in the paper; only 1 and 0 are shown as 100 and 0."""
    return _in_percent(fraction, 2)


def _in_percent(fraction: float, decimals: int) -> str:
    least = 10.0**-decimals
    if 1.0 - 0.005 * least <= fraction < 1.0:
        return f"> {100.0 - least:.{decimals}f}"
    if 0.0 < fraction < 0.005 * least:
        return f"< {least:.{decimals}f}"
    return f"{100.0 * fraction:.{decimals}f}"


def percent_range(interval: Sequence[float]) -> str:
    """A confidence interval of a fraction in percent."""
    low, high = interval
    return f"{100.0 * low:.1f}–{100.0 * high:.1f} %"


def number(value: float) -> str:
    """A number with three significant digits."""
    if value != 0.0 and not 1e-3 <= abs(value) < 1e5:
        return f"{value:.2e}"
    return f"{value:#.3g}".rstrip(".") if abs(value) < 999.5 else f"{value:.0f}"


@contextmanager
def progress_bar(console: Console) -> Iterator[ReportProgress]:
    """Show a bar, and yield the function that progress is reported to.

    Args:
        console: to draw on; nothing is drawn unless it is a terminal, even if colours are forced on a pipe.
    """
    bar = Bar(
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=None),
        TextColumn("{task.fields[state]}", markup=False),
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not (console.is_interactive and console.file.isatty()),
    )
    with bar:
        task = bar.add_task("", total=None, state="", visible=False)

        def report(progress: Progress) -> None:
            if progress.task != bar.tasks[0].description:
                bar.reset(task, total=progress.total, description=progress.task, visible=True)
            bar.update(task, completed=progress.done, total=progress.total, state=_state(progress))

        yield report


def _state(progress: Progress) -> str:
    parts = []
    if progress.total is not None:
        parts.append(f"{progress.done:.0f} of {progress.total:.0f} {progress.unit}".rstrip())
    if progress.note:
        parts.append(progress.note)
    return " · ".join(parts)
