# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the table of vehicles in results/rollouts.md: real flights predicted ahead, the fastest left out.

Of each data set at most a few flights are taken, spread over its speeds. The physical model is identified on
all but the fastest, which is read again from its log and predicted as `quadpi rollout` does.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from model_methods import DATA_SETS, DataSet, flights_by_log, parser_of, speed, spread_over_speeds
from page_tables import RESULTS, renew, stamp

from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.evaluation.evaluate import FlightRolloutMetrics, TubeMetrics, evaluate_rollouts
from quadpi_core.identification.identify import identify
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.report.table import Column, Row, Table, markdown_table, number

PAGE = RESULTS / "rollouts.md"
# Of a data set, spread evenly over its speeds, as of results/models.md.
MOST_FLIGHTS = 6
# The fewest that leave two to identify on, and one to predict.
_FEWEST = 3
HORIZONS = ("0.1", "0.5")
_QUANTITIES = ("position_m", "velocity_m_s", "attitude_deg", "rates_rad_s")


def predicted(data_set: DataSet, data: Path, work: Path) -> tuple[list[Row], list[str]]:
    """Rows of the table for a data set, and what there is to say of it."""
    flights, vehicle, remarks = flights_by_log(data_set, data, work / data_set.vehicle)
    said = []
    if remarks:
        first = next(iter(remarks.values()))[0]
        unread = sorted(name for names in remarks.values() for name in names)
        said = [f"{data_set.title}: not read: {', '.join(unread)} ({first}: {next(iter(remarks))})."]
    if len(flights) < _FEWEST:
        return [], [*said, f"{data_set.title}: {len(flights)} flights, {_FEWEST} are needed."]
    paths = {id(flight): path for path, flight in flights.items()}
    *identified, fastest = spread_over_speeds(list(flights.values()), MOST_FLIGHTS)
    try:
        model = identify(identified, vehicle, load_pools("quadrotor"), IdentifyOptions(method="physical"))
        _, evaluation = evaluate_rollouts(model, [paths[id(fastest)]], vehicle)
    except QuadpiError as error:
        return [], [*said, f"{data_set.title}: not predicted: {one_line(error).replace(f'{data}/', '')}."]
    (judged,) = evaluation.flights.values()
    reached = f"{speed(fastest):.1f} m/s (others to {speed(identified[-1]):.1f})"
    if judged.left_out:
        said.append(
            f"{data_set.title}: {judged.left_out} of {judged.left_out + judged.starts} starts left out."
        )
    if not judged.position_measured:
        said.append(f"{data_set.title}: position against integrated velocity, as it was not measured.")
    return rows(f"{data_set.title}, {fastest.name}, {reached}", judged), said


def rows(what: str, judged: FlightRolloutMetrics) -> list[Row]:
    """Rows of a flight, one for each horizon."""

    def four(name: str, scale: float = 1.0) -> str:
        own: list[TubeMetrics] = [judged.horizons[horizon][quantity] for quantity in _QUANTITIES]
        if scale == 1.0:
            return ", ".join(number(getattr(metrics, name)) for metrics in own)
        return ", ".join(f"{scale * getattr(metrics, name):.1f}" for metrics in own)

    found: list[Row] = []
    for horizon in HORIZONS:
        errors, covered, width = four("rms"), four("coverage", 100.0), four("width")
        found.append([what, f"{horizon} s", errors, covered, width, four("conformal_tracked_width")])
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the page."""
    options = parser_of(__doc__, PAGE, "rollouts").parse_args(arguments)
    headings = ("flight", "ahead", "RMS error", "coverage %", "width", "width of balls")
    every, said = list[Row](), list[str]()
    for data_set in DATA_SETS:
        if options.only in data_set.title:
            own, remarks = predicted(data_set, options.data.resolve(), options.work.resolve())
            every += own
            said += remarks
            print(f"{data_set.title}: {len(own)} rows {' '.join(remarks)}", flush=True)
    table = Table([Column(heading, is_text=True) for heading in headings], every)
    remarks_text = "\n".join(f"- {sentence}" for sentence in said)
    renew(options.page, {"vehicles": f"{markdown_table(table)}\n\n{remarks_text}\n\n*{stamp()}*"})


if __name__ == "__main__":
    main()
