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
