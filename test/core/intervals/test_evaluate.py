# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.intervals.evaluate import EvaluationError, FlightResult, evaluate_flights

METRICS = {"picp", "picp_ci", "mpiw", "nmpiw", "rmse", "r2", "winkler", "n", "n_eff"}
RANGES = {"Fx": 4.0, "Fz": 8.0}


def flight_result(name, samples=400, seed=0, half_width=2.0, axes=("Fx", "Fz")):
    rng = np.random.default_rng(seed)
    predicted = rng.standard_normal((samples, 6))
    return FlightResult(
        name=name,
        axes=axes,
        time=np.arange(samples) / 400,
        measured=predicted + rng.standard_normal((samples, 6)),
        predicted=predicted,
        lower=predicted - half_width,
        upper=predicted + half_width,
        inputs=rng.standard_normal((samples, len(INPUT_NAMES))),
    )


def evaluate(results, groups, ranges=RANGES):
    return evaluate_flights(results, groups, ranges, 0.95, model="m", vehicle="v")


def test_json_has_the_documented_keys_and_no_nan():
    flights = [flight_result("a"), flight_result("b", seed=1)]
    evaluation = evaluate(flights, {"all": ["a", "b"], "one": ["b"]})
    text = json.dumps(evaluation, allow_nan=False)
    loaded = json.loads(text)
    assert loaded == evaluation
    assert set(loaded) == {
        *("quadpi_version", "model", "vehicle", "confidence", "training_range", "groups", "flights")
    }
    assert loaded["groups"]["all"]["flights"] == ["a", "b"]
    for part in (*loaded["groups"].values(), *loaded["flights"].values()):
        assert list(part["axes"]) == ["Fx", "Fz"]
        for values in part["axes"].values():
            assert set(values) == METRICS
            low, high = values["picp_ci"]
            assert 0 <= low <= values["picp"] <= high <= 1


def test_a_group_pools_the_samples_of_its_flights():
    short, long = flight_result("a", 100), flight_result("b", 300, seed=1, half_width=1.0)
    evaluation = evaluate([short, long], {"all": ["a", "b"]})
    parts = [evaluation["flights"][name]["axes"]["Fz"] for name in ("a", "b")]
    pooled = evaluation["groups"]["all"]["axes"]["Fz"]
    assert pooled["n"] == 400
    assert pooled["picp"] == pytest.approx((100 * parts[0]["picp"] + 300 * parts[1]["picp"]) / 400)
    assert pooled["mpiw"] == pytest.approx((100 * 4 + 300 * 2) / 400)
    assert pooled["nmpiw"] == pytest.approx(pooled["mpiw"] / 8.0)


def test_a_flight_may_be_in_two_groups():
    evaluation = evaluate([flight_result("a")], {"x": ["a"], "y": ["a"]})
    assert evaluation["groups"]["x"]["axes"] == evaluation["groups"]["y"]["axes"]


def test_constant_measurement_has_null_r2():
    result = flight_result("a")
    evaluation = evaluate([replace(result, measured=np.zeros_like(result.measured))], {"x": ["a"]})
    assert evaluation["groups"]["x"]["axes"]["Fx"]["r2"] is None


def test_columns_of_axes_that_the_model_lacks_may_hold_anything():
    result = flight_result("a")
    result.predicted[:, 1] = np.nan
    assert list(evaluate([result], {"x": ["a"]})["flights"]["a"]["axes"]) == ["Fx", "Fz"]


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
    ],
)
def test_refuses_what_cannot_be_judged(results, groups, ranges, message):
    with pytest.raises(EvaluationError, match=message):
        evaluate(results, groups, ranges)
