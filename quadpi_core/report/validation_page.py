# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A validation under noise: two tables as in the paper, for the terminal, and a page with its figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich.console import Group
from rich.text import Text
from scipy.stats import t as student_t

from quadpi_core.evaluation.evaluate import RolledFlight, RolloutEvaluation
from quadpi_core.flight import AXES
from quadpi_core.frames import Array, rotate_body_to_world
from quadpi_core.models.tubes import error_norms, tube_radii
from quadpi_core.report.evaluation_figures import Coverage, count_verdicts, listing
from quadpi_core.report.page import Band, Figure, FlightFiles, Layer, Line, Page, Panel, Scale, flight_remarks
from quadpi_core.report.table import (
    GROUPS,
    INK,
    MEASURED,
    PREDICTED,
    Cell,
    Column,
    Mark,
    Row,
    Table,
    Value,
    hundredths,
    method_colours,
    nominal,
    number,
    number_columns,
    percent,
    terminal_table,
    text_columns,
    unit,
)
from quadpi_core.validation.validation_case import HIGHEST, LOWEST, Spread, ValidationCase
from quadpi_core.validation.validation_result import VARIATIONS, AxisValidation, Validation, Variation

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
        *(*text_columns("axis", once=True), *text_columns("method")),
        *number_columns(*_COVERAGE, shown=hundredths, group="PICP %"),
        *number_columns(*_WIDTH, shown=hundredths, group="NMPIW %"),
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
    columns = [*text_columns("flight", once=True), *text_columns("method")]
    columns += number_columns(*axes, shown=hundredths)
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


_DEGREES = float(np.degrees(1.0))
# Words for a quantity as results name them, and the factor from radians.
_QUANTITIES = {
    "position_m": ("position [m]", 1.0),
    "velocity_m_s": ("velocity [m/s]", 1.0),
    "attitude_deg": ("attitude [°]", _DEGREES),
    "rates_rad_s": ("rates [rad/s]", 1.0),
}
# Most fans drawn of a flight, evenly over it and none upon another.
_FANS = 40
# Above and below the flight, as a share of its range.
_ROOM = 0.25


def rollout_summary(evaluation: RolloutEvaluation) -> Table:
    """Errors and tubes by flight, horizon and quantity."""
    level = nominal(evaluation.confidence)
    columns = [
        *text_columns("flight", is_section=True, chooses_flight=True),
        *(*text_columns("horizon", once=True), *text_columns(""), *number_columns("RMS error")),
        Column("coverage", percent, group=f"{level} tube"),
        Column("width", number, group=f"{level} tube"),
        Column("coverage", percent, group="split conformal", is_soft=True),
        Column("width", number, group="split conformal", is_soft=True),
    ]
    rows: list[Row] = [
        [
            *(flight, f"{horizon} s", _QUANTITIES[quantity][0], own.rms, own.coverage, own.width),
            *(own.conformal_tracked_coverage, own.conformal_tracked_width),
        ]
        for flight, judged in evaluation.flights.items()
        for horizon, quantities in judged.horizons.items()
        for quantity, own in quantities.items()
    ]
    notes = [
        f"{name}: {judged.left_out} of {judged.left_out + judged.starts} starts left out, as a rotor was not "
        "measured, or samples are missing, within the horizon."
        for name, judged in evaluation.flights.items()
        if judged.left_out
    ]
    if known := _in_sample(evaluation):
        notes.append(f"The model was identified on {listing(known)}: in sample.")
    inferred = [name for name, judged in evaluation.flights.items() if not judged.position_measured]
    if inferred:
        notes.append(f"Position of {', '.join(inferred)} against integrated velocity: it was not measured.")
    return Table(columns, rows, note=" ".join(notes))


def _in_sample(evaluation: RolloutEvaluation) -> list[str]:
    return [name for name, judged in evaluation.flights.items() if judged.in_sample]


def rollout_verdict(evaluation: RolloutEvaluation) -> str:
    """What the tubes at the last horizon are worth, in a sentence."""
    last = f"{evaluation.horizon_s:g}"
    errors = [flight.horizons[last]["attitude_deg"].rms for flight in evaluation.flights.values()]
    shares = [
        own.coverage for flight in evaluation.flights.values() for own in flight.horizons[last].values()
    ]
    return (
        f"{last} s ahead the attitude errs by {_span(errors, number, '°')} (root mean square of a flight); "
        f"the tubes of {nominal(evaluation.confidence)} hold {_span(shares, percent)} of the roll-outs of "
        "each flight."
    )


def _span(values: Sequence[float], text: Callable[[float], str], unit: str = "") -> str:
    """Least and largest value, or the one that both are."""
    ends = dict.fromkeys(f"{text(end)}{unit}" for end in (min(values), max(values)))
    return " to ".join(ends)


