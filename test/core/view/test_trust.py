# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The state in one word and its reasons in a pilot's words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import OdometryStream, RotorSpeedStream, WindStream
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bags import read_bag
from quadpi_core.messages.sensor_messages import unpack_odometry
from quadpi_core.models.envelope import Envelope
from quadpi_core.monitor.change import found_columns, nothing_found
from quadpi_core.results import (
    ACTIVE,
    BAD_DATA,
    EXTRAPOLATION,
    LEVEL_ALARM,
    LEVEL_OK,
    LEVEL_WARNING,
    MISCOVERAGE,
    UNAVAILABLE,
    UNCALIBRATED,
    WAITING,
    ReportedAlarms,
)
from quadpi_core.view.trust import (
    REPORTS,
    STRETCH_NS,
    MotionInputs,
    State,
    outside_words,
    reasons_of,
    states_of,
    too_many_misses,
)

from .conftest import BAG


def message(
    level=LEVEL_OK, causes=0, health=(ACTIVE, ACTIVE, ACTIVE, UNAVAILABLE), outside=(), reasons=()
) -> ReportedAlarms:
    return ReportedAlarms(
        time_ns=np.zeros(1, dtype=np.int64),
        level=np.array([level], dtype=np.uint8),
        causes=np.array([causes], dtype=np.uint8),
        cause_level=np.zeros((1, 4), dtype=np.uint8),
        cause_health=np.array([health], dtype=np.uint8),
        cause_evidence=np.zeros((1, 4)),
        leverage=np.zeros((1, 6)),
        width=np.zeros((1, 6)),
        miscoverage=np.zeros((1, 6)),
        miss_share=np.zeros((1, 6)),
        **found_columns(nothing_found(1), None),
        envelope_distance=np.zeros(1),
        inputs_outside=[tuple(outside)],
        reasons=[tuple(reasons)],
    )


@pytest.mark.parametrize(
    ("alarm", "state"),
    [
        (message(), State.TRUSTED),
        (message(health=(UNCALIBRATED, UNCALIBRATED, ACTIVE)), State.TRUSTED),
        (message(health=(ACTIVE, WAITING, ACTIVE)), State.NOT_JUDGED),
        (message(LEVEL_WARNING, EXTRAPOLATION), State.WARNING),
        (message(LEVEL_ALARM, MISCOVERAGE), State.ALARM),
        (message(LEVEL_ALARM, BAD_DATA), State.ALARM),
        (message(LEVEL_ALARM, BAD_DATA, health=(WAITING, WAITING, UNAVAILABLE)), State.NO_DATA),
        (message(health=(WAITING, WAITING, ACTIVE)), State.NOT_JUDGED),
        (message(health=(UNAVAILABLE, UNAVAILABLE, ACTIVE)), State.NOT_JUDGED),
    ],
)
def test_state(alarm, state):
    assert states_of(alarm) == [state]


@pytest.mark.parametrize(
    ("name", "values", "training", "words"),
    [
        ("u", (9.0, 11.3), (-2.0, 5.6), "forward speed 11.3 m/s, trained up to 5.6"),
        ("u", (-3.0, 1.0), (-2.0, 8.1), "backward speed 3.0 m/s, trained up to 2.0"),
        ("u", (1.0, 1.5), (2.0, 8.0), "forward speed 1.0 m/s, trained down to 2.0"),
        ("omega_avg", (600.0, 700.0), (800.0, 1200.0), "mean rotor speed 600 rad/s, trained down to 800"),
        ("cos_phi", (0.5, 0.6), (0.7, 1.0), "roll angle 60.0°, trained up to 45.6°"),
        ("cos_phi", (0.9, 1.0), (0.5, 0.8), "roll angle 0°, trained down to 36.9°"),
        ("sin_theta", (-0.9, 0.1), (-0.5, 0.5), "pitch angle nose down 64.2°, trained up to 30.0°"),
        (
            "w",
            (1.0, 2.0),
            (-3.0, -1.0),
            "downward body speed 2.0 m/s, trained only upward body speed 1.0 and more",
        ),
        ("u", (-1.0, -0.5), (2.0, 8.0), "backward speed 1.0 m/s, trained only forward speed 2.0 and more"),
        ("mu_x", (0.1, 0.25), (-0.1, 0.15), "forward speed over tip speed 0.25, trained up to 0.15"),
        ("v_in", (4.46, 5.0), (4.52, 5.2), "induced velocity 4.46 m/s, trained down to 4.52"),
        ("r", (0.0, 0.5), (0.0, 0.0), "yaw rate to the right 0.5 rad/s, trained up to 0"),
    ],
)
def test_an_input_outside_in_plain_words(name, values, training, words):
    assert outside_words(name, values, training) == words


