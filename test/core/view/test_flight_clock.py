# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Time of the page runs on where stamps jump."""

from __future__ import annotations

import numpy as np

from quadpi_core.view.blocks import LONGEST_GAP_NS, PAUSE_NS, FlightClock

START, S = 1_700_000_000_000_000_000, 1_000_000_000


def clock() -> tuple[FlightClock, list[tuple[int, int]]]:
    jumps: list[tuple[int, int]] = []
    return FlightClock(lambda time_ns, step_ns: jumps.append((time_ns, step_ns))), jumps


def test_time_begins_with_the_first_stamp():
    one, jumps = clock()
    assert not one.started
    assert one.advance(START + np.array([0, S, 3 * S])).tolist() == [0, S, 3 * S]
    assert one.started
    assert jumps == []


def test_a_step_back_or_a_long_pause_becomes_a_short_one():
    one, jumps = clock()
    one.advance(np.array([START, START + 10 * S]))
    back = one.advance(np.array([START + 2 * S, START + 3 * S]))
    assert back.tolist() == [10 * S + PAUSE_NS, 11 * S + PAUSE_NS]
    later = one.advance(np.array([START + 3 * S + 2 * LONGEST_GAP_NS]))
    assert later.tolist() == [11 * S + 2 * PAUSE_NS]
    assert [step for _, step in jumps] == [-8 * S, 2 * LONGEST_GAP_NS]


def test_a_jump_within_a_batch_is_found():
    one, jumps = clock()
    assert one.advance(START + np.array([0, S, -90 * S, -89 * S])).tolist() == [
        0,
        S,
        S + PAUSE_NS,
        2 * S + PAUSE_NS,
    ]
    assert jumps == [(S + PAUSE_NS, -91 * S)]


def test_jitter_and_gaps_are_no_jumps():
    one, jumps = clock()
    stamps = START + np.array([0, S, S - 900_000_000, 40 * S])
    assert one.advance(stamps).tolist() == (stamps - START).tolist()
    assert jumps == []


def test_other_stamps_follow_the_leading_ones_and_far_ones_are_left_out():
    one, _ = clock()
    assert not one.place(np.array([START]))[1].any()
    one.advance(np.array([START, START + 10 * S]))
    one.advance(np.array([START]))
    times, near = one.place(START + np.array([0, 2 * S, 100 * S]))
    assert times[near].tolist() == [10 * S + PAUSE_NS, 12 * S + PAUSE_NS]
    assert near.tolist() == [True, True, False]
