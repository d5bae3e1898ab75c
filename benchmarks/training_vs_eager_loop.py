# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Ten networks of 12 inputs and 20 hidden units: trained as one batch, against PyTorch in two ways.

The loop is what one writes for a single network, `torch.nn.Sequential`, `torch.optim.Adam`, mean square error
and batches taken by index from shuffled samples, once per network. All its epochs cost the same: one of them
is timed and multiplied. It gets one thread or PyTorch's usual number, whichever suits it better; training
takes one, and is timed as a whole, from plain arrays to trained networks.

The second rival is what PyTorch does by itself for all networks at once: one batch of matrix products, their
gradients by autograd, and its fused Adam. Ours differs in gradients written by hand, in memory that is taken
once.

Every network sees every sample, in batches of 400: all do the same steps with the same number of
samples. Beside it stands the ratio for the bootstrap ensemble's subsets of 80 %, where a network takes its
own 400 samples of the 500 of a step, and the loop has a fifth less to do.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from benchmarks import Result, UnavailableError, interleaved_seconds
from quadpi_core.models.ensemble import Plan

NAMES = ("training_vs_eager_loop", "training_vs_batched_autograd")

MEMBERS, INPUTS, HIDDEN, SAMPLES, BATCH, EPOCHS, RATE = 10, 12, 20, 100_000, 400, 50, 1e-3
SUBSET = 0.8

Floats = npt.NDArray[np.float32]


def run() -> list[Result]:
    try:
        import torch
    except ImportError as error:
        raise UnavailableError("PyTorch is not installed") from error
    inputs, targets = smooth_samples()
    one_unit = np.zeros(SAMPLES, dtype=np.int32)
    plan = Plan.make(one_unit.astype(np.int64), MEMBERS, SUBSET, "sample", folds=0, seed=0)
    usual = torch.get_num_threads()
    threads = faster_threads(lambda count: eager_epoch(inputs, targets, 1, count), usual)
    batch_threads = faster_threads(lambda count: autograd_epoch(inputs, targets, count), usual)
    try:
        loop, autograd, batched, subsets = interleaved_seconds(
            (
                lambda: eager_epoch(inputs, targets, MEMBERS, threads),
                lambda: autograd_epoch(inputs, targets, batch_threads),
                lambda: batched_training(inputs, targets, np.ones((MEMBERS, 1), dtype=bool), one_unit, BATCH),
                lambda: batched_training(inputs, targets, plan.trained, plan.unit, round(BATCH / SUBSET)),
            ),
            repetitions=3,
        ).T
    finally:
        torch.set_num_threads(usual)
    loop *= EPOCHS
    autograd *= EPOCHS
    baseline = (
        f"eager PyTorch {torch.__version__} with {threads} of {usual} threads: {np.median(loop):.0f} s, "
        f"scaled from 1 of {EPOCHS} epochs; ours {np.median(batched):.2f} s; on subsets of {SUBSET:.0%} "
        f"{np.median(SUBSET * loop / subsets):.1f} times faster"
    )
    in_one_batch = (
        f"batched autograd with {batch_threads} of {usual} threads: {np.median(autograd):.1f} s, "
        f"scaled from 1 of {EPOCHS} epochs"
    )
    return [
        Result(NAMES[0], float(np.median(loop / batched)), "times faster", baseline, goal=30.0),
        Result(NAMES[1], float(np.median(autograd / batched)), "times faster", in_one_batch, goal=2.0),
    ]


def faster_threads(epoch: Callable[[int], None], usual: int) -> int:
    """One thread or PyTorch's usual number, whichever an epoch takes less time with."""
    by_threads = [lambda count=count: epoch(count) for count in (1, usual)]
    return (1, usual)[int(np.argmin(interleaved_seconds(by_threads, repetitions=3).min(axis=0)))]


def smooth_samples() -> tuple[Floats, Floats]:
    """Standardised inputs (N, 12) and target (N,) with some noise."""
    rng = np.random.default_rng(1)
    inputs = rng.normal(size=(SAMPLES, INPUTS))
    targets = np.sin(inputs[:, 0]) + inputs[:, 1] * inputs[:, 2] + 0.1 * rng.normal(size=SAMPLES)
    return inputs.astype(np.float32), ((targets - targets.mean()) / targets.std()).astype(np.float32)


def eager_epoch(inputs: Floats, targets: Floats, members: int, threads: int) -> None:
    """An epoch of some networks, one after the other."""
    import torch
    from torch import nn

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    X, y = torch.from_numpy(inputs), torch.from_numpy(targets)[:, None]
    loss_of = nn.MSELoss()
    for _ in range(members):
        network = nn.Sequential(nn.Linear(INPUTS, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, 1))
        adam = torch.optim.Adam(network.parameters(), lr=RATE)
        for batch in torch.randperm(SAMPLES).split(BATCH):
            adam.zero_grad()
            loss_of(network(X[batch]), y[batch]).backward()
            adam.step()


def autograd_epoch(inputs: Floats, targets: Floats, threads: int) -> None:
    """An epoch of all networks as one batch of matrix products, their gradients by autograd."""
    import torch

    torch.set_num_threads(threads)
    torch.manual_seed(0)
    X, y = torch.from_numpy(inputs), torch.from_numpy(targets)[:, None]
    shapes = ((MEMBERS, INPUTS, HIDDEN), (MEMBERS, 1, HIDDEN), (MEMBERS, HIDDEN, 1), (MEMBERS, 1, 1))
    weights, biases, weights_out, biases_out = parameters = [
        torch.nn.Parameter(0.3 * torch.randn(shape)) for shape in shapes
    ]
    adam = torch.optim.Adam(parameters, lr=RATE, fused=True)
    for batch in torch.randperm(SAMPLES).split(BATCH):
        adam.zero_grad()
        hidden = torch.baddbmm(biases, X[batch].expand(MEMBERS, -1, -1), weights).relu()
        outputs = torch.baddbmm(biases_out, hidden, weights_out)
        (outputs - y[batch]).square().mean(dim=1).sum().backward()
        adam.step()


def batched_training(
    inputs: Floats, targets: Floats, trained: npt.NDArray[np.bool_], unit: npt.NDArray[np.int32], batch: int
) -> None:
    """All epochs of all networks, each on its units of the samples, `trained` (M, U)."""
    from quadpi_core.training.losses import Samples, SquaredError
    from quadpi_core.training.train import Schedule, train

    samples = Samples(inputs[:, None], targets[:, None, None, None], unit, trained, ~trained)
    schedule = Schedule(HIDDEN, EPOCHS, batch, 1, RATE, keep="last", seed=0, device="cpu")
    training = train(samples, SquaredError(), schedule)
    error = float(np.sqrt(2.0 * training.judge()[0].numpy().max()))
    if not error < 0.3:
        raise RuntimeError(f"networks are off by {error:.2f} standard deviations after training")
