# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of an evaluation: their keys in JSON, and what a coverage says."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from quadpi_core.config_schema import check_config
from quadpi_core.evaluation.evaluation_result import (
    ComparedEvaluation,
    Comparison,
    Evaluation,
)

from .normal_flights import evaluate, flight_result

METRICS = {
    *("picp", "picp_ci", "mpiw", "nmpiw", "rmse", "r2", "winkler", "cwc", "crps", "calibration", "regimes"),
    *("n", "n_eff"),
}


EVALUATION = {
    *("quadpi_version", "model", "vehicle", "method", "adaptive", "confidence", "training_range"),
    "force_bandwidth_hz",
    *("nmpiw_denominator", "cwc", "calibration_levels", "regime_edges", "groups", "flights"),
    *("data_quality", "left_out", "support"),
}


def test_json_has_the_documented_keys_and_no_nan():
    flights = [flight_result("a"), flight_result("b", seed=1)]
    evaluation = evaluate(flights, {"all": ["a", "b"], "one": ["b"]})
    loaded = json.loads(json.dumps(evaluation.to_json(), allow_nan=False))
    assert check_config(Evaluation, loaded) == evaluation
    assert set(loaded) == EVALUATION
    assert isinstance(loaded[loaded["nmpiw_denominator"]], dict)
    assert loaded["groups"]["all"]["flights"] == ["a", "b"]
    for part in (*loaded["groups"].values(), *loaded["flights"].values()):
        assert list(part["axes"]) == ["Fx", "Fz"]
        for values in part["axes"].values():
            assert set(values) == METRICS
            low, high = values["picp_ci"]
            assert 0 <= low <= values["picp"] <= high <= 1


def test_a_comparison_comes_back_from_json_with_what_each_model_adds() -> None:
    evaluation = evaluate([flight_result("a")], {"all": ["a"]})
    compared = ComparedEvaluation(**vars(evaluation), settings="paper", cutoff_hz=100.0)
    comparison = Comparison("0", "v", 0.95, False, {"all": ["a"]}, {"m": compared})
    loaded = json.loads(json.dumps(comparison.to_json(), allow_nan=False))
    assert set(loaded["models"]["m"]) == EVALUATION | {"settings", "cutoff_hz"}
    assert check_config(Comparison, loaded) == comparison


@pytest.mark.parametrize(
    ("interval", "too_little"), [((0.90, 0.94), True), ((0.90, 0.96), False), ((0.96, 0.99), False)]
)
def test_a_coverage_is_too_low_where_its_whole_interval_is(interval, too_little) -> None:
    axis = evaluate([flight_result("a")], {}).flights["a"].axes["Fx"]
    assert replace(axis, picp_ci=interval).covers_too_little(0.95) is too_little


def test_levels_and_penalty_are_those_that_the_json_states() -> None:
    """The penalty of the coverage width criterion is that of Khosravi et al., who proposed it."""
    evaluation = evaluate([flight_result("a")], {})
    assert list(evaluation.calibration_levels) == [0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99]
    assert (evaluation.cwc.mu, evaluation.cwc.eta) == (0.95, 50.0)
