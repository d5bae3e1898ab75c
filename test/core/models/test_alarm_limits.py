# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limits of the alarm in a stored model."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.alarm_limits import (
    AlarmLimits,
    ChangeLimits,
    LeftOnAxis,
    RepeatingPart,
    change_sentence,
)

STORED = AlarmLimits(
    miscoverage_s=np.arange(1.0, 7.0),
    hover_rotor_speed=900.0,
    flights=9,
    hours=0.5,
    estimate_per_hour=(1.2, 0.5, 2.4),
).to_json()


def test_json_gives_the_same_limits() -> None:
    again = AlarmLimits.from_json(json.loads(json.dumps(STORED)))
    assert again.to_json() == STORED
    assert "; estimated: 1.2 per hour, 0.5 to 2.4 (95 %); the rate is" in again.sentence()
    np.testing.assert_array_equal(again.miscoverage_s, np.arange(1.0, 7.0))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"allowance": 0.0}, "`allowance` must be a positive number not above 1, found 0.0"),
        ({"allowance": 1.5}, "`allowance` must be a positive number not above 1, found 1.5"),
        ({"rate_per_hour": float("nan")}, "`rate_per_hour` must be a positive number, found nan"),
        ({"flights": -1}, "`flights` must be a whole number not below 0, found -1"),
        ({"hours": -0.1}, "`hours` must be a number not below 0, found -0.1"),
        ({"hover_rotor_speed": "fast"}, "`hover_rotor_speed` must be a number not below 0, found 'fast'"),
        ({"miscoverage_s": STORED["miscoverage_s"] | {"Fz": 0.0}}, "miscoverage_s: `Fz` must be a positive"),
        ({"miscoverage_s": {"Fx": 1.0}}, "miscoverage_s: missing key `Fy`"),
    ],
)
def test_numbers_that_no_calibration_gives_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=f"^alarm: {message}"):
        AlarmLimits.from_json(STORED | changes)


def test_the_sequential_test_looks_for_five_times_the_allowed_misses() -> None:
    assert AlarmLimits().allowance == pytest.approx(np.log(0.95 / 0.75) / np.log(0.25 * 0.95 / (0.05 * 0.75)))


def test_uncalibrated_limits_are_two_seconds_and_claim_no_rate() -> None:
    np.testing.assert_array_equal(AlarmLimits().miscoverage_s, np.full(6, 2.0))
    assert "no rate is claimed" in AlarmLimits().sentence()


def test_the_rate_of_a_short_calibration_is_said_to_be_extrapolated() -> None:
    """No alarm in t bounds the rate at 3.0/t (Poisson, 95 %)."""
    short, long = (AlarmLimits(flights=15, hours=hours) for hours in (1.61 / 60.0, 4.0))
    assert short.rate_bound_per_hour == pytest.approx(-np.log(0.05) / short.hours)
    assert short.rate_extrapolated
    assert short.sentence() == (
        "alarm calibrated to 1 false alarms per flight hour on 15 flights, "
        "each left out in turn (1.61 min); "
        "the rate is extrapolated: 1.61 min without an alarm bound it at 112 per hour (95 %) only, "
        "3 h more would bound it at that"
    )
    assert not long.rate_extrapolated
    assert "within what they show: 240 min without an alarm bound it at 0.749 per hour" in long.sentence()


LEFT = LeftOnAxis(0.1, 0.2, 0.01, 0.6, 0.4, 0.3, 0.65, 2.5)
LIMITS = ChangeLimits({"Fz": LEFT}, ((1.0, 0.1, -0.1),) * 4, flights=12, hours=0.2, largest=3.0)


PART = RepeatingPart(
    dict.fromkeys(INPUT_NAMES, -1.0),
    dict.fromkeys(INPUT_NAMES, 1.0),
    {"Fz": dict.fromkeys(INPUT_NAMES, (0.1, 0.2))},
)


def test_limits_survive_their_file() -> None:
    repeating = replace(LIMITS, repeating=PART)
    assert ChangeLimits.from_json(json.loads(json.dumps(repeating.to_json()))) == repeating
    older = {name: value for name, value in LIMITS.to_json().items() if name != "repeating"}
    assert ChangeLimits.from_json(json.loads(json.dumps(older))) == LIMITS
    assert ChangeLimits.from_json(json.loads(json.dumps(LIMITS.to_json()))) == LIMITS


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"flights": 7}, "`flights`"),
        ({"axes": {}}, "`axes`"),
        ({"axes": {"Mz": LEFT.__dict__}}, "Mz"),
        ({"axes": {"Fz": LEFT.__dict__ | {"scale": 0.0}}}, "`scale`"),
        ({"axes": {"Fz": LEFT.__dict__ | {"white": 0.0}}}, "`white`"),
        ({"largest": -1.0}, "`largest`"),
        ({"levers": [[1.0, 2.0]]}, "levers"),
        ({"repeating": PART.__dict__ | {"lower": {"u": 0.0}}}, "missing key `v`"),
        ({"repeating": PART.__dict__ | {"slopes": {"Fz": {"u": [0.0]}}}}, "slopes"),
    ],
)
def test_what_no_flights_give_is_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ModelError, match=words):
        ChangeLimits.from_json(json.loads(json.dumps(LIMITS.to_json() | change)))


def test_no_sound_flight_has_raised_the_alarm() -> None:
    assert LIMITS.evidence == 20.0
    assert replace(LIMITS, largest=50.0).evidence == 50.0


def test_the_sentence_tells_a_bound_from_an_estimate() -> None:
    assert LIMITS.sentence() == (
        "change of the vehicle: estimated 5 % of sound flights raise it at most, 0.25 % more as a load; "
        "loads apart, 12 flights, none of which does, bound it at 1 flight in 13 on average, or 22 % (95 %); "
        "47 sound flights more could bound it at 5 %"
    )
    assert replace(LIMITS, flights=59).sentence().endswith("or 5 % (95 %)")
    beyond = replace(LIMITS, largest=47.0).sentence()
    assert "no share is estimated, as a sound flight left out gathered evidence of 47 to 1" in beyond
    assert "not judged by the size of residuals: that takes 8 flights" in change_sentence(None)
    assert change_sentence(LIMITS) == LIMITS.sentence()
