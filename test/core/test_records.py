# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import re
from typing import Annotated

import numpy as np
import pytest

from quadpi_core import results
from quadpi_core.findings import NOTHING_TO_SAY, DataQuality, Finding, LeftOut
from quadpi_core.frames import Array
from quadpi_core.monitor.change import found_columns, nothing_found
from quadpi_core.paths import message_directory
from quadpi_core.records import Records, Vector3, columns_of, record_dtype
from quadpi_core.results import ReportedAlarms


class Sample:
    time_ns: int
    rates: Vector3


class Estimate(Sample):
    weight: float
    covariance: Annotated[Array, 2, 2]


class Memory:
    newest: Estimate
    held: Annotated[Records, Sample, 4]


def test_fields_have_the_types_and_shapes_of_their_annotations():
    dtype = record_dtype(Memory)
    estimate = dtype["newest"]
    assert estimate.names == ("time_ns", "rates", "weight", "covariance")
    assert estimate["time_ns"] == np.int64
    assert estimate["rates"].shape == (3,)
    assert estimate["weight"] == np.float64
    assert estimate["covariance"].shape == (2, 2)
    assert dtype["held"].shape == (4,)
    assert dtype["held"].base == record_dtype(Sample)


def test_a_type_without_a_fixed_size_is_refused():
    class Named:
        name: str

    with pytest.raises(TypeError, match="str declares no fields"):
        record_dtype(Named)


def test_columns_are_the_fields_in_turn():
    class State:
        place: Vector3
        delay: float
        turn: Annotated[Array, 2, 2]

    assert columns_of(State) == (slice(0, 3), slice(3, 4), slice(4, 8))
    numbers = np.arange(8.0)
    record = numbers.view(record_dtype(State))[0]
    for field, column in zip(("place", "delay", "turn"), columns_of(State), strict=True):
        np.testing.assert_array_equal(np.ravel(record[field]), numbers[column])
    with pytest.raises(TypeError, match="Sample: not all fields are float64"):
        columns_of(Sample)


# Results in arrays: their numbers are those that the messages' definitions name, and rows can be chosen.


ALARM, EVENT = (
    (message_directory() / f"{name}.msg").read_text() for name in ("ExtrapolationAlarm", "AlarmEvent")
)


def constants(text):
    return {name: int(value) for name, value in re.findall(r"^uint8 ([A-Z_]+)=(\d+)", text, re.MULTILINE)}


def test_constants_are_those_of_the_messages():
    named = constants(ALARM)
    assert len(named) == 18
    for name, value in (named | constants(EVENT)).items():
        assert getattr(results, name.removeprefix("HEALTH_")) == value
    assert tuple(constants(EVENT).values()) == results.CAUSES
    assert f"The topic keeps the last {results.EVENTS_KEPT} for" in EVENT


@pytest.fixture
def alarms():
    health = np.zeros((4, 4), np.uint8)
    health[2, 2] = results.UNAVAILABLE
    health[3, :2] = results.UNAVAILABLE
    return ReportedAlarms(
        time_ns=np.arange(4),
        level=np.array([0, 1, 2, 0], np.uint8),
        causes=np.zeros(4, np.uint8),
        cause_level=np.zeros((4, 4), np.uint8),
        cause_health=health,
        cause_evidence=np.arange(16.0).reshape(4, 4),
        **dict.fromkeys(("leverage", "width", "miscoverage", "miss_share"), np.arange(24.0).reshape(4, 6)),
        **found_columns(nothing_found(4), None),
        envelope_distance=np.zeros(4),
        inputs_outside=[(), ("u",), ("v",), ()],
        reasons=[("a",), ("b",), ("c",), ("d",)],
    )


def test_messages_without_a_sample_are_those_whose_bad_data_is_unavailable(alarms):
    """Causes that wait for a state are unavailable too, while samples come."""
    assert alarms.of_samples.tolist() == [True, True, False, True]


def test_chosen_rows_keep_their_words(alarms):
    chosen = alarms.where(alarms.level > 0)
    assert (len(chosen), chosen.time_ns.tolist()) == (2, [1, 2])
    assert (chosen.inputs_outside, chosen.reasons) == ([("u",), ("v",)], [("b",), ("c",)])
    np.testing.assert_array_equal(chosen.width, alarms.width[1:3])


# Problems found in a flight's data, as sentences and as JSON.


LEFT_OUT = LeftOut("imu", "beyond 70 rad/s", samples=2, of=500, first=17, first_s=0.0344)
FINDING = Finding("units_of_rates", "imu", "looks like deg/s: multiply by 0.0175", certain=True)


def test_sentences_name_the_topic_first_and_what_was_left_out_before_what_contradicts():
    assert list(DataQuality((LEFT_OUT,), findings=(FINDING,)).sentences()) == [
        "topic imu: left out 2 of 500 samples beyond 70 rad/s; the first is sample 17, at 0.034 s",
        "topic imu: looks like deg/s: multiply by 0.0175",
    ]
    assert list(NOTHING_TO_SAY.sentences()) == []


def test_json_holds_every_number():
    data = json.loads(json.dumps(DataQuality((LEFT_OUT,), findings=(FINDING,)).to_json()))
    assert data["left_out"] == [
        {
            "topic": "imu",
            "limit": "beyond 70 rad/s",
            "samples": 2,
            "of": 500,
            "first": 17,
            "first_s": 0.0344,
        }
    ]
    assert data["findings"] == [
        {
            "mistake": "units_of_rates",
            "topic": "imu",
            "text": "looks like deg/s: multiply by 0.0175",
            "certain": True,
            "leave_out": False,
        }
    ]
    assert set(map(str, NOTHING_TO_SAY.to_json().values())) == {"[]"}
