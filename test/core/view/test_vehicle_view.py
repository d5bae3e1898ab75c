# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the page knows of a vehicle."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import AXES, RotorSpeedStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.results import (
    ACTIVE,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_OK,
    UNCALIBRATED_WORDS,
    WAITING,
    AlarmEvent,
    Predictions,
    ReportedAlarms,
)
from quadpi_core.view.trust import State
from quadpi_core.view.vehicle_view import BLOCK_NS, EVENTS_SHOWN, MODELS_MAX, VehicleView

from .test_trust import message

START = 1_700_000_000_000_000_000


def predictions(seconds: float, start_ns: int = START, miss: bool = False) -> Predictions:
    count = round(500 * seconds)
    zero = np.zeros((count, 6))
    return Predictions(
        start_ns + np.arange(count) * 2_000_000,
        zero,
        zero - 1.0,
        zero + 1.0,
        zero + (2.0 if miss else 0.5),
        zero + 1.0,
    )


def view(known=None) -> VehicleView:
    return VehicleView("uav", known or {}, BLOCK_NS, 1000)


def test_nothing_is_known_at_first():
    one = view()
    assert (one.state, one.reasons) == (State.NO_DATA, ("nothing has come yet",))
    assert one.summary()["newest"] == -1
    assert one.window(0, 100)[1].shape[0] == 0
    json.dumps([one.describe(), one.summary(), one.overview()], allow_nan=False)


def said_at(seconds: float, alarm: ReportedAlarms) -> ReportedAlarms:
    return replace(alarm, time_ns=np.array([START + round(1e9 * seconds)]))


def test_nothing_is_trusted_whose_intervals_do_not_hold():
    one = view()
    for second in range(12):
        predicted = predictions(1.0, START + second * 10**9)
        # A quarter of the samples of the last six seconds.
        predicted.measured[:: 4 if second >= 6 else 1000, 1] = 2.0
        one.take_predictions("m", predicted, "m@1", 0.95, AXES)
        for tenth in range(10):
            one.take_alarms(said_at(second + 0.1 * tenth, message()))
        assert (one.state is State.WARNING) == (second == 11), second
    (reason,) = one.reasons
    assert reason == "force to the right outside its interval 15 % of the last 10 s, 5 % allowed"


@pytest.mark.parametrize("level", [LEVEL_OK, LEVEL_ALARM])
def test_misses_while_the_state_settles_do_not_count(level):
    """Under an alarm as well, such as that of a motion capture that has just come back."""
    one = view()
    for second in range(10):
        predicted, health = predictions(1.0, START + second * 10**9), (ACTIVE, ACTIVE, ACTIVE)
        if second < 5:
            predicted.measured[::2, 1], health = 2.0, (ACTIVE, WAITING, ACTIVE)
        one.take_predictions("m", predicted, "m@1", 0.95, AXES)
        raised = (level, EXTRAPOLATION) if second < 5 and level else ()
        for tenth in range(10):
            one.take_alarms(said_at(second + 0.1 * tenth, message(*raised, health=health)))
        settling = State.ALARM if level else State.NOT_JUDGED
        assert one.state is (settling if second < 5 else State.TRUSTED), second


def test_the_page_says_uncalibrated_and_trusts_the_model_on():
    one = view()
    one.take_predictions("m", predictions(1.0), "m@1", 0.95, AXES)
    one.take_alarms(said_at(0.5, message(reasons=(UNCALIBRATED_WORDS,))))
    assert (one.state, one.reasons) == (State.TRUSTED, (UNCALIBRATED_WORDS,))


def test_a_state_holds_until_the_next_message_and_a_short_alarm_is_short():
    one = view()
    one.take_predictions("m", predictions(3.0), "m@1", 0.95, AXES)
    alarm = message(LEVEL_ALARM, EXTRAPOLATION, reasons=("why",))
    for seconds, said in ((0.0, message()), (0.52, alarm), (0.61, message()), (1.0, message())):
        one.take_alarms(said_at(seconds, said))
    one.take_alarms(said_at(2.6, message()))
    states = "".join("-" if np.isnan(s) else str(int(s)) for s in one.window(0, 52)[1][:, 1])
    trusted, alarmed = str(int(State.TRUSTED)), str(int(State.ALARM))
    # Nobody says anything for more than a second.
    silent = "-" * 31
    assert states == trusted * 10 + alarmed * 2 + trusted * 9 + silent + trusted
    assert one.timeline.codes == states


def test_misses_are_counted_by_axis():
    one = view()
    one.take_predictions("m", predictions(1.0), "m@1", 0.95, AXES)
    one.take_predictions("m", predictions(1.0, START + 1_000_000_000, miss=True), "m@1", 0.95, AXES)
    assert one.blocks.value(3, "0.misses").tolist() == [0.0] * 6
    assert one.blocks.value(23, "0.misses").tolist() == [25.0] * 6


