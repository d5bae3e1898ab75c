# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks keep the extremes of what they hold, in a ring of bounded size."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from quadpi_core.view.blocks import (
    BINS,
    FIRST_BIN_S,
    LONGEST_GAP_NS,
    PAUSE_NS,
    POINTS,
    BlockStore,
    FlightClock,
    Timeline,
    Track,
    quantities,
)
from quadpi_core.view.trust import State

BLOCK_NS = 50_000_000


def filled(seconds: float, parts: int, seed: int = 0) -> tuple[BlockStore, np.ndarray, np.ndarray]:
    """500 Hz of noise in so many batches, with the samples and their stamps."""
    count = round(500 * seconds)
    time_ns = np.arange(count) * 2_000_000
    measured = np.random.default_rng(seed).normal(size=(count, 6))
    store = BlockStore(BLOCK_NS, 100)
    store.add_model()
    for rows in np.array_split(np.arange(count), parts):
        store.add(
            time_ns[rows],
            measured=measured[rows],
            model_0__count=np.ones(len(rows)),
            position=measured[rows, :3],
        )
    return store, time_ns, measured


def test_last_values_and_sums_are_those_of_the_samples_of_each_block():
    store, time_ns, measured = filled(3.0, 7)
    for block in range(store.oldest, store.newest + 1):
        inside = measured[time_ns // BLOCK_NS == block]
        assert_allclose(store.value(block, "measured"), inside[-1], rtol=1e-6)
        assert_allclose(store.value(block, "position"), inside[-1, :3], rtol=1e-6)
        assert store.value(block, "0.count")[0] == 25


def test_batches_do_not_matter():
    one, other = filled(4.0, 1)[0], filled(4.0, 143)[0]
    np.testing.assert_array_equal(one.get(0, 1000)[1], other.get(0, 1000)[1])


def test_the_ring_keeps_the_newest_and_its_size():
    store, _, _ = filled(20.0, 400)
    assert (store.oldest, store.newest) == (300, 399)
    first, rows = store.get(0, 10_000)
    assert first == 300
    assert rows.shape == (100, sum(one.width for one in quantities(models=1, rotors=4)))
    assert np.isnan(store.value(299, "measured")).all()


def test_a_gap_is_no_number_and_old_blocks_do_not_show_through():
    store, _, _ = filled(5.0, 5)
    store.add(np.array([7_000_000_000]), measured=np.ones((1, 6)))
    assert np.isnan(store.get(100, 139)[1]).all()
    store.add(np.array([3_600_000_000_000]), speed=np.ones(1))
    assert np.isnan(store.get(store.oldest, store.newest - 1)[1]).all()


def test_late_samples_find_their_block_and_too_late_ones_are_left_out():
    store, _, _ = filled(20.0, 10)
    store.take_changed()
    store.add(np.array([400 * BLOCK_NS - 1, 310 * BLOCK_NS]), speed=np.array([2.0, 3.0]))
    assert store.value(310, "speed")[0] == 3.0
    assert store.take_changed() == 310
    store.add(np.array([5 * BLOCK_NS, -1]), speed=np.array([9.0, 9.0]))
    assert store.take_changed() is None


def test_shares_inside_are_those_of_blocks_that_were_judged():
    store = BlockStore(BLOCK_NS, 100)
    store.add_model()
    times = np.arange(100) * BLOCK_NS
    misses = np.zeros((100, 6))
    misses[:, 1] = 1.0
    misses[60:, 2] = 1.0
    judged = (np.arange(100) >= 50).astype(float)
    store.add(times, model_0__count=np.full(100, 4.0), model_0__misses=misses, judged=judged)
    assert_allclose(store.inside(99, 0, 10.0, 2.0), [1.0, 0.75, 0.8, 1.0, 1.0, 1.0])
    assert_allclose(store.inside(99, 0, 1.0, 1.0)[:3], [1.0, 0.75, 0.75])
    assert np.isnan(store.inside(88, 0, 10.0, 2.0)).all()


def test_what_changed_is_said_once():
    store, _, _ = filled(1.0, 1)
    assert store.take_changed() == 0
    assert store.take_changed() is None
    store.add(np.array([1_000_000_000]), speed=np.ones(1))
    assert store.take_changed() == 20


def test_another_number_of_rotors_moves_nothing_else():
    store, *_ = filled(1.0, 3)
    before = {name: store.value(7, name) for name in ("measured", "position", "0.count")}
    store.set_rotors(6)
    speeds = np.arange(6.0)[None] + 700.0
    store.add(np.array([7 * BLOCK_NS]), rotors=speeds)
    assert store.value(7, "rotors").tolist() == speeds[0].tolist()
    for name, values in before.items():
        np.testing.assert_array_equal(store.value(7, name), values)
    store.set_rotors(4)
    assert store.value(7, "rotors").tolist() == speeds[0, :4].tolist()


def test_a_model_that_comes_later_has_columns_of_its_own():
    store, _, _ = filled(1.0, 1)
    before = store.value(3, "measured").copy()
    assert store.add_model() == 1
    store.add(np.array([3 * BLOCK_NS]), model_1__count=np.ones(1))
    assert store.value(3, "1.count")[0] == 1
    assert store.value(3, "0.count")[0] == 25
    np.testing.assert_array_equal(store.value(3, "measured"), before)


# A session of any length at a glance.


def test_the_worst_state_of_a_bin_is_shown():
    line = Timeline()
    states = [State.TRUSTED, State.ALARM, State.WARNING, State.NOT_JUDGED, State.NO_DATA, State.TRUSTED]
    line.add(FIRST_BIN_S * np.array([0.1, 0.2, 0.3, 2.1, 2.2, 2.3]), np.array(states, dtype=np.uint8))
    assert line.codes == f"{State.ALARM}-{State.NO_DATA}"


@pytest.mark.parametrize("hours", [0.05, 1.0, 24.0])
def test_an_alarm_of_a_moment_is_seen_after_any_time_in_bounded_room(hours):
    line = Timeline()
    time_s = np.arange(0.0, 3600.0 * hours, 1.0)
    states = np.full(len(time_s), int(State.TRUSTED), dtype=np.uint8)
    states[len(states) // 3] = State.ALARM
    line.add(time_s, states)
    assert len(line.codes) <= BINS
    assert line.codes.count(str(int(State.ALARM))) == 1
    place = line.codes.index(str(int(State.ALARM)))
    assert place * line.bin_s <= time_s[len(states) // 3] < (place + 1) * line.bin_s


def test_the_track_spans_the_session_with_bounded_points():
    track = Track()
    for start in range(0, 7200, 10):
        time_s = start + np.arange(0.0, 10.0, 0.002)
        track.add(time_s, np.stack((time_s, 0 * time_s, -time_s), axis=1))
    points = np.array(track.points)
    assert POINTS / 3 < len(points) < POINTS
    assert points[0, 0] == 0.0
    assert points[-1, 0] > 7180.0
    np.testing.assert_allclose(points[:, 1], points[:, 0], atol=0.02)
    assert np.diff(points[:, 0]).min() > 1.0


# Time of the page runs on where stamps jump.


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
