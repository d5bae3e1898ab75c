# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that do not come, and stamps that are wrong, from the third second on; see README.md."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.estimator.filter_state import EstimatorStatus
from quadpi_core.flight import Recording
from quadpi_core.logs.bags import read_bag, read_outputs, write_bag
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory
from quadpi_core.results import BAD_DATA
from quadpi_core.simulation.sensors import Sent
from test.faults.onboard import deviation, sent_by

AT_S = 3.0
FOR_S = 0.5
CLEARED_S = 0.62
# Poses and the IMU are collected for a second, from the second sample on that agrees with the new stamps.
STARTED_ANEW_S = 1.01
# Once started, biases and velocity have to become known.
SETTLED_S = 1.5
STREAMS = {"imu": "imu", "pose": "mocap/pose", "rotor_speeds": "rotor_speeds"}
YEAR_NS = 365 * 86_400 * 10**9
INITIALISING, DEGRADED, OK = EstimatorStatus.INITIALISING, EstimatorStatus.DEGRADED, EstimatorStatus.OK


def restamped(change, for_s=FOR_S):
    """`altered`'s second argument: stamps through `change` for a while."""

    def alter(sent, seconds):
        stamps = sent.stream.time_ns
        spoiled = (seconds >= AT_S) & (seconds < AT_S + for_s)
        return replace(sent, stream=replace(sent.stream, time_ns=np.where(spoiled, change(stamps), stamps)))

    return alter


def only_one(change):
    """`altered`'s second argument: one stamp through `change`."""

    def alter(sent, seconds):
        stamps = sent.stream.time_ns.copy()
        index = int(np.argmax(seconds >= AT_S))
        stamps[index] = change(stamps[index])
        return replace(sent, stream=replace(sent.stream, time_ns=stamps))

    return alter


def assert_said_at_once(flown, from_s):
    """Until the estimator has started anew."""
    assert any("missing" in text for text in flown.words(BAD_DATA))
    first, last = flown.not_ok(BAD_DATA)
    assert first == pytest.approx(from_s, abs=0.15)
    assert last < from_s + STARTED_ANEW_S + CLEARED_S
    assert not flown.standing()


def assert_starts_anew(flown, calm, from_s):
    """A second of samples later all is as if nothing had been."""
    assert flown.states(from_s + SETTLED_S, 8.0) == {OK}
    assert deviation(flown, calm, from_s + STARTED_ANEW_S + 0.2) < 0.5


def test_short_gap_of_the_imu(failing, calm):
    flown = failing("dropout", "imu", AT_S, 0.05)
    assert (flown.health["imu"].gaps, flown.health["imu"].longest_gap_s) == (1, pytest.approx(0.052))
    assert not flown.alarms.level.any()
    assert set(flown.predictions.time_ns) == set(calm.predictions.time_ns) & set(flown.imu_ns)
    assert deviation(flown, calm, AT_S + 0.2) < 0.1


@pytest.mark.parametrize("for_s", [0.15, 0.5, 1.5])
def test_gap_of_the_imu(failing, calm, for_s):
    flown = failing("dropout", "imu", AT_S, for_s)
    assert "gap in the samples" in flown.words(BAD_DATA)
    assert flown.health["imu"].refused == {"STAMP_JUMPED": 1, "RESET": 1}
    assert_said_at_once(flown, AT_S + for_s)
    assert_starts_anew(flown, calm, AT_S + for_s)


def test_gap_of_the_rotor_speeds(failing, calm):
    flown = failing("dropout", "rotor_speeds", AT_S, FOR_S)
    assert any("rotor speeds missing" in text for text in flown.words(BAD_DATA))
    assert flown.raised(BAD_DATA) == [pytest.approx(AT_S + 0.05, abs=0.01)]
    assert flown.not_ok(BAD_DATA)[1] < AT_S + FOR_S + CLEARED_S
    assert deviation(flown, calm, AT_S + FOR_S + 0.2) < 0.1


@pytest.mark.parametrize("topic", ["imu", "mocap/pose", "rotor_speeds"])
@pytest.mark.parametrize("kind", ["stamps_repeated", "stamps_backward"])
def test_short_stop_or_step_of_a_clock(failing, calm, topic, kind):
    """For 50 ms: nothing but these samples is lost, and nobody need know of it."""
    flown = failing(kind, topic, AT_S, 0.05, **({"size_s": 0.2} if kind == "stamps_backward" else {}))
    assert not flown.alarms.level.any()
    assert not flown.standing()
    lost = np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns)
    assert len(lost) == (25 if topic == "imu" else 0)
    assert deviation(flown, calm, AT_S + 0.2) < 0.5


