# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Training of many networks at once: as each alone, repeatable, and kept at their best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training needs PyTorch")

from quadpi_core.errors import ModelError  # noqa: E402
from quadpi_core.training import train as training_module  # noqa: E402
from quadpi_core.training.losses import Loss, SquaredError  # noqa: E402
from quadpi_core.training.train import Parts, Training, TrainingState, table_blocks, train  # noqa: E402

from .small_trainings import (  # noqa: E402
    COUNT,
    NETWORKS,
    SCHEDULE,
    TABLES,
    WIDTH,
    gaussian,
    quality_driven,
    samples_for,
    steps,
)


@pytest.mark.parametrize("loss", [SquaredError(), gaussian(), quality_driven()], ids=str)
def test_gradient_by_parameters_is_that_of_autograd(loss: Loss) -> None:
    training = Training(samples_for(loss), loss, SCHEDULE)
    batch = steps(training)[0]
    training.differentiate(batch)
    hidden, output, biases = (part.clone().requires_grad_() for part in training.weights)
    active = torch.einsum("akmh,akn->amhn", hidden, batch.inputs).relu()
    outputs = torch.einsum("amqh,amhn->amqn", output, active) + biases[..., None]
    value = loss.value(outputs, batch.targets, batch.weights).sum()
    expected = torch.autograd.grad(value, (hidden, output, biases))
    for found, wanted in zip(training.parts(training.gradient), expected, strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-6)


