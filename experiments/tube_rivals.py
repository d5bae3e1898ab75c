# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the table of regions in results/rollouts.md: tubes of roll-outs against regions of others.

Each half of the flights of a data set identifies a model, which predicts the other half ahead. Tubes know the
half that identified; rivals what the same model errs on flights of other turns of the half that is predicted,
which is more than a user has.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from interval_rivals import Race
from model_methods import (
    CONFIDENCE,
    DATA_SETS,
    DataSet,
    flights_by_log,
    geometric,
    parser_of,
    spread_over_speeds,
)
from page_tables import renew, stamp
from region_rivals import (
    Regions,
    Sized,
    ball_width,
    ellipsoid,
    following,
    multi_dim_spci,
    region_result,
    split,
)
from rollout_tables import PAGE

from quadpi_core.evaluation.evaluate import START_EVERY, RolledFlight, evaluate_rollouts
from quadpi_core.frames import Array
from quadpi_core.identification.identify import identify
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.models.tubes import QUANTITIES, TRACKING_PER_S, tube_radii, tube_scores
from quadpi_core.report.table import Column, Row, Table, markdown_table

# Most flights of a set, fewest that leave rivals three to learn from, and turns of a half.
MOST_FLIGHTS, FEWEST, TURNS = 12, 8, 4
HORIZONS_S, WINDOW_S = (0.1, 0.5), 2.0
COVERED, WORST_COVERED = 0.93, 0.80
TUBES, FIRST = "tubes", "ball of split conformal"


class Ahead(NamedTuple):
    """What a model errs ahead in one quantity on flights that it does not know, and its tubes.

    Attributes:
        race: of the errors (T, F, 3) of a horizon, by start.
        tubes: that do not follow the flight.
    """

    race: Race
    tubes: Regions


def side_by_side(of_flights: Sequence[Array]) -> Array:
    """Rows (T, F, ...) of flights, NaN behind the end of each."""
    rows = np.full((max(map(len, of_flights)), len(of_flights), *of_flights[0].shape[1:]), np.nan)
    for k, of_flight in enumerate(of_flights):
        rows[: len(of_flight), k] = of_flight
    return rows


def ahead(flights: Sequence[RolledFlight], factor: float, horizon_s: float, quantity: str) -> Ahead:
    """One quantity at one horizon, whose tubes have a factor on their ellipsoids."""
    place, part = list(QUANTITIES).index(quantity), QUANTITIES[quantity]
    at = flights[0].horizons_s.index(horizon_s)
    rolled = [one.rolled for one in flights]
    errors = side_by_side([one.errors[:, at, part] for one in rolled])
    sizes = side_by_side([tube_scores(one.errors, one.covariance)[:, at, place] for one in rolled])
    units = side_by_side([np.log(tube_radii(one.covariance)[:, at, place]) for one in rolled])
    rate_hz = 1.0 / (START_EVERY * flights[0].flight.step)
    turn, delay = np.arange(len(flights)) % TURNS, math.ceil(horizon_s * rate_hz - 1e-9)
    race = Race(errors, np.ones_like(errors), np.zeros(sizes.shape), turn, rate_hz, delay)
    return Ahead(race, Regions(sizes, np.full_like(sizes, factor), units + ball_width(3)))


def ball(race: Race) -> Sized:
    """Balls of one size."""
    return Sized(np.linalg.norm(race.error, axis=-1), np.full(race.speed.shape, ball_width(3)))


def regions_of(own: Ahead) -> Mapping[str, Regions]:
    """Of every rule; each once as it is, and once with a radius that follows the misses, each at its gain."""
    still = {
        FIRST: split(own.race, ball),
        "conformal ellipsoid": split(own.race, ellipsoid()),
        "MultiDimSPCI": multi_dim_spci(own.race),
        TUBES: own.tubes,
    }
    follow = {f"{name}, follows": following(own.race, of) for name, of in still.items()}
    follow[f"{TUBES}, follows"] = following(own.race, own.tubes, TRACKING_PER_S, np.inf)
    return {name: of for pair in zip(still.items(), follow.items(), strict=True) for name, of in pair}


def predicted(data_set: DataSet, data: Path, work: Path) -> list[Ahead]:
    """All quantities and horizons of a data set, of both halves; none where it has too few flights."""
    by_log, vehicle, _ = flights_by_log(data_set, data, work / data_set.vehicle)
    paths = {id(flight): path for path, flight in by_log.items()}
    flights = spread_over_speeds(list(by_log.values()), MOST_FLIGHTS)
    found = []
    for half in (0, 1) if len(flights) >= FEWEST else ():
        options = IdentifyOptions(method="physical", confidence=CONFIDENCE)
        model = identify(flights[half::2], vehicle, load_pools("quadrotor"), options)
        others = [paths[id(flight)] for flight in flights[1 - half :: 2]]
        rolled, _ = evaluate_rollouts(model, others, vehicle, horizon_s=HORIZONS_S[-1])
        calibration = model.require_rollouts().calibration
        assert calibration is not None
        factors = calibration.factors(HORIZONS_S, CONFIDENCE)
        found += [
            ahead(rolled, float(factors[k, q]), horizon_s, quantity)
            for k, horizon_s in enumerate(HORIZONS_S)
            for q, quantity in enumerate(QUANTITIES)
        ]
    return found


def rows(found: Mapping[str, Sequence[Ahead]]) -> list[Row]:
    """A row a rule: width over that of the first, geometric mean, in which data sets count the same."""
    widths: dict[str, dict[str, list[float]]] = {}
    covers: dict[str, list[tuple[Array, Array]]] = {}
    for title, of_set in found.items():
        for own in of_set:
            window = round(WINDOW_S * own.race.rate_hz)
            results = {name: region_result(of, window) for name, of in regions_of(own).items()}
            for name, result in results.items():
                ratio = float(np.mean(result.width) / np.mean(results[FIRST].width))
                widths.setdefault(name, {}).setdefault(title, []).append(ratio)
                covers.setdefault(name, []).append((result.coverage, result.worst))
    table: list[Row] = []
    for name, by_set in widths.items():
        each = [geometric(np.array(by_set[title])) for title in found]
        coverage, worst = (np.concatenate(of) for of in zip(*covers[name], strict=True))
        held = [100.0 * float(np.mean(of >= at)) for of, at in ((coverage, COVERED), (worst, WORST_COVERED))]
        table.append([name, *each, geometric(np.array(each)), 100.0 * float(coverage.mean()), *held])
    return table


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the table."""
    options = parser_of(__doc__, PAGE, "rollouts").parse_args(arguments)
    found = {}
    for data_set in DATA_SETS:
        if options.only in data_set.title:
            own = predicted(data_set, options.data.resolve(), options.work.resolve())
            print(f"{data_set.title}: {len(own)} races", flush=True)
            if own:
                found[data_set.title] = own
    two, one = "{:.2f}".format, "{:.0f}".format
    columns = [
        Column("region", is_text=True),
        *(Column(f"width: {title}", two) for title in found),
        *(Column("all", two), Column("coverage %", "{:.1f}".format)),
        *(Column("flights ≥ 93 %", one), Column("worst 2 s ≥ 80 %", one)),
    ]
    renew(options.page, {"regions": f"{markdown_table(Table(columns, rows(found)))}\n\n*{stamp()}*"})


if __name__ == "__main__":
    main()