@pytest.mark.parametrize(
    ("kind", "options"),
    [("stamps_repeated", {}), ("stamps_backward", {"size_s": 0.2}), ("stamps_backward", {"size_s": 5.0})],
)
@pytest.mark.parametrize("topic", ["imu", "mocap/pose", "rotor_speeds"])
def test_clock_that_stands_or_is_set_back(failing, calm, topic, kind, options):
    flown = failing(kind, topic, AT_S, FOR_S, **options)
    if topic == "imu":
        # Set back by more than a second it is a new beginning, of which there is nothing to say yet.
        if options.get("size_s", 0.0) < 1.0:
            assert_said_at_once(flown, AT_S + FOR_S)
        assert_starts_anew(flown, calm, AT_S + FOR_S)
    elif topic == "rotor_speeds":
        assert any("rotor speeds missing" in text for text in flown.words(BAD_DATA))
        assert flown.raised(BAD_DATA) == [pytest.approx(AT_S + 0.05, abs=0.02)]
        assert flown.not_ok(BAD_DATA)[1] < AT_S + FOR_S + CLEARED_S
        assert deviation(flown, calm, AT_S + FOR_S + 0.2) < 0.1
    else:
        assert DEGRADED in flown.states(AT_S, AT_S + FOR_S)
        assert flown.states(AT_S + FOR_S + 0.1, 8.0) == {OK}
        assert not flown.alarms.level.any()
        assert deviation(flown, calm, 0.0) < 0.5


@pytest.mark.parametrize("change", [lambda _: 0, lambda stamp: stamp + YEAR_NS], ids=["zero", "year-ahead"])
@pytest.mark.parametrize("topic", ["imu", "mocap/pose", "rotor_speeds"])
def test_one_stamp_far_off(altered, calm, topic, change):
    flown = altered(topic, only_one(change))
    assert not flown.raised(BAD_DATA)
    lost = np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns)
    assert len(lost) <= {"imu": 1, "rotor_speeds": 2, "mocap/pose": 0}[topic]
    assert flown.states(SETTLED_S, 8.0) == {OK}
    assert deviation(flown, calm, AT_S + 0.2) < 0.1


@pytest.mark.parametrize(
    ("topic", "factor", "ahead_ns"),
    [
        ("imu", 0, 0),
        ("imu", 1, YEAR_NS),
        ("mocap/pose", 0, 0),
        ("mocap/pose", 1, YEAR_NS),
        ("rotor_speeds", 0, 0),
        ("rotor_speeds", 1, YEAR_NS),
    ],
)
def test_clock_far_off(altered, calm, topic, factor, ahead_ns):
    flown = altered(topic, restamped(lambda stamps: factor * stamps + ahead_ns))
    if topic == "mocap/pose":
        assert DEGRADED in flown.states(AT_S, AT_S + FOR_S)
        assert not flown.alarms.level.any()
        assert deviation(flown, calm, 0.0) < 0.5
        return
    assert any("missing" in text for text in flown.words(BAD_DATA))
    assert flown.raised(BAD_DATA)
    settled_s = AT_S + FOR_S + (STARTED_ANEW_S if topic == "imu" else 0.0)
    # Nothing is judged in the first second after the clock came back: this may be a stamp a year ahead.
    assert flown.not_ok(BAD_DATA)[1] % (1e-9 * YEAR_NS) < settled_s + CLEARED_S
    assert flown.alarms.level[-1] == 0
    assert deviation(flown, calm, settled_s + 0.2) < 0.3