def test_one_batch_trains_each_network_as_a_loop_over_networks_would() -> None:
    training = Training(samples_for(SquaredError()), SquaredError(), SCHEDULE)
    hidden, output, biases = (part.clone() for part in training.weights)
    batches = [batch for _ in range(3) for batch in steps(training)]
    for batch in batches:
        training.step(batch)
    for table in range(TABLES):
        for member in range(NETWORKS):
            first, last = torch.nn.Linear(WIDTH, 6), torch.nn.Linear(6, 1)
            with torch.no_grad():
                first.weight.copy_(hidden[table, :-1, member].T)
                first.bias.copy_(hidden[table, -1, member])
                last.weight.copy_(output[table, member])
                last.bias.copy_(biases[table, member])
            network = torch.nn.Sequential(first, torch.nn.ReLU(), last)
            adam = torch.optim.Adam(network.parameters(), lr=SCHEDULE.learning_rate)
            for batch in batches:
                mine = batch.weights[member] > 0
                inputs, targets = batch.inputs[table, :-1, mine].T, batch.targets[table, 0, :, mine].T
                adam.zero_grad()
                (0.5 * torch.nn.functional.mse_loss(network(inputs), targets)).backward()
                adam.step()
            trained = training.weights
            torch.testing.assert_close(trained[0][table, :-1, member].T, first.weight, rtol=1e-4, atol=1e-5)
            torch.testing.assert_close(trained[0][table, -1, member], first.bias, rtol=1e-4, atol=1e-5)
            torch.testing.assert_close(trained[1][table, member], last.weight, rtol=1e-4, atol=1e-5)
            torch.testing.assert_close(trained[2][table, member], last.bias, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("loss", [SquaredError(), gaussian(), quality_driven()], ids=str)
def test_training_again_gives_the_same_numbers_on_any_number_of_threads(
    loss: Loss, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_module, "_THREADS", 3)
    threads = torch.get_num_threads()
    try:
        trained = []
        for count in (1, 1, 2, 3):
            torch.set_num_threads(count)
            trained.append(train(samples_for(loss), loss, SCHEDULE).parameters)
    finally:
        torch.set_num_threads(threads)
    assert all(torch.equal(trained[0], other) for other in trained[1:])
    assert not torch.equal(train(samples_for(loss), loss, replace(SCHEDULE, seed=4)).parameters, trained[0])


def test_training_takes_one_thread_and_leaves_the_number_as_it_was() -> None:
    threads, seen = torch.get_num_threads(), []
    try:
        torch.set_num_threads(3)
        with pytest.raises(KeyboardInterrupt):
            train(samples_for(SquaredError()), SquaredError(), SCHEDULE, report=interrupt(seen))
        after = torch.get_num_threads()
    finally:
        torch.set_num_threads(threads)
    assert seen == [1]
    assert after == 3


@pytest.mark.parametrize(("networks", "sizes"), [(70, [1] * 6), (20, [2, 2, 2]), (15, [3, 3]), (5, [6])])
def test_as_few_tables_are_computed_together_as_fit_in_the_cache(networks: int, sizes: list[int]) -> None:
    shapes = ((6, 13, networks, 20), (6, networks, 1, 20), (6, networks, 1))
    blocks = table_blocks(Parts(*(torch.empty(shape) for shape in shapes)), 500)
    assert [block.stop - block.start for block in blocks] == sizes
    assert [table for block in blocks for table in range(block.start, block.stop)] == list(range(6))


def interrupt(seen: list[int]) -> Callable[[TrainingState], None]:
    def report(progress: TrainingState) -> None:  # noqa: ARG001
        seen.append(torch.get_num_threads())
        raise KeyboardInterrupt

    return report


@pytest.mark.parametrize("together", [500, 128])
def test_numbers_of_the_networks_give_what_pytorch_predicts(
    together: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training_module, "_TOGETHER", together)
    samples = samples_for(quality_driven())
    training = train(samples, quality_driven(), SCHEDULE)
    predictions = training.predictions(slice(1, 3))
    assert predictions.shape == (TABLES, 2, 2, COUNT)
    for table, networks in enumerate(training.networks()):
        expected = networks[1:].outputs(samples.inputs[:, table].astype(float))
        np.testing.assert_allclose(predictions[table].swapaxes(1, 2), expected, rtol=0, atol=1e-5)


def test_a_network_does_not_depend_on_samples_that_it_is_not_trained_on() -> None:
    samples = samples_for(SquaredError())
    targets = samples.targets.copy()
    targets[samples.unit == 0] += 100.0
    schedule = replace(SCHEDULE, keep="last")
    trained, altered = (
        train(each, SquaredError(), schedule).weights for each in (samples, replace(samples, targets=targets))
    )
    # The first network leaves unit 0 out.
    assert torch.equal(trained[0][:, :, 0], altered[0][:, :, 0])
    assert not torch.equal(trained[0][:, :, 1], altered[0][:, :, 1])


@pytest.mark.parametrize("keep", ["best", "best on average"])
def test_networks_are_kept_as_they_were_when_judged_best(keep: str) -> None:
    loss = SquaredError()
    schedule = replace(SCHEDULE, learning_rate=0.5, epochs=8, keep=keep)
    scores = []
    for epochs in range(1, schedule.epochs + 1):
        scores.append(
            train(samples_for(loss), loss, replace(schedule, epochs=epochs, keep="last")).judge()[1]
        )
    seen = torch.stack(scores)
    if keep == "best":
        expected = seen.min(0).values
    else:
        best = seen.mean(-1).argmin(0)
        expected = torch.stack([seen[best[table], table] for table in range(TABLES)])
    torch.testing.assert_close(train(samples_for(loss), loss, schedule).judge()[1], expected)
    assert not torch.equal(expected, seen[-1])


def test_bounds_start_around_trained_regressors() -> None:
    samples = samples_for(SquaredError())
    start = train(samples, SquaredError(), replace(SCHEDULE, epochs=30))
    bounds = Training(samples, quality_driven(), SCHEDULE, start).predictions(slice(None))
    middle = start.predictions(slice(None))[:, :, 0]
    np.testing.assert_allclose(bounds.mean(axis=2), middle, atol=1e-5)
    error = np.sqrt(2.0 * start.judge()[0].numpy())
    np.testing.assert_allclose(bounds[:, :, 1, 0] - middle[..., 0], 1.96 * error, rtol=1e-3)


def test_each_epoch_is_reported() -> None:
    reports: list[TrainingState] = []
    train(samples_for(SquaredError()), SquaredError(), SCHEDULE, "members", reports.append)
    assert [(r.stage, r.epoch, r.epochs) for r in reports] == [("members", 1, 2), ("members", 2, 2)]
    assert reports[1].loss < reports[0].loss
    assert reports[1].coverage is not None
    assert 0.8 < reports[1].coverage <= 1.0
    nothing = samples_for(SquaredError())
    nothing = replace(nothing, judged=np.zeros_like(nothing.judged))
    train(nothing, SquaredError(), SCHEDULE, "members", reports.append)
    assert reports[-1].coverage is None


def test_unknown_device_is_named() -> None:
    with pytest.raises(ModelError, match="'tpu'"):
        train(samples_for(SquaredError()), SquaredError(), replace(SCHEDULE, device="tpu"))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs CUDA")
@pytest.mark.parametrize("loss", [SquaredError(), quality_driven()], ids=str)
def test_a_graphics_card_gives_what_the_processor_gives(loss: Loss) -> None:
    here, there = (
        train(samples_for(loss), loss, replace(SCHEDULE, device=device)).parameters.cpu()
        for device in ("cpu", "cuda")
    )
    torch.testing.assert_close(here, there, rtol=1e-2, atol=1e-3)
