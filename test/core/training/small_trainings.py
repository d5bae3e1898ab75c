# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Losses, samples and a schedule so small that each step can be followed."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from quadpi_core.training.losses import Batch, GaussianNoise, Loss, QualityDriven, Samples, SquaredError  # noqa: E402  # noqa: E402
from quadpi_core.training.train import Schedule, Training  # noqa: E402

TABLES, NETWORKS, WIDTH, COUNT = 2, 3, 4, 300
SCHEDULE = Schedule(
    hidden=6,
    epochs=2,
    batch=60,
    fewest_steps=1,
    learning_rate=1e-2,
    keep="last",
    seed=3,
    device="cpu",
)
FORMS = ("sqrt-n", "paper", "pearce")


def quality_driven(form: str = "sqrt-n", crossing: float = 2.0) -> QualityDriven:
    return QualityDriven(0.9, 60, form, 0.7, 8.0, crossing)


def gaussian() -> GaussianNoise:
    return GaussianNoise(torch.full((TABLES, 1), 0.05))


LOSSES = (SquaredError(), gaussian(), *(quality_driven(form) for form in FORMS))


def samples_for(loss: Loss, seed: int = 0) -> Samples:
    """Two tables, three networks that leave out a unit each; targets for each network or for all."""
    rng = np.random.default_rng(seed)
    inputs = rng.normal(size=(COUNT, TABLES, WIDTH)).astype(np.float32)
    if isinstance(loss, GaussianNoise):
        targets = rng.gamma(1.0, size=(COUNT, TABLES, NETWORKS, 2))
    else:
        targets = np.sin(inputs[:, :, 0]) + 0.3 * rng.normal(size=(COUNT, TABLES))
        targets = targets[:, :, None, None]
    omitted = np.eye(NETWORKS, 5, dtype=bool)
    unit = rng.integers(0, 5, size=COUNT).astype(np.int32)
    return Samples(inputs, targets.astype(np.float32), unit, ~omitted, omitted)


def steps(training: Training) -> list[Batch]:
    """Batches of an epoch, each with memory of its own."""
    return [Batch(*(part.clone() for part in batch)) for batch in training.batches.epoch(training.random, 1)]