@pytest.mark.parametrize("back_s", [1.5, 3.0, 1000.0])
def test_bag_that_starts_over(sensors, fly_onboard, back_s):
    """All clocks at once: everything begins anew, without an alarm."""
    sent = sensors()
    jump_ns = sent["imu"].taken_ns[0] + round(1e9 * AT_S)
    over = {
        topic: replace(
            one,
            stream=replace(
                one.stream,
                time_ns=one.stream.time_ns - np.where(one.taken_ns >= jump_ns, round(1e9 * back_s), 0),
            ),
        )
        for topic, one in sent.items()
    }
    flown = fly_onboard(over)
    assert flown.health["imu"].refused == {"STAMP_JUMPED": 1, "RESET": 1}
    assert flown.states(AT_S + 0.01, AT_S + 1.0) == {INITIALISING}
    assert flown.states(AT_S + SETTLED_S, 8.0) == {OK}
    assert not flown.alarms.level.any()
    begins = int(np.argmax(np.diff(flown.predictions.time_ns) < 0)) + 1
    again = flown.predictions.time_ns[begins:]
    np.testing.assert_array_equal(np.diff(again), 2_000_000)
    assert flown.seconds(again[0]) + back_s < AT_S + STARTED_ANEW_S
    assert again[-1] == flown.imu_ns[-1]


def every_third(sent, from_s):
    """What the sensors sent, of the IMU every third sample from then on."""
    imu = sent["imu"]
    index = np.arange(len(imu.taken_ns))
    kept = (imu.taken_ns < imu.taken_ns[0] + round(1e9 * from_s)) | (index % 3 == 0)
    part = type(imu.stream)(**{name: column[kept] for name, column in vars(imu.stream).items()})
    return {**sent, "imu": Sent(part, imu.taken_ns[kept], imu.arrival_ns[kept])}


def test_imu_whose_rate_changes(sensors, fly_onboard):
    """Without a pause: filters of the old rate predict for 0.3 s at most, then those of the new one."""
    flown = fly_onboard(every_third(sensors(), AT_S))
    assert flown.health["imu"].refused == {"RESET": 1}
    assert_said_at_once(flown, AT_S + 0.3)
    seconds = flown.seconds(flown.predictions.time_ns)
    assert not ((seconds > AT_S + 0.3) & (seconds < AT_S + 1.2)).any()
    again = seconds[seconds > AT_S + 0.3]
    assert again[0] < AT_S + 0.3 + STARTED_ANEW_S
    np.testing.assert_allclose(np.diff(again), 3.0 / 500.0)
    assert again[-1] == flown.seconds(flown.imu_ns[-1])


@pytest.mark.parametrize("given_hz", [500.0, 100.0])
def test_imu_rate_that_is_given_wrong(sensors, fly_onboard, given_hz):
    """Nothing is predicted from the first sample to the last, and the alarm says why."""
    flown = fly_onboard(every_third(sensors(4.0), 0.0), rate_hz=given_hz)
    assert len(flown.predictions.time_ns) == 0
    assert flown.words(BAD_DATA) == {"imu rate is not imu_rate_hz"}
    assert flown.raised(BAD_DATA) == [pytest.approx(1.05, abs=0.02)]
    assert flown.standing() == {BAD_DATA}


def test_imu_rate_that_is_measured_is_as_good_as_one_that_is_given(sensors, fly_onboard):
    sent = every_third(sensors(), 0.0)
    measured, given = fly_onboard(sent), fly_onboard(sent, rate_hz=500.0 / 3.0)
    assert len(measured.predictions.time_ns) > 1000
    np.testing.assert_array_equal(measured.predictions.time_ns, given.predictions.time_ns)
    np.testing.assert_allclose(
        measured.predictions.predicted, given.predictions.predicted, rtol=1e-5, atol=1e-6
    )


def test_replay_follows_a_rate_that_changes_as_the_nodes_do(fly_onboard, bebop2, tmp_path):
    vehicle, model = bebop2
    recording = replace(read_bag(bags_directory() / "interpolation.mcap", vehicle), arrivals={})
    sent = every_third(sent_by(recording, 6.0), AT_S)
    flown = fly_onboard(sent)
    streams = {name: sent[topic].stream for name, topic in STREAMS.items()}
    write_bag(tmp_path / "bag.mcap", Recording("bag", vehicle.name, "bag", **streams))
    replay(model, vehicle, tmp_path / "bag.mcap", tmp_path / "out.mcap")
    predictions, alarms = read_outputs(tmp_path / "out.mcap")
    np.testing.assert_array_equal(predictions.time_ns, flown.predictions.time_ns)
    np.testing.assert_allclose(predictions.measured, flown.predictions.measured, rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(alarms.time_ns, flown.alarms.time_ns)
    np.testing.assert_array_equal(alarms.cause_level, flown.alarms.cause_level)
