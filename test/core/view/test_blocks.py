# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Blocks keep the extremes of what they hold, in a ring of bounded size."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from quadpi_core.view.blocks import BlockStore, quantities

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