def test_an_input_inside_or_unknown_has_no_words():
    assert outside_words("u", (-1.0, 8.1), (-2.0, 8.1)) is None
    # "0 % outside" is nothing that a pilot could act on.
    assert outside_words("u", (-1.0, 8.3), (-2.0, 8.1)) is None
    assert outside_words("u", (-1.0, 8.4), (-2.0, 8.1)) is not None
    assert outside_words("u", (np.nan, np.nan), (-2.0, 8.1)) is None


def reasons(alarm, envelope=None, **values):
    inputs = np.zeros(len(INPUT_NAMES))
    for name, value in values.items():
        inputs[INPUT_NAMES.index(name)] = value
    return reasons_of(alarm, 0, envelope, inputs, inputs)


@pytest.fixture
def envelope() -> Envelope:
    count = len(INPUT_NAMES)
    fields = ("leverage_peak", "width_peak", "leverage_limit", "width_limit")
    return Envelope(
        np.full(count, -1.0), np.full(count, 1.0), np.full(count, 0.1), *(np.ones(6) for _ in fields)
    )


def test_what_a_pilot_controls_comes_first_then_what_is_farthest_and_the_rest_follows(envelope):
    alarm = message(
        LEVEL_ALARM,
        EXTRAPOLATION | MISCOVERAGE,
        outside=("mu_x", "p", "u", "v", "q"),
        reasons=(
            "roll rate 3.0 x the training range",
            "downward force: leverage 3.0 x its peak in training",
            "forward force outside its interval 31 % of the time",
        ),
    )
    assert reasons(alarm, envelope, u=2.0, p=-3.0, v=1.5, q=1.2, mu_x=4.0) == (
        "roll rate to the left 3.0 rad/s, trained up to 1.0",
        "forward speed over tip speed 4.0, trained up to 1.0",
        "forward speed 2.0 m/s, trained up to 1.0",
        "downward force: leverage 3.0 x its peak in training",
        "forward force outside its interval 31 % of the time",
    )


def test_values_take_the_place_of_ratios_behind_bad_data(envelope):
    given = (
        "rotor 3 reads half",
        "roll rate 1.4 x the training range",
        "sideways speed 1.2 x the training range",
    )
    alarm = message(LEVEL_ALARM, EXTRAPOLATION | BAD_DATA, outside=("p",), reasons=(*given, "more"))
    assert reasons(alarm, envelope, p=2.0) == (
        given[0],
        "roll rate to the right 2.0 rad/s, trained up to 1.0",
        "more",
    )


def test_bad_data_comes_before_inputs_that_the_message_does_not_name(envelope):
    alarm = message(LEVEL_ALARM, EXTRAPOLATION | BAD_DATA, outside=("p",), reasons=("rotor 3 reads half",))
    words = ("rotor 3 reads half", "roll rate to the right 2.0 rad/s, trained up to 1.0")
    assert reasons(alarm, envelope, p=2.0) == words


def test_without_an_envelope_the_message_is_said_as_it_is():
    given = ("forward speed 1.4 x the training range",)
    assert reasons(message(LEVEL_ALARM, EXTRAPOLATION, outside=("u",), reasons=given)) == given


def test_a_name_that_is_no_input_is_passed_over(envelope):
    alarm = message(
        LEVEL_ALARM, EXTRAPOLATION, outside=("<script>", "u"), reasons=("u 1.4 x the training range",)
    )
    assert reasons(alarm, envelope, u=2.0) == ("forward speed 2.0 m/s, trained up to 1.0",)


def test_an_alarm_without_a_reason_as_of_older_recordings_has_one():
    (words,) = reasons(message(LEVEL_ALARM, EXTRAPOLATION | BAD_DATA))
    assert words == "extrapolation and bad data: the message says no more"


