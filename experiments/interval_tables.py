# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the table of results/intervals.md: coverage on smoothed states and on those of the live path.

Flights and models are those of `alarm_tables`.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from alarm_tables import (
    ALIKE,
    CONFIDENCE,
    MANY,
    REAL_VEHICLE,
    VARIED,
    VEHICLE,
    Case,
    Job,
    model_of,
    real_cases,
)
from page_tables import RESULTS, ROOT, renew, stamp
from scipy.stats import t as student_t

from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.parallel import Workers
from quadpi_core.paths import data_directory
from quadpi_core.report.table import Column, Table, markdown_table

PAGE = RESULTS / "intervals.md"


def coverage(model: AerodynamicModel, flight: PreparedFlight) -> tuple[Array, Array]:
    """Shares (6,) of the samples of a flight inside their interval: on smoothed states, and on live ones."""
    live = flight.judged
    shares = []
    for inputs, derivatives, wrench in (
        (flight.inputs, flight.derivatives, flight.wrench),
        (live.inputs[live.known], live.derivatives[live.known], live.wrench[live.known]),
    ):
        said = model.evaluate(inputs, CONFIDENCE, derivatives)
        shares.append(np.mean((wrench >= said.lower) & (wrench <= said.upper), axis=0))
    return shares[0], shares[1]


def cell(shares: Array) -> str:
    """Mean of the flights' coverages (F,) and its 95 % confidence interval, flights taken as independent."""
    half = float(student_t.ppf(0.975, len(shares) - 1)) * float(np.std(shares, ddof=1)) / len(shares) ** 0.5
    return f"{100.0 * float(np.mean(shares)):.1f} ± {100.0 * half:.1f}"


def cases(job: Job) -> Iterator[tuple[str, list[Case]]]:
    """Models of random flights on others of their kind, and of real flights each on the one left out."""
    for kind in (ALIKE, VARIED):
        training = job.prepared(job.random_bags("identified", kind, 2, MANY), VEHICLE)
        unseen = job.prepared(job.random_bags("covered", kind, 3, job.flights), VEHICLE)
        yield f"`{kind}`, {MANY} → {job.flights}", [Case(kind, VEHICLE, training, unseen)]
    if real := real_cases(job):
        assert all(case.vehicle == REAL_VEHICLE for case in real)
        yield f"NeuroBEM, each by the {len(real) - 1} others", real


def live(job: Job) -> str:
    """Table of the coverage of unseen flights by axis, on smoothed and on live states."""
    rows = []
    for name, group in cases(job):
        shares = []
        for case in group:
            model = model_of(case.identified, case.vehicle)
            shares += [coverage(model, flight) for flight in case.judged]
        for k, states in enumerate(("smoothed", "live")):
            by_axis = np.array([one[k] for one in shares]).T
            rows.append([name, states, *map(cell, by_axis)])
            print(" | ".join(rows[-1]), flush=True)
    headings = (Column(heading, is_text=True) for heading in ("flights", "states"))
    return markdown_table(Table([*headings, *map(Column, AXES)], rows))


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder that holds neurobem/")
    parser.add_argument("--work", type=Path, default=ROOT / "out" / "intervals", help="for bags")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument("--flights", type=int, default=12, help="unseen ones of each kind")
    parser.add_argument("--flight-s", type=float, default=60.0, help="duration of a random flight")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args(arguments)
    job = Job(
        work=options.work.resolve(),
        data=options.data.resolve(),
        seeds=1,
        flights=options.flights,
        flight_s=options.flight_s,
        ensembles=False,
        workers=Workers(options.workers),
    )
    renew(options.page, {"live": f"{live(job)}\n\n*{stamp()}, polynomials*"})


if __name__ == "__main__":
    main()
