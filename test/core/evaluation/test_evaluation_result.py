# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of an evaluation: their keys in JSON, and what a coverage says."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.config_schema import check_config
from quadpi_core.evaluation.alarm_assessment import Constant, differences, flight_constants
from quadpi_core.evaluation.evaluation_result import (
    ComparedEvaluation,
    Comparison,
    Evaluation,
)
from quadpi_core.frames import Array
from quadpi_core.vehicle import Vehicle

from ..monitor.sound_flights_of_blocks import limits_of, sound_blocks, weight
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


VEHICLE = Vehicle.load("crazyflie_rpm")
LIMITS = limits_of(VEHICLE)


def constants_of(seed: int, push: float) -> dict[str, Constant]:
    """Of a flight with a constant force to the right, N."""
    blocks = sound_blocks(VEHICLE, 20.0, np.random.default_rng(seed))
    errors: Array = np.repeat(blocks["residual"], 10, axis=0)
    errors[:, 1] += push
    return flight_constants(LIMITS, 10_000_000 * np.arange(len(errors)), errors)


def test_constants_are_found_within_their_deviations() -> None:
    push, own = 0.03 * weight(VEHICLE), LIMITS.axes["Fy"]
    found = [constants_of(seed, push)["Fy"] for seed in range(40)]
    unsure = [np.sqrt(one.deviation**2 + own.between) for one in found]
    assert 0.5 < np.std([(one.value - push) / of for one, of in zip(found, unsure, strict=True)]) < 1.6


def test_flights_that_differ_are_named() -> None:
    push = 0.1 * weight(VEHICLE)
    flights = {f"flight{seed}": constants_of(seed, push if seed in {2, 5} else 0.0) for seed in range(7)}
    (told,) = differences(flights)
    assert told.startswith("flight2, flight5: ")
    assert told.endswith("mN more force to the right than the others")
    assert 1e-3 * float(told.split()[2]) == pytest.approx(push, rel=0.2)
    assert not list(differences({name: flights[name] for name in ("flight0", "flight2")}))


@pytest.mark.parametrize(
    ("push", "deviation", "said"),
    [(0.1234, 0.01, "123 ± 5 mN"), (1.234, 0.1, "1230 ± 50 mN"), (0.0123, 0.0, "12.3 ± 0.001 mN")],
)
def test_sizes_are_told_to_the_first_digit_that_is_not_sure(push: float, deviation: float, said: str) -> None:
    deviations = {"a": deviation, "b": deviation, "c": 0.0, "d": 0.0}
    flights = {name: {"Fy": Constant(push if name == "c" else 0.0, one)} for name, one in deviations.items()}
    (told,) = differences(flights)
    assert told == f"c: {said} more force to the right than the others"


def test_a_group_that_swings_is_told_by_its_mean_and_flights_that_scatter_are_not() -> None:
    """As of a slung load: forces of flights whose constants are known to 3 mN, four of them apart."""
    rng = np.random.default_rng(7)

    def told(values: Array) -> list[str]:
        return list(differences({f"f{k:02}": {"Fy": Constant(one, 0.003)} for k, one in enumerate(values)}))

    alike = 0.0045 * rng.standard_normal((200, 19))
    assert np.mean([bool(told(values)) for values in alike]) <= 0.05
    apart = np.concatenate((np.linspace(-0.009, 0.004, 15), [0.0168, 0.0173, 0.0178, 0.0181]))
    assert told(apart) == ["f15, f16, f17, f18: 20 ± 2 mN more force to the right than the others"]
    assert not told(np.linspace(-0.009, 0.018, 19))


@pytest.mark.parametrize(
    ("gap", "deviation", "flights", "is_told"),
    [(4.2, 1.0, 8, True), (2.6, 1.0, 8, False), (4.2, 2.0, 8, False), (20.0, 4.0, 4, False)],
)
def test_two_flights_apart_are_told_by_a_wide_gap_and_a_sure_mean(
    gap: float, deviation: float, flights: int, is_told: bool
) -> None:
    others = np.linspace(-1.0, 1.0, flights - 2)
    values = np.concatenate((others, [1.0 + gap, 2.0 + gap]))
    constants = {f"f{k}": {"Fy": Constant(float(one), deviation)} for k, one in enumerate(values)}
    assert bool(list(differences(constants))) == is_told


def test_flights_alike_and_short_ones_tell_nothing() -> None:
    assert not list(differences({f"flight{seed}": constants_of(seed, 0.0) for seed in range(7)}))
    assert flight_constants(LIMITS, 10_000_000 * np.arange(5), np.zeros((5, 6))) == {}
