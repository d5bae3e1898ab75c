# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich import box
from rich.columns import Columns
from rich.console import Group
from rich.table import Table
from rich.text import Text

from quadpi_core.evaluation.alarm_assessment import AlarmAssessment
from quadpi_core.evaluation.evaluation_result import AxisMetrics, Evaluation
from quadpi_core.report.style import determination, number, percent, percent_range, unit

if TYPE_CHECKING:
    from quadpi_core.models.aerodynamic import AerodynamicModel


def axis_with_unit(axis: str) -> Text:
    """Name of an axis of the wrench, its unit dim."""
    return Text.assemble(axis, (f" {unit(axis)}", "dim"))


def evaluation_table(evaluation: Evaluation) -> Group:
    """Coverage and width per axis, a table per group; coverage below the nominal level is marked.

    The columns fit a terminal of 80 characters; the JSON and the page hold every metric.

    Args:
        evaluation: as :func:`quadpi_core.evaluation.flight_results.evaluate_flights` gives it.
    """
    confidence = evaluation.confidence
    parts = evaluation.groups
    tables: list[Table | Text] = []
    for name, part in parts.items():
        tables.append(_group_table(name, part.axes, confidence))
        if part.alarm is not None:
            tables.append(Text(f"alarm: {alarm_sentence(part.alarm)}", style="dim"))
    intervals = "adaptive prediction intervals" if evaluation.adaptive else "prediction intervals"
    heading = Text(f"{evaluation.model}: {percent(confidence)} {intervals}", style="bold")
    if any(metrics.covers_too_little(confidence) for p in parts.values() for metrics in p.axes.values()):
        note = f"▼ the confidence interval of the coverage lies below {percent(confidence)}"
        return Group(heading, *tables, Text(note, style="dim"))
    return Group(heading, *tables)


def _group_table(name: str, axes: Mapping[str, AxisMetrics], confidence: float) -> Table:
    table = Table(
        title=Text(name), title_justify="left", box=box.SIMPLE_HEAD, collapse_padding=True, pad_edge=False
    )
    table.add_column("axis", no_wrap=True)
    for heading in ("PICP", "95 % CI", "MPIW", "NMPIW", "RMSE", "R²", "n_eff"):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis, metrics in axes.items():
        short = metrics.covers_too_little(confidence)
        coverage = ("▼ " if short else "") + percent(metrics.picp)
        table.add_row(
            axis_with_unit(axis),
            Text(coverage, style="bold red" if short else ""),
            percent_range(metrics.picp_ci),
            number(metrics.mpiw),
            percent(metrics.nmpiw),
            number(metrics.rmse),
            determination(metrics.r2),
            number(metrics.n_eff),
        )
    return table


def alarm_sentence(alarm: AlarmAssessment) -> str:
    """False alarms, detection and what each signal tells, as `evaluate_flights` found them for one group."""
    parts = []
    if alarm.hours_inside > 0.0:
        rate = alarm.false_alarms_per_hour
        stated = "–, too short to state a rate" if rate is None else f"{number(rate)} per hour"
        minutes = _minutes(alarm.hours_inside)
        parts.append(f"{alarm.false_alarms} false in {minutes} inside the envelope ({stated})")
    if alarm.hours_outside > 0.0:
        plural = "" if alarm.alarms_outside == 1 else "s"
        minutes = _minutes(alarm.hours_outside)
        parts.append(f"{alarm.alarms_outside} alarm{plural} in {minutes} outside the envelope")
    if alarm.flights_off:
        found = alarm.flights_off - alarm.flights_undetected
        late = "" if alarm.detection_delay_s is None else f", {alarm.detection_delay_s:.2f} s late"
        parts.append(f"{found} of {alarm.flights_off} flights with the model off detected{late}")
    known = [f"{name} {area:.2f}" for name, area in alarm.auroc.items() if area is not None]
    if known:
        parts.append(f"area under the ROC curve for misses: {', '.join(known)}")
    return "; ".join(parts)


def _minutes(hours: float) -> str:
    return f"{number(60.0 * hours)} min"


def held_out_table(model: AerodynamicModel) -> Table | None:
    """Coverage of each training flight by the model of the others; None where none was left out."""
    if not all(model.held_out_coverage[axis] for axis in model.axes):
        return None
    table = Table(
        title="left out in turn: coverage", title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    table.add_column("flight", no_wrap=True)
    for axis in model.axes:
        table.add_column(axis, justify="right", no_wrap=True)
    for k, flight in enumerate(model.flights):
        table.add_row(Text(flight.name), *(percent(model.held_out_coverage[axis][k]) for axis in model.axes))
    return table


def selection_table(log: Sequence[Mapping[str, Any]], title: str = "") -> Table:
    """The steps of stepwise selection: term, coefficient, R² reached with it, criterion.

    Args:
        log: rows as :meth:`quadpi_core.models.polynomial.StepwisePolynomial.selection_log` gives them.
        title: for example the axis.
    """
    table = Table(title=title or None, box=box.SIMPLE_HEAD)
    table.add_column("term")
    for heading in ("coefficient", "R²", "criterion"):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in log:
        table.add_row(*(Text(cell) for cell in selection_cells(row)), style="dim" if row["fixed"] else "")
    return table


def selection_cells(row: Mapping[str, Any]) -> tuple[str, str, str, str]:
    """One row of a selection log as text; a term that the final model does not hold has no coefficient."""
    coefficient, r2, score = row["coefficient"], row["r2"], row.get("criterion")
    return (
        row["term"] + (f" (removed {', '.join(row['removed'])})" if row.get("removed") else ""),
        "–" if coefficient is None else f"{coefficient:.4e}",
        "" if r2 is None else f"{r2:.4f}",
        "" if score is None else number(score),
    )


@dataclass(frozen=True)
class Term:
    """A term of an identified polynomial.

    Attributes:
        name: of the regressor.
        coefficient: in SI units.
        r2: of the fit up to this term; None for fixed terms but the last, for they enter together.
        fixed: whether it was given, not chosen.
    """

    name: str
    coefficient: float
    r2: float | None
    fixed: bool

    def cells(self) -> tuple[str, str, str]:
        """Term, coefficient and R² as text."""
        return self.name, f"{self.coefficient:.3e}", "–" if self.r2 is None else f"{self.r2:.4f}"


def final_terms(log: Sequence[Mapping[str, Any]]) -> list[Term]:
    """Terms that the final model holds, in the order in which selection added them for good.

    Args:
        log: as for :func:`selection_table`.
    """
    last = {row["term"]: place for place, row in enumerate(log)}
    return [
        Term(row["term"], row["coefficient"], row["r2"], row["fixed"])
        for place, row in enumerate(log)
        if row["coefficient"] is not None and place == last[row["term"]]
    ]


def structure_tables(model: AerodynamicModel) -> Columns | None:
    """Terms, coefficients and R² of each axis in the form of the paper, side by side where there is room.

    None for a model that was not selected term by term.
    """
    tables = []
    for axis in model.axes:
        if not model.selection[axis]:
            return None
        table = Table(title=axis, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        table.add_column("term", no_wrap=True)
        for heading in ("coefficient", "R²"):
            table.add_column(heading, justify="right", no_wrap=True)
        for term in final_terms(model.selection[axis]):
            table.add_row(*(Text(cell) for cell in term.cells()), style="dim" if term.fixed else "")
        tables.append(table)
    return Columns(tables, padding=(0, 3))
