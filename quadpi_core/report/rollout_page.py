# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page and the table of `quadpi rollout`: how far ahead a model can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from quadpi_core.evaluation.rollouts import RolledFlight, RolloutEvaluation
from quadpi_core.frames import Array
from quadpi_core.models.tubes import error_norms, tube_radii
from quadpi_core.report.coverage_verdict import listing
from quadpi_core.report.figure import Band, Figure, Line, Panel, Scale
from quadpi_core.report.page import FlightFiles, Page, flight_remarks
from quadpi_core.report.style import GROUPS, MEASURED, nominal, number, percent
from quadpi_core.report.table import Column, Row, Table
from quadpi_core.rotations import rotate_body_to_world

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
        Column("flight", is_text=True, is_section=True, chooses_flight=True),
        Column("horizon", is_text=True, once=True),
        Column("", is_text=True),
        Column("RMS error", number),
        Column("coverage", percent, group=f"{level} tube"),
        Column("width", number, group=f"{level} tube"),
        Column("coverage", percent, group="split conformal", is_soft=True),
        Column("width", number, group="split conformal", is_soft=True),
    ]
    rows: list[Row] = [
        [
            flight,
            f"{horizon} s",
            _QUANTITIES[quantity][0],
            own.rms,
            own.coverage,
            own.width,
            own.conformal_tracked_coverage,
            own.conformal_tracked_width,
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
