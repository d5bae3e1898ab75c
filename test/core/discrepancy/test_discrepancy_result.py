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


def test_a_study_says_what_was_compared_and_what_was_found(found):
    loaded = json.loads(json.dumps(study_json(found), allow_nan=False))
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
    (effect,) = loaded["effects"]
    assert effect["name"] == "body_drag"
    assert list(effect["parameters"]) == ["x_n_s2_m2", "y_n_s2_m2", "z_n_s2_m2"]
    for parameter in effect["parameters"].values():
        assert parameter["lower"] < parameter["value"] < parameter["upper"]
        assert parameter["unit"] == "N s²/m²"
    assert loaded["ambiguous"] == []
    gap = found.discovery.gap
    assert list(loaded["gap"]) == [*AXES, "reduction"]
    for axis, before, after, floor in zip(AXES, gap.before, gap.after, gap.floor, strict=True):
        assert loaded["gap"][axis] == {"before": before, "after": after, "floor": floor}
    assert loaded["gap"]["reduction"] == gap.reduction


def test_what_was_flown_again_is_stated_where_something_was():
    errors = {"position_m": BeforeAfter(0.5, 0.3, 0.3), "rates_rad_s": BeforeAfter(0.2, 0.2, 0.1)}
    loop = ClosedLoops(2, lost=("one: hits the ground",), errors=errors)
    whole = reflights_json(Reflights(ROLLOUT, loop, {"Fx": Coverage(0.5, 0.9)}))
    assert whole == {
        "rollout": {
            "horizon_s": 0.5,
            "starts": 12,
            "velocity_m_s": {"before": 0.4, "after": 0.1, "floor": 0.05},
        },
        "closed_loop": {
            "flights": 2,
            "lost": ["one: hits the ground"],
            "position_m": {"before": 0.5, "after": 0.3, "floor": 0.3},
            "rates_rad_s": {"before": 0.2, "after": 0.2, "floor": 0.1},
            # All of what could be removed of the one, and nothing of the other.
            "reduction": 0.5,
        },
        "coverage": {"Fx": {"before": 0.5, "after": 0.9}},
    }
    none = reflights_json(Reflights(ROLLOUT, ClosedLoops(0, missing="no reference"), {}))
    assert none["closed_loop"] == {"flights": 0, "missing": "no reference"}
    assert "coverage" not in none


def test_a_condition_names_the_flights_that_differ_most():
    flights = {"a": OfFlight(-0.012, 0.001), "b": OfFlight(0.022, 0.0005), "c": OfFlight(0.001, 0.0005)}
    condition = FlightCondition("force_bias", "y_n", "N", "a steady pull", flights)
    assert condition.sentence == (
        "flights differ in y_n of force_bias: b +0.022 ± 0.001, a -0.012 ± 0.002 N (a steady pull?)"
    )