@pytest.mark.parametrize(
    ("inside", "words"),
    [
        (0.80, "force to the right outside its interval 20 % of the last 10 s, 5 % allowed"),
        (0.88, None),
        (np.nan, None),
    ],
)
def test_nothing_is_trusted_whose_intervals_do_not_hold(inside, words):
    shares = np.array([1.0, inside, 1.0, 0.0, 1.0, 1.0])
    assert too_many_misses(shares, ("Fx", "Fy", "Fz"), 0.95) == words
    assert too_many_misses(shares, ("Fx", "Fy"), np.nan) is None


@pytest.mark.parametrize(
    ("alarm", "words"),
    [
        (message(), ()),
        (message(health=(ACTIVE, WAITING, ACTIVE)), ("on the ground, or the state settles",)),
        (message(health=(WAITING, WAITING, ACTIVE)), ("on the ground, or the state settles",)),
        (
            message(LEVEL_ALARM, BAD_DATA, (WAITING, WAITING, UNAVAILABLE), reasons=("no imu for 0.4 s",)),
            ("no imu for 0.4 s",),
        ),
    ],
)
def test_what_is_said_where_no_limit_is_passed(alarm, words):
    assert reasons(alarm) == words


# Inputs from topics are those that the monitor sees, but for its low-pass.


@pytest.fixture(scope="module")
def published(results_bag, vehicle) -> tuple[OdometryStream, RotorSpeedStream]:
    """What the estimator publishes for the flight, and its rotor speeds."""
    with Bag(results_bag) as bag:
        states = unpack_odometry(bag.read(["/odometry"])["/odometry"].payloads)
    rotors = read_bag(BAG, vehicle).rotor_speeds
    assert rotors is not None
    return states, rotors


def test_they_are_those_of_the_monitor(published, model, vehicle, judged_view):
    time_ns, inputs = MotionInputs(vehicle).take(*published, None)
    assert np.all(np.diff(time_ns)[:-1] == STRETCH_NS)
    blocks = (time_ns - judged_view.start_ns) // judged_view.blocks.block_ns
    chosen = (blocks >= 40) & (blocks < judged_view.blocks.newest)
    judged = np.array([judged_view.blocks.value(int(block), "inputs") for block in blocks[chosen]])
    apart = np.abs(inputs[chosen] - judged) / model.envelope.scale
    assert np.median(apart) < 0.02
    assert np.quantile(apart, 0.99) < 0.3


def test_states_without_rotor_speeds_near_them_have_none(published, vehicle):
    states, rotors = published
    live = MotionInputs(vehicle)
    assert len(live.take(states, None, None)[0]) == 0
    early = rotors.time_ns <= states.time_ns[20]
    time_ns, _ = live.take(states, RotorSpeedStream(rotors.time_ns[early], rotors.speeds[early]), None)
    assert 0 < len(time_ns) < 10
    # The last rotor speeds of before are those of the first states of now.
    assert len(live.take(states.take(np.arange(20)), None, None)[0]) > 0


def test_wind_is_taken_off(published, vehicle):
    live = MotionInputs(vehicle)
    _, still = live.take(*published, None)
    north = WindStream(published[0].time_ns[:1], np.array([[1.0, 0.0, 0.0]]))
    _, windy = live.take(*published, north)
    assert np.abs(windy[:, :3] - still[:, :3]).max() == pytest.approx(1.0, abs=0.1)


def test_other_numbers_of_rotors_are_said(published, vehicle):
    states, rotors = published
    live = MotionInputs(vehicle)
    assert len(live.take(states, replace(rotors, speeds=np.zeros((len(rotors.time_ns), 6))), None)[0]) == 0
    assert live.problem.startswith("topic rotor_speeds: 6 rotors, vehicle bebop2 has 4")


# What battery and autopilot say beside the state, in words.


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"voltage": 15.24, "percentage": 0.78}, "15.2 V, 78 %"),
        ({"voltage": 15.24, "percentage": np.nan}, "15.2 V"),
        ({"voltage": np.nan, "percentage": 0.78}, "78 %"),
        ({"voltage": np.nan, "percentage": np.nan}, "not measured"),
    ],
)
def test_a_battery_says_what_it_measures(given, words):
    assert REPORTS["sensor_msgs/msg/BatteryState"].words(given) == words


@pytest.mark.parametrize("mode", ["OFFBOARD", b"OFFBOARD"])
def test_an_autopilot_says_its_mode_and_whether_it_is_connected(mode):
    words = REPORTS["mavros_msgs/msg/State"].words({"connected": False, "armed": True, "mode": mode})
    assert words == "OFFBOARD, armed, link lost"
