# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Offsets to other clocks: by exchanges, by arrivals, of a log; with delays, drift and restarts."""

from __future__ import annotations

import numpy as np
import pytest

from quadpi_core.logs.clocks import DRIFT, ClockOffset, line_below

MS, S = 1_000_000, 1_000_000_000
TRUE = 1_700_000_000 * S


def delays(random: np.random.Generator, count: int) -> np.ndarray:
    """At least 1 ms, mostly little more, now and then much."""
    return (MS + random.exponential(0.5 * MS, count) + 40 * MS * (random.random(count) < 0.05)).astype(
        np.int64
    )


def test_exchanges_give_the_offset_within_their_bound() -> None:
    random, clock = np.random.default_rng(1), ClockOffset()
    there, back = delays(random, 100), delays(random, 100)
    for index, (out, home) in enumerate(zip(there, back, strict=True)):
        sent = TRUE + index * S // 2
        clock.exchange(sent, sent + int(out) - TRUE, sent + int(out + home))
        estimate = clock.estimate(sent + int(out + home))
        assert estimate
        assert estimate.exchanged
        assert abs(estimate.offset_ns - TRUE) <= estimate.uncertainty_ns
    assert abs(estimate.offset_ns - TRUE) < 0.5 * MS
    assert estimate.uncertainty_ns < 3 * MS


def test_an_answer_that_came_before_its_question_is_not_used() -> None:
    clock = ClockOffset()
    clock.exchange(TRUE, 0, TRUE - 5 * S)
    clock.exchange(TRUE, 0, TRUE + 5 * S)
    assert clock.estimate(TRUE) is None


def test_arrivals_give_the_offset_with_the_smallest_delay() -> None:
    random, clock = np.random.default_rng(2), ClockOffset()
    for index, delay in enumerate(delays(random, 2000)):
        clock.arrival(index * 5 * MS, TRUE + index * 5 * MS + int(delay))
    estimate = clock.estimate(TRUE + 10 * S)
    assert estimate
    assert not estimate.exchanged
    assert estimate.uncertainty_ns is None
    assert estimate.offset_ns == pytest.approx(TRUE + MS, abs=0.1 * MS)


@pytest.mark.parametrize("drift", [-0.9 * DRIFT, 0.5 * DRIFT])
def test_stamps_follow_drift_and_rise_as_evenly_as_the_sender_counts(drift: float) -> None:
    random, clock = np.random.default_rng(3), ClockOffset()
    remote = np.arange(0, 60 * S, 2 * MS)
    true = TRUE + remote + np.rint(drift * remote).astype(np.int64)
    local = []
    for index, (stamp, sent, delay) in enumerate(
        zip(remote.tolist(), true.tolist(), delays(random, len(remote)).tolist(), strict=True)
    ):
        clock.arrival(stamp, sent + delay)
        if index % 250 == 0:
            clock.exchange(sent - MS, stamp, sent + MS)
        local.append(clock.to_local(stamp, sent + delay))
    error = np.array(local) - true
    assert np.abs(error[2000:]).max() < 2 * MS
    assert np.all(np.diff(local) > 0)
    assert np.abs(np.diff(local)[2000:] - 2 * MS).max() < 0.1 * MS


def test_the_first_answer_corrects_what_arrivals_said_without_a_stamp_going_back() -> None:
    clock = ClockOffset()
    local = []
    for index in range(1000):
        remote = index * 2 * MS
        arrival = TRUE + remote + 15 * MS
        clock.arrival(remote, arrival)
        if index > 100:
            clock.exchange(arrival - 2 * MS, remote + 14 * MS, arrival)
        local.append(clock.to_local(remote, arrival) - TRUE - remote)
    assert local[100] == 15 * MS
    assert abs(local[-1]) < 0.5 * MS
    assert np.all(np.diff(local) > -2 * MS)


@pytest.mark.parametrize("late_ms", [30, 300])
def test_a_first_message_that_was_held_up_costs_no_later_stamp(late_ms: int) -> None:
    """Also where messages then come in a burst."""
    clock = ClockOffset()
    local = []
    for index in range(3000):
        remote = index * 2 * MS
        arrival = TRUE + max(remote + MS, late_ms * MS + index * 1000)
        clock.arrival(remote, arrival)
        local.append(clock.to_local(remote, arrival))
    assert np.all(np.diff(local) > 0)
    assert local[-1] == pytest.approx(TRUE + remote + MS, abs=MS)


def test_a_sender_that_begins_again_is_followed_at_once() -> None:
    clock = ClockOffset()
    for index in range(1000):
        clock.arrival(index * 10 * MS, TRUE + index * 10 * MS)
    later = TRUE + 30 * S
    clock.arrival(0, later)
    assert clock.to_local(0, later) == later
    assert clock.restarts == 1


@pytest.mark.parametrize("drift", [0.0, -0.8 * DRIFT, 0.6 * DRIFT])
def test_the_line_below_all_arrivals_is_offset_and_drift(drift: float) -> None:
    random = np.random.default_rng(4)
    remote = np.sort(random.integers(0, 600 * S, 20_000))
    true = TRUE + remote + np.rint(drift * remote).astype(np.int64)
    line = line_below(remote, true + delays(random, len(remote)))
    error = line.to_local(remote) - true
    assert np.abs(error - MS).max() < 0.1 * MS


