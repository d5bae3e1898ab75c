# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace

import pytest

from quadpi_core.errors import ModelError
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.models.alarm_limits import ChangeLimits, LeftOnAxis, RepeatingPart, change_sentence

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
        "change of the vehicle: estimated 5 % of sound flights raise it at most; 12 flights, none of which "
        "does, bound it at 1 flight in 13 on average, or 22 % (95 %); 47 sound flights more could bound it "
        "at 5 %"
    )
    assert replace(LIMITS, flights=59).sentence().endswith("or 5 % (95 %)")
    beyond = replace(LIMITS, largest=47.0).sentence()
    assert "no share is estimated, as a sound flight left out gathered evidence of 47 to 1" in beyond
    assert "not judged by the size of residuals: that takes 8 flights" in change_sentence(None)
    assert change_sentence(LIMITS) == LIMITS.sentence()
