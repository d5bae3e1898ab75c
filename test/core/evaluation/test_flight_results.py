# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Metrics of flights and groups, by axis and regime, and results that cannot be judged."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from quadpi_core.errors import ModelError
from quadpi_core.evaluation.evaluation_result import EvaluationError

from .normal_flights import RANGES, evaluate, flight_result


def test_a_group_pools_the_samples_of_its_flights():
    short, long = flight_result("a", 100), flight_result("b", 300, seed=1, half_width=1.0)
    evaluation = evaluate([short, long], {"all": ["a", "b"]})
    parts = [evaluation.flights[name].axes["Fz"] for name in ("a", "b")]
    pooled = evaluation.groups["all"].axes["Fz"]
    assert pooled.n == 400
    assert pooled.picp == pytest.approx((100 * parts[0].picp + 300 * parts[1].picp) / 400)
    assert pooled.mpiw == pytest.approx((100 * 4 + 300 * 2) / 400)
    assert pooled.nmpiw == pytest.approx(pooled.mpiw / 8.0)


def test_a_flight_may_be_in_two_groups():
    evaluation = evaluate([flight_result("a")], {"x": ["a"], "y": ["a"]})
    assert evaluation.groups["x"].axes == evaluation.groups["y"].axes


def test_calibration_curve_pools_the_flights_at_each_level():
    flights = [flight_result("a", 100), flight_result("b", 300, seed=1)]

    def at(level):
        half = stats.norm.ppf(0.5 + level / 2)
        return (replace(f, lower=f.predicted - half, upper=f.predicted + half) for f in flights)

    evaluation = evaluate(flights, {"all": ["a", "b"]}, at_confidence=at)
    parts = [evaluation.flights[name].axes["Fx"].calibration for name in ("a", "b")]
    curve = evaluation.groups["all"].axes["Fx"].calibration
    np.testing.assert_allclose(curve, (np.array(parts[0]) + 3 * np.array(parts[1])) / 4)
    np.testing.assert_allclose(curve, evaluation.calibration_levels, atol=0.08)
    assert evaluate(flights, {}).flights["a"].axes["Fx"].calibration == [None] * len(curve)


def test_level_that_the_model_does_not_support_is_null():
    flight = flight_result("a")

    def at(level):
        if level != 0.95:
            raise ModelError("trained for 0.95")
        return [flight]

    evaluation = evaluate([flight], {}, at_confidence=at).flights["a"].axes["Fx"]
    known = [value for value in evaluation.calibration if value is not None]
    assert known == [evaluation.picp]


def test_crps_only_where_the_interval_is_that_of_a_density():
    flight = flight_result("a")
    for method, defined in (("polynomial", True), ("bootstrap", True), ("quality-driven", False)):
        crps = evaluate([flight], {}, method=method).flights["a"].axes["Fx"].crps
        assert (crps is not None) == defined


def test_regimes_share_their_bins_and_add_up():
    low, high = flight_result("low"), flight_result("high", seed=1)
    high = replace(high, height=high.height + 4.0, lower=high.predicted - 0.1, upper=high.predicted + 0.1)
    evaluation = evaluate([low, high], {"all": ["low", "high"]})
    edges = np.array(evaluation.regime_edges["height_m"])
    assert edges.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    axes = {name: part.axes["Fz"] for name, part in evaluation.flights.items()}
    axes["all"] = evaluation.groups["all"].axes["Fz"]
    for name, values in axes.items():
        for quantity, bins in values.regimes.items():
            assert len(bins.n) == len(evaluation.regime_edges[quantity]) - 1
            assert sum(bins.n) == values.n
            inside = sum(n * (share or 0.0) for n, share in zip(bins.n, bins.picp, strict=True))
            assert inside == pytest.approx(values.n * values.picp), name
    assert axes["low"].regimes["height_m"].picp[4:] == [None] * 3
    assert axes["high"].regimes["height_m"].n[:4] == [0] * 4
    assert axes["all"].regimes["height_m"].mpiw[0] == pytest.approx(4.0)
    assert axes["all"].regimes["height_m"].mpiw[-1] == pytest.approx(0.2)


def test_constant_measurement_has_null_r2():
    result = flight_result("a")
    evaluation = evaluate([replace(result, measured=np.zeros_like(result.measured))], {"x": ["a"]})
    assert evaluation.groups["x"].axes["Fx"].r2 is None


def test_columns_of_axes_that_the_model_lacks_may_hold_anything():
    result = flight_result("a")
    result.predicted[:, 1] = np.nan
    assert list(evaluate([result], {"x": ["a"]}).flights["a"].axes) == ["Fx", "Fz"]


def with_value(quantity, value):
    result = flight_result("a")
    getattr(result, quantity)[7, 2] = value
    return result


@pytest.mark.parametrize(
    ("results", "groups", "ranges", "message"),
    [
        ([flight_result("a"), flight_result("a")], {}, RANGES, "flight a: present twice"),
        ([flight_result("a")], {"x": ["a", "a"]}, RANGES, "group x: a flight is present twice"),
        ([flight_result("a")], {"x": ["b"]}, RANGES, "group x: no flight b; evaluated: a"),
        ([flight_result("a")], {"x": []}, RANGES, "group x: holds no flights"),
        ([flight_result("a")], {"x": ["a"]}, {"Fx": 4.0, "Fz": 0.0}, "Fz: .* spans 0.0"),
        ([flight_result("a", samples=0)], {}, RANGES, "flight a: holds no samples"),
        ([with_value("measured", np.nan)], {}, RANGES, "flight a: Fz: sample 7: measured not finite"),
        ([with_value("upper", np.inf)], {}, RANGES, "flight a: Fz: sample 7: upper not finite"),
        ([with_value("lower", 99.0)], {}, RANGES, "flight a: Fz: sample 7: lower bound above upper"),
        ([replace(flight_result("a"), inputs=np.zeros((400, 3)))], {}, RANGES, "inputs of shape"),
        (
            [replace(flight_result("a"), height=np.full(400, np.nan))],
            {},
            RANGES,
            "flight a: height_m not finite",
        ),
    ],
)
def test_refuses_what_cannot_be_judged(results, groups, ranges, message):
    with pytest.raises(EvaluationError, match=message):
        evaluate(results, groups, ranges)