def write_rollout_page(
    path: Path,
    flights: Sequence[RolledFlight],
    evaluation: RolloutEvaluation,
    files: FlightFiles | None = None,
) -> None:
    """Write the page; it appears whole or not at all.

    Args:
        path: of the HTML file.
        flights: that were predicted.
        evaluation: of them.
        files: of flights and model, to look at moments in `quadpi view`.

    Raises:
        OutputError: if `path` cannot be written.
    """
    Page(
        title=f"quadpi: roll-outs of {evaluation.model}",
        about="how far ahead can this model be trusted?",
        verdict=rollout_verdict(evaluation),
        facts={
            "model": evaluation.model,
            "vehicle": evaluation.vehicle,
            "flights": str(len(flights)),
            "horizon": f"{evaluation.horizon_s:g} s",
        },
        definitions={
            "Tube": "Ellipsoid of the errors' covariance, which the physics give, times a factor that was "
            "calibrated on flights left out and then follows the flight's own errors once they are known.",
            "Width": "Diameter of the ball that has the volume of the tube, mean over the roll-outs.",
            "Split conformal": "Balls of one size from the same errors on flights left out, which follow the "
            "flight likewise.",
        },
        figures={},
        flight_figures={
            flight.name: {"fan": fan_figure(flight), "growth": growth_figure(flight)} for flight in flights
        },
        files=files or FlightFiles(),
        remarks=flight_remarks(evaluation.data_quality, evaluation.left_out, _in_sample(evaluation)),
    ).write(
        path,
        "rollouts.html",
        nominal=nominal(evaluation.confidence),
        table_of_tubes=rollout_summary(evaluation),
        flights={"predicted": [flight.name for flight in flights]},
    )


def fan_figure(flight: RolledFlight) -> Figure:
    """Velocity along each axis and tilt as they were, and fans of predictions with their tubes."""
    own, time, (starts, errors, covariance, _) = flight.flight, flight.flight.time, flight.rolled
    steps = np.rint(np.array(flight.horizons_s) / (time[1] - time[0])).astype(int)
    chosen = _apart(starts, int(steps[-1]))
    places = starts[chosen, None] + steps
    x = np.append(time[places], time[places[:, -1:]] + 0.5 * (time[1] - time[0]), axis=1).ravel()
    velocity = rotate_body_to_world(own.attitude, own.motion["velocity"])
    degrees_s = _DEGREES * own.motion["rates"]
    panels = []
    # What was measured, row of the error, factor on it.
    for name, measured, row, scale in (
        ("velocity north [m/s]", velocity[:, 0], 3, 1.0),
        ("velocity east [m/s]", velocity[:, 1], 4, 1.0),
        ("velocity down [m/s]", velocity[:, 2], 5, 1.0),
        ("p [°/s]", degrees_s[:, 0], 9, _DEGREES),
        ("q [°/s]", degrees_s[:, 1], 10, _DEGREES),
    ):
        centre = measured[places] + scale * errors[chosen, :, row]
        half = scale * flight.factors[chosen, :, row // 3] * np.sqrt(covariance[chosen, :, row, row])
        layers = [
            Line("measured", MEASURED, time, measured),
            Band("tube", GROUPS[0], x, _with_gaps(centre - half), _with_gaps(centre + half)),
            Line("predicted", GROUPS[0], x, _with_gaps(centre)),
        ]
        # A fan that has lost its way would leave a flat line of the flight.
        room = _ROOM * float(np.ptp(measured)) or 1.0
        shown = Scale(name, float(measured.min()) - room, float(measured.max()) + room)
        panels.append(Panel(layers, Scale("time [s]"), shown, 150.0))
    return Figure("Fans of predictions", panels, over_time=True)


def _apart(starts: npt.NDArray[np.int64], length: int) -> list[int]:
    """Places of starts that are more than so many samples apart, evenly over the flight."""
    step = max(length + 1, (int(starts[-1]) - int(starts[0])) // _FANS)
    chosen = [0]
    for place, start in enumerate(starts.tolist()):
        if start - starts[chosen[-1]] >= step:
            chosen.append(place)
    return chosen


def _with_gaps(values: Array) -> Array:
    """Rows (K, H) one behind the other, with NaN behind each: no line joins fans."""
    return np.append(values, np.full((len(values), 1), np.nan), axis=1).ravel()


def growth_figure(flight: RolledFlight) -> Figure:
    """Errors and tube over the horizon: median, 95 % quantile, and mean radius of the tubes."""
    x = np.array(flight.horizons_s)
    norms, radii = error_norms(flight.rolled.errors), flight.factors * tube_radii(flight.rolled.covariance)
    panels = []
    for place, (name, scale) in enumerate(_QUANTITIES.values()):
        errors = scale * norms[:, :, place]
        layers = [
            Band("tube", GROUPS[0], x, 0 * x, scale * radii[:, :, place].mean(axis=0)),
            Line("median error", MEASURED, x, np.median(errors, axis=0)),
            Line("95 % of the errors", GROUPS[1], x, np.quantile(errors, 0.95, axis=0), dash="dashed"),
        ]
        panels.append(Panel(layers, Scale("horizon [s]"), Scale(name, low=0.0), 230.0))
    return Figure("Growth of the errors over the horizon", panels, len(panels))