def test_a_doubt_comes_first_and_nothing_is_trusted_with_it():
    one = view()
    one.state, one.reasons = State.TRUSTED, ()
    assert one.summary()["state"] == State.TRUSTED
    one.doubts = ("2 monitors publish in /uav: their results are mixed",)
    assert one.summary()["state"] == State.WARNING
    one.state, one.reasons = State.ALARM, ("outside: forward speed",)
    assert one.summary()["state"] == State.ALARM
    assert one.summary()["reasons"] == [*one.doubts, "outside: forward speed"]


@pytest.mark.parametrize(("rotors", "shown"), [(6, 6), (4, 4), (100_000, 16)])
def test_rotor_speeds_of_any_number_of_rotors(rotors, shown):
    one = view()
    one.take_predictions("m", predictions(1.0), "m@1", 0.95, AXES)
    version = one.version
    speeds = np.tile(np.arange(float(rotors)), (50, 1))
    one.take_rotor_speeds(RotorSpeedStream(START + np.arange(50) * 2_000_000, speeds))
    assert one.describe()["columns"]["rotors"][1] == shown
    assert (one.version > version) == (shown != 4)
    assert one.blocks.value(0, "rotors").tolist() == list(range(shown))
    assert one.blocks.value(0, "0.count")[0] == 25


def test_words_come_with_the_blocks_from_which_they_hold(judged_view):
    first, rows, words = judged_view.window(100, 200)
    assert first == 100
    assert len(rows) == 101
    assert words[0][0] <= 100
    assert all(100 < number <= 200 for number, *_ in words[1:])
    assert any("trained up to" in text for _, texts, _ in words for text in texts)


def test_the_farthest_input_is_named_with_its_training_range(judged_view, model):
    event = next(one for one in judged_view.overview()["events"] if one["cause"] == "extrapolation")
    assert ", trained up to" in event["reasons"][0]
    assert event["start"] < event["end"]
    described = {one["name"]: one for one in judged_view.describe()["inputs"]}
    assert described["u"]["upper"] == model.envelope.upper[INPUT_NAMES.index("u")]


def test_another_model_in_flight_is_told():
    one = view()
    one.take_predictions("m", predictions(0.1), "m@1", 0.95, AXES)
    version = one.version
    one.take_predictions("m", predictions(0.1, START + 100_000_000), "m@1", 0.95, AXES)
    assert one.version == version
    one.take_predictions("m", predictions(0.1, START + 200_000_000), "m@2", 0.9, AXES[:3])
    assert one.version == version + 1
    assert one.describe()["models"] == [
        {"name": "m", "identity": "m@2", "confidence": 0.9, "axes": AXES[:3], "vehicle": None}
    ]


def test_more_models_than_colours_are_passed_over():
    one = view()
    for k in range(MODELS_MAX + 2):
        one.take_predictions(f"m{k}", predictions(0.1), f"m{k}@1", 0.95, AXES)
    assert len(one.describe()["models"]) == MODELS_MAX == one.blocks.models


def test_stamps_that_jump_are_drawn_behind_and_listed():
    one = view()
    one.take_predictions("m", predictions(2.0), "m@1", 0.95, AXES)
    one.take_predictions("m", predictions(1.0, START - 500_000_000_000), "m@1", 0.95, AXES)
    assert one.blocks.newest == 79
    (event,) = one.overview()["events"]
    assert event["cause"] == "stamps jumped"
    assert event["reasons"][0].startswith("by -502.0 s")
    # The time of day of what follows is that of its stamps.
    ((begin, start), (jumped, other)) = one.describe()["starts"]
    assert (begin, start) == (0.0, 1e-9 * START)
    assert jumped + other == pytest.approx(1e-9 * START - 500.0, abs=1e-6)


def test_silence_before_the_first_sample_is_said():
    one = view()
    silent = message(2, 4, (1, 1, 2), reasons=("no imu for 0.4 s",))
    one.take_alarms(silent)
    assert (one.state, one.reasons) == (State.NO_DATA, ("no imu for 0.4 s",))


def test_the_list_of_alarms_is_bounded_and_keeps_the_newest():
    one = view()
    one.take_predictions("m", predictions(0.1), "m@1", 0.95, AXES)
    for number in range(1, EVENTS_SHOWN + 50):
        at = START + number * 1_000_000
        one.take_events([AlarmEvent(number, 1, at, at, at + 1, 2.0, ("u 1.4 x the training range",))])
    events = one.overview()["events"]
    assert len(events) == EVENTS_SHOWN
    assert events[-1]["number"] == EVENTS_SHOWN + 49


def test_an_event_that_is_cleared_takes_its_place():
    one = view()
    one.take_predictions("m", predictions(0.1), "m@1", 0.95, AXES)
    for end in (0, START + 50_000_000):
        one.take_events([AlarmEvent(1, 2, START, START, end, 2.0, ())])
    (event,) = one.overview()["events"]
    assert (event["cause"], event["start"], event["end"]) == ("miscoverage", 0.0, 0.05)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_numbers_that_are_not_finite_do_not_end_it(bad):
    one = view()
    broken = predictions(0.1)
    broken.measured[3] = bad
    one.take_predictions("m", broken, "m@1", bad, AXES)
    assert one.blocks.newest == 1
    one.take_alarms(message(reasons=()))
