# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results in arrays: their numbers are those that the messages' definitions name, and rows can be chosen."""

import re

import numpy as np
import pytest

from quadpi_core import results
from quadpi_core.monitor.change import found_columns, nothing_found
from quadpi_core.paths import message_directory
from quadpi_core.results import ReportedAlarms

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
