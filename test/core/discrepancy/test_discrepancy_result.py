# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results of a study as JSON."""

from __future__ import annotations

import json

import pytest

from quadpi_core.discrepancy.discrepancy_result import (
    BeforeAfter,
    ClosedLoops,
    Coverage,
    FlightCondition,
    OfFlight,
    Reflights,
    Rollouts,
    discovery_json,
    reflights_json,
    study_json,
)
from quadpi_core.flight import AXES

ROLLOUT = Rollouts(0.5, 12, {"velocity_m_s": BeforeAfter(0.4, 0.1, 0.05)})


@pytest.fixture(scope="module")
def loaded(found):
    return json.loads(json.dumps(study_json(found), allow_nan=False))


def test_a_study_says_what_was_compared_and_what_was_found(loaded, found):
    assert loaded["simulation"] == loaded["vehicle"] == "bebop2"
    assert loaded["seed"] == 0
    assert list(loaded["flights"]) == [flight.name for flight in found.flights]
    for flight in found.flights:
        seconds = flight.time[-1] - flight.time[0]
        assert loaded["flights"][flight.name]["duration_s"] == pytest.approx(seconds)
    assert loaded["verdict"] == "effects"
    assert {key: loaded[key] for key in discovery_json(found.discovery)} == json.loads(
        json.dumps(discovery_json(found.discovery))
    )
    assert loaded["not_flown"] == list(found.not_flown)
    assert [part["axis"] for part in loaded["where"]] == [part.axis for part in found.where.ranges]
    assert all(part["text"] for part in loaded["where"])


def test_an_effect_has_its_parameters_with_their_intervals(loaded):
    (effect,) = loaded["effects"]
    assert effect["name"] == "body_drag"
    assert list(effect["parameters"]) == ["x_n_s2_m2", "y_n_s2_m2", "z_n_s2_m2"]
    for parameter in effect["parameters"].values():
        assert parameter["lower"] < parameter["value"] < parameter["upper"]
        assert parameter["unit"] == "N s²/m²"
    assert loaded["ambiguous"] == []


def test_the_gap_has_every_axis_and_its_reduction(loaded, found):
    gap = found.discovery.gap
    assert list(loaded["gap"]) == [*AXES, "reduction"]
    for axis, before, after, floor in zip(AXES, gap.before, gap.after, gap.floor, strict=True):
        assert loaded["gap"][axis] == {"before": before, "after": after, "floor": floor}
    assert loaded["gap"]["reduction"] == gap.reduction


def test_what_was_flown_again_is_stated_where_something_was():
    loop = ClosedLoops(2, lost=("one: hits the ground",), errors={"position_m": BeforeAfter(0.3, 0.1, 0.0)})
    whole = reflights_json(Reflights(ROLLOUT, loop, {"Fx": Coverage(0.5, 0.9)}))
    assert whole["rollout"] == {
        "horizon_s": 0.5,
        "starts": 12,
        "velocity_m_s": {"before": 0.4, "after": 0.1, "floor": 0.05},
    }
    assert whole["closed_loop"] == {
        "flights": 2,
        "lost": ["one: hits the ground"],
        "position_m": {"before": 0.3, "after": 0.1, "floor": 0.0},
    }
    assert whole["coverage"] == {"Fx": {"before": 0.5, "after": 0.9}}


def test_why_nothing_was_flown_again():
    none = reflights_json(Reflights(ROLLOUT, ClosedLoops(0, missing="no reference"), {}))
    assert none["closed_loop"] == {"flights": 0, "missing": "no reference"}
    assert "coverage" not in none
    reduced = ClosedLoops(1, errors={}, reduction=0.8)
    assert reflights_json(Reflights(ROLLOUT, reduced, {}))["closed_loop"]["reduction"] == 0.8


def test_a_condition_names_the_flights_that_differ_most():
    flights = {"a": OfFlight(-0.012, 0.001), "b": OfFlight(0.022, 0.0005), "c": OfFlight(0.001, 0.0005)}
    condition = FlightCondition("force_bias", "y_n", "N", "a steady pull", flights)
    assert condition.sentence == (
        "flights differ in y_n of force_bias: b +0.022 ± 0.001, a -0.012 ± 0.002 N (a steady pull?)"
    )
