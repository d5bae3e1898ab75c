# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The table of coverage: its cells, the confidence interval by flight and block, refusals, pandas, figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import quadpi_core as qp
from quadpi_core.evaluation.metrics import clopper_pearson, coverage_interval


@pytest.fixture(scope="module")
def both(training, unseen) -> qp.Flights:
    return unseen + training[:1]


def test_each_cell_is_of_its_samples(quick, both):
    table = qp.evaluate(quick, both, by="speed", bins=5, confidence=0.9)
    interval, predicted = quick.predict_interval(both, confidence=0.9), quick.predict(both)
    column = {"Fx": 0, "Fz": 2}
    assert sum(row.n for row in table.rows if row.axis == "Fx") == len(both.time)
    fastest = max(row.bin[1] for row in table.rows)
    assert fastest == pytest.approx(both.speed.max())
    for row in (*table.rows, *table.pooled):
        low, high = row.bin
        chosen = (both.speed >= low) & ((both.speed < high) | (high == fastest))
        if row.flight != "all":
            chosen &= both.labels == both.names.index(row.flight)
        k = column[row.axis]
        inside = (interval.lower <= both.wrench) & (both.wrench <= interval.upper)
        assert row.n == chosen.sum()
        assert row.coverage == inside[chosen, k].mean()
        assert row.width == pytest.approx((interval.upper - interval.lower)[chosen, k].mean())
        expected = coverage_interval(
            inside[chosen, k], (both.wrench - predicted)[chosen, k], both.labels[chosen]
        )
        if row.flight == "all":
            assert row.low <= expected[0] <= expected[1] <= row.high
        else:
            assert (row.low, row.high) == expected
    assert table.in_sample == ("train_1",)


def test_the_interval_of_all_flights_is_by_flight(quick, unseen, training):
    """Four flights, one beyond its intervals: variance between flights, Student's t of three degrees."""
    beyond = replace(training.prepared[3], wrench=training.prepared[3].wrench + 1e3, sha256="")
    flights = qp.Flights((*unseen.prepared, *training.prepared[:2], beyond), unseen.vehicle)
    table = qp.evaluate(quick, flights, by=None)
    assert table.rows[-1].coverage == 0.0
    for row in table.pooled:
        own = np.array([(one.coverage, one.n) for one in table.rows if one.axis == row.axis]).T
        between = 4 / 3 * np.sum((own[1] / row.n * (own[0] - row.coverage)) ** 2)
        half = 3.182446 * np.sqrt(between)
        assert row.low == pytest.approx(max(row.coverage - half, 0.0), abs=1e-6)
        assert row.high == pytest.approx(min(row.coverage + half, 1.0), abs=1e-6)
        assert row.high - row.low > 0.9
    assert "<th>95 % interval, by flight</th>" in table._repr_html_()
    one = qp.evaluate(quick, unseen, by=None)
    assert [(row.low, row.high) for row in one.pooled] == [(row.low, row.high) for row in one.rows]
    assert "<th>95 % interval, this flight</th>" in one._repr_html_()


def test_flights_that_agree_give_no_certainty(quick, training):
    flights = [replace(own, wrench=own.wrench + 1e3, sha256="") for own in training.prepared[:2]]
    for row in qp.evaluate(quick, qp.Flights(flights, training.vehicle), by=None).pooled:
        assert (row.coverage, row.low) == (0.0, 0.0)
        assert row.high > 0.0


def test_its_confidence_interval_is_not_that_of_independent_samples(quick, unseen):
    for row in qp.evaluate(quick, unseen, by=None).rows:
        low, high = clopper_pearson(row.coverage, row.n, 0.95)
        assert row.high - row.low > 2.0 * (high - low)


def test_a_long_table_of_pandas(quick, both):
    table = qp.evaluate(quick, both, by="speed", bins=5)
    frame = table.to_pandas()
    assert list(frame) == ["flight", "axis", "bin", "coverage", "low", "high", "width", "n"]
    assert len(frame) == len(table) == len(table.rows)
    assert isinstance(frame["bin"].dtype, pd.IntervalDtype)
    assert set(frame["flight"]) == {"interpolation", "train_1"}
    wide = frame.pivot_table(index="bin", columns="axis", values="coverage", observed=True)
    assert list(wide) == ["Fx", "Fz"]
    assert set(table.to_pandas(pooled=True)["flight"]) == {"all"}


@pytest.mark.parametrize(
    ("by", "unit"), [("rotor_speed", "rad/s"), ("height", "m"), ("time", "s"), ("w", "")]
)
def test_other_quantities(quick, unseen, by, unit):
    table = qp.evaluate(quick, unseen, by=by, bins=3)
    assert (table.unit, {len(table.rows), len(table.pooled)} <= {4, 6}) == (unit, True)


def test_edges_of_a_users_own(quick, unseen):
    table = qp.evaluate(quick, unseen, bins=[0.0, 2.0, 50.0])
    assert {row.bin for row in table.rows} == {(0.0, 2.0), (2.0, 50.0)}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"by": "colour"}, "by: no quantity 'colour'; there are speed, rotor_speed, height, time, u, v"),
        ({"by": ["speed"]}, "by: expected str, found list"),
        ({"bins": 0}, "bins: expected a whole number from 1 to 1000, found int 0"),
        ({"bins": [1.0]}, "bins: expected edges that rise"),
        ({"bins": [1.0, 2.0]}, "lie beyond the edges 1 to 2"),
        ({"confidence": 2.0}, "confidence 2.0 is not between 0 and 1"),
        ({"model": "my-model"}, r"model: expected WrenchModel, found str 'my-model'; load_model\(folder\)"),
        ({"flights": np.zeros((3, 19))}, "flights: expected Flights, found an array"),
    ],
)
def test_a_plausible_mistake_is_one_clear_line(quick, unseen, change, message):
    arguments = {"model": quick, "flights": unseen} | change
    with pytest.raises(qp.QuadpiError, match=message):
        qp.evaluate(**arguments)


def test_it_shows_itself(quick, both):
    table = qp.evaluate(quick, both)
    assert repr(table).startswith("<CoverageTable by speed: 2 flights, 1 of which it learned from, coverage ")
    assert "<th>speed</th><th>coverage</th>" in table._repr_html_()
    axes = table.plot()
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("speed [m/s]", "coverage")
    assert np.isclose(axes.get_lines()[-1].get_ydata()[0], 0.95)


def test_real_flights(shared_data):
    """Flights of the NeuroBEM data set: a polynomial of three, judged on the fourth."""
    flights = qp.load_flights(shared_data / "neurobem" / "*.mat", "neurobem")
    model = qp.WrenchModel("polynomial", axes=["Fz"], keep_flawed=True).fit(flights[:3])
    frame = qp.evaluate(model, flights[3:], bins=4).to_pandas()
    assert set(frame["axis"]) == {"Fz"}
    assert ((frame["low"] <= frame["coverage"]) & (frame["coverage"] <= frame["high"])).all()
