# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of samples: whole, in random order, each sample with its inputs, targets and weights."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from quadpi_core.training.losses import Batches, Samples  # noqa: E402

TABLES, WIDTH, NETWORKS, UNITS = 2, 3, 4, 5
CPU = torch.device("cpu")


def numbered(count: int) -> Samples:
    """Samples of which each number says where it belongs: sample, then table and column."""
    sample = np.arange(count, dtype=np.float32)
    inputs = 100.0 * sample[:, None, None] + np.arange(TABLES * WIDTH).reshape(TABLES, WIDTH)
    targets = -100.0 * sample[:, None, None, None] - np.arange(2 * TABLES).reshape(TABLES, 1, 2)
    unit = (np.arange(count) % UNITS).astype(np.int32)
    omitted = np.eye(NETWORKS, UNITS, dtype=bool)
    return Samples(inputs.astype(np.float32), targets.astype(np.float32), unit, ~omitted, omitted)


def epoch(count: int, size: int, fewest_steps: int = 1, seed: int = 0):
    """Copies of the batches of an epoch: they share memory that the next ones overwrite."""
    batches = Batches(numbered(count), size, CPU)
    random = torch.Generator().manual_seed(seed)
    return [type(b)(*(part.clone() for part in b)) for b in batches.epoch(random, fewest_steps)]


def numbers_of(batches) -> np.ndarray:
    """Numbers of the samples in the order of the batches."""
    return np.concatenate([batch.inputs[0, 0].numpy() for batch in batches]).astype(int) // 100


@pytest.mark.parametrize(("count", "size", "steps"), [(40, 10, 4), (47, 10, 4), (700, 10, 70), (7, 10, 1)])
def test_an_epoch_passes_each_sample_once_but_for_a_rest(count: int, size: int, steps: int) -> None:
    batches = epoch(count, size)
    assert len(batches) == steps
    seen = numbers_of(batches)
    assert len(seen) == len(set(seen)) == steps * min(size, count)
    assert seen.tolist() != sorted(seen)


def test_few_samples_are_passed_several_times() -> None:
    batches = epoch(20, 10, fewest_steps=5)
    assert len(batches) == 5
    assert sorted(np.bincount(numbers_of(batches)[:40])) == [2] * 20


def test_numbers_of_a_sample_stay_together() -> None:
    samples = numbered(47)
    for batch in epoch(47, 10):
        rows = (batch.inputs[0, 0].numpy() // 100).astype(int)
        np.testing.assert_array_equal(batch.inputs[:, :-1].numpy(), samples.inputs[rows].transpose(1, 2, 0))
        np.testing.assert_array_equal(batch.inputs[:, -1].numpy(), 1.0)
        np.testing.assert_array_equal(batch.targets.numpy(), samples.targets[rows].transpose(1, 2, 3, 0))
        flags = samples.trained[:, samples.unit[rows]]
        weights = flags / np.maximum(flags.sum(axis=1, keepdims=True), 1)
        np.testing.assert_allclose(batch.weights.numpy(), weights, rtol=1e-6)


def test_a_network_that_sees_nothing_has_no_weight() -> None:
    batches = Batches(numbered(10), 5, CPU)
    batch = batches.chosen(torch.tensor([0, 1, 6]), batches.judged)
    # Samples 0, 1 and 6 are of units 0, 1 and 1, each of which one network leaves out.
    np.testing.assert_array_equal(
        batch.weights.numpy(), [[1.0, 0.0, 0.0], [0.0, 0.5, 0.5], [0.0] * 3, [0.0] * 3]
    )