def test_a_line_of_few_arrivals_keeps_to_what_clocks_do() -> None:
    remote = np.array([0, 10 * MS, 20 * MS])
    line = line_below(remote, remote + TRUE + np.array([0, 30 * MS, 500 * MS]))
    assert abs(line.slope) <= DRIFT
    assert line.to_local(remote)[0] == TRUE
    (single,) = line_below(remote[:1], remote[:1] + TRUE).to_local(remote[:1])
    assert single == TRUE


def set_to(clock: ClockOffset, offset_ns: int, at_ns: int, round_trip_ns: int = 0) -> None:
    """Let an exchange say what this clock has over the other."""
    clock.exchange(at_ns - round_trip_ns, at_ns - offset_ns - round_trip_ns // 2, at_ns)


@pytest.mark.parametrize(
    ("error_ms", "moved_ms"),
    [
        # In 20 ms of the sender: by what is left, a half, a twentieth, a thousandth of that time.
        *((49, 10), (-990, -10), (6, 6), (4, 1), (-0.6, -0.6), (0.4, 0.02)),
        # At once.
        *((51, 51), (-1010, -1010)),
    ],
)
def test_an_error_is_removed_at_a_share_of_the_time_that_grows_with_it(
    error_ms: float, moved_ms: float
) -> None:
    clock = ClockOffset()
    set_to(clock, TRUE, TRUE)
    assert clock.to_local(0, TRUE) == TRUE
    set_to(clock, TRUE + round(error_ms * MS), TRUE + 20 * MS)
    moved = clock.to_local(20 * MS, TRUE + 20 * MS) - TRUE - 20 * MS
    assert moved == pytest.approx(moved_ms * MS, abs=0.002 * MS)


@pytest.mark.parametrize(("later_ms", "followed"), [(9, False), (11, True)])
def test_the_offset_is_estimated_every_ten_milliseconds(later_ms: int, followed: bool) -> None:
    clock = ClockOffset()
    set_to(clock, TRUE, TRUE)
    clock.to_local(0, TRUE)
    set_to(clock, TRUE + MS, TRUE + MS)
    at = later_ms * MS
    assert (clock.to_local(at, TRUE + at) != TRUE + at) is followed


def test_an_exchange_counts_for_ten_seconds_while_its_bound_widens_by_the_drift() -> None:
    clock = ClockOffset()
    set_to(clock, TRUE, TRUE)
    estimate = clock.estimate(TRUE + 99 * S // 10)
    assert estimate
    # 100 parts in a million.
    assert estimate.uncertainty_ns == pytest.approx(0.99 * MS, abs=2)
    assert clock.estimate(TRUE + 101 * S // 10) is None


def test_a_round_trip_of_a_second_is_the_longest() -> None:
    clock = ClockOffset()
    set_to(clock, TRUE, TRUE, round_trip_ns=S + 1)
    assert clock.estimate(TRUE) is None
    set_to(clock, TRUE, TRUE, round_trip_ns=S)
    assert clock.estimate(TRUE) is not None


@pytest.mark.parametrize(("others", "known"), [(63, True), (64, False)])
def test_64_exchanges_are_remembered(others: int, known: bool) -> None:
    clock = ClockOffset()
    set_to(clock, TRUE, TRUE)
    for number in range(others):
        set_to(clock, TRUE, TRUE + (number + 1) * MS, round_trip_ns=100 * MS)
    estimate = clock.estimate(TRUE + 100 * MS)
    assert estimate
    assert (estimate.uncertainty_ns < MS) is known


@pytest.mark.parametrize(("seconds", "known"), [(9, True), (10, False)])
def test_the_shortest_delay_of_ten_seconds_counts(seconds: int, known: bool) -> None:
    """Arrivals are gathered by the second."""
    clock = ClockOffset()
    clock.arrival(0, TRUE)
    for number in range(1, seconds + 1):
        clock.arrival(number * S, TRUE + number * S + 30 * MS)
    estimate = clock.estimate(TRUE + seconds * S)
    assert estimate
    assert estimate.offset_ns == TRUE + (0 if known else 30 * MS)


@pytest.mark.parametrize(("back_ms", "restarts"), [(990, 0), (1010, 1)])
def test_a_stamp_more_than_a_second_back_is_a_restart(back_ms: int, restarts: int) -> None:
    clock = ClockOffset()
    clock.arrival(60 * S, TRUE)
    clock.arrival(60 * S - back_ms * MS, TRUE + MS)
    assert clock.restarts == restarts


@pytest.mark.parametrize("drift", [300e-6, -300e-6])
def test_a_line_is_no_steeper_than_quartz_drifts(drift: float) -> None:
    remote = np.arange(0, 600 * S, S)
    line = line_below(remote, remote + TRUE + np.rint(drift * remote).astype(np.int64))
    assert line.slope == np.sign(drift) * 100e-6
