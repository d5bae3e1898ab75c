# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that do not come, and stamps that are wrong, from the third second on; see docs/reliability.md."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.monitor.alarm import BAD_DATA
from quadpi_core.signals.ekf_kernels import EstimatorStatus
from test.faults.onboard import deviation

AT_S = 3.0
FOR_S = 0.5
CLEARED_S = 0.62
# Poses and the IMU are collected for a second, from the second sample on that agrees with the new stamps.
STARTED_ANEW_S = 1.01
# Once started, biases and velocity have to become known.
SETTLED_S = 1.5
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
    flown = failing(kind, topic, AT_S, 0.05, **({"size": 0.2} if kind == "stamps_backward" else {}))
    assert not flown.alarms.level.any()
    assert not flown.standing()
    lost = np.setdiff1d(calm.predictions.time_ns, flown.predictions.time_ns)
    assert len(lost) == (25 if topic == "imu" else 0)
    assert deviation(flown, calm, AT_S + 0.2) < 0.5


@pytest.mark.parametrize(
    ("kind", "options"),
    [("stamps_repeated", {}), ("stamps_backward", {"size": 0.2}), ("stamps_backward", {"size": 5.0})],
)
@pytest.mark.parametrize("topic", ["imu", "mocap/pose", "rotor_speeds"])
def test_clock_that_stands_or_is_set_back(failing, calm, topic, kind, options):
    flown = failing(kind, topic, AT_S, FOR_S, **options)
    if topic == "imu":
        # Set back by more than a second it is a new beginning, of which there is nothing to say yet.
        if options.get("size", 0.0) < 1.0:
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
    assert flown.not_ok(BAD_DATA)[1] < settled_s + CLEARED_S
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
