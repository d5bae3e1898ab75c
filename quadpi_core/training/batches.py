# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Samples on a device, brought together batch by batch for all networks that are trained on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

Floats: TypeAlias = npt.NDArray[np.float32]
Flags: TypeAlias = npt.NDArray[np.bool_]

# Steps whose samples are brought together at a time.
_STEPS_TOGETHER = 64


@dataclass(frozen=True)
class Samples:
    """What A tables with M networks each are trained on.

    Attributes:
        inputs: (N, A, D) standardised.
        targets: (N, A, T, C): C numbers per sample, the same for all networks (T = 1) or for each (T = M).
        unit: (N,) unit of each sample; units are in or out as a whole.
        trained: (M, U) units that a network is trained on.
        judged: (M, U) units that judge it after each epoch.
    """

    inputs: Floats
    targets: Floats
    unit: npt.NDArray[np.int32]
    trained: Flags
    judged: Flags


class Batch(NamedTuple):
    """Samples for all networks: n of a step, or of many steps with one more axis in front.

    Attributes:
        inputs: (A, K, n), the last of the K being one, for the bias.
        targets: (A, T, C, n).
        weights: (M, n), of each network adding up to one over the samples that it sees.
    """

    inputs: Tensor
    targets: Tensor
    weights: Tensor


class Batches:
    """Batches of `size` samples from samples kept on a device."""

    def __init__(self, samples: Samples, size: int, device: torch.device) -> None:
        count, tables, width = samples.inputs.shape
        self.size = min(size, count)
        self.input_shape = (tables, width + 1)
        self.target_shape = samples.targets.shape[1:]
        # The numbers of a sample lie together: samples in random order are slow to reach, not to copy.
        ones = np.ones((count, tables, 1), dtype=np.float32)
        inputs = np.concatenate((samples.inputs, ones), axis=2).reshape(count, -1)
        rows = np.concatenate((inputs, samples.targets.reshape(count, -1)), axis=1)
        self.rows = torch.from_numpy(rows).to(device)
        self.unit = torch.from_numpy(samples.unit).to(device)
        self.trained, self.judged = (
            torch.from_numpy(np.ascontiguousarray(flags, dtype=np.float32)).to(device)
            for flags in (samples.trained, samples.judged)
        )
        # Allocated once: fresh memory costs more than writing to it.
        together = _STEPS_TOGETHER * self.size
        self._rows = torch.empty((together, rows.shape[1]), device=device)
        self._weights = torch.empty(len(samples.trained) * together, device=device)

    def __len__(self) -> int:
        return len(self.rows)

    def epoch(self, random: torch.Generator, fewest_steps: int) -> Iterator[Batch]:
        """All samples in random order, several times if they are few, but for a rest smaller than a batch."""
        steps = max(len(self) // self.size, fewest_steps)
        rounds = -(-steps * self.size // len(self))
        order = torch.cat([torch.randperm(len(self), generator=random) for _ in range(rounds)])
        for chosen in order[: steps * self.size].split(_STEPS_TOGETHER * self.size):
            together = self._gather(chosen.to(self.rows.device))
            yield from map(Batch, *(part.unbind() for part in together))

    def _gather(self, chosen: Tensor) -> Batch:
        """The chosen samples as whole steps (S, …)."""
        networks, count = len(self.trained), len(chosen)
        rows = torch.index_select(self.rows, 0, chosen, out=self._rows[:count])
        weights = self._weights[: networks * count].view(networks, count)
        torch.index_select(self.trained, 1, self.unit.index_select(0, chosen), out=weights)
        steps = (-1, self.size)
        return self._batch(rows.unflatten(0, steps), weights.unflatten(1, steps).transpose(0, 1))

    def chosen(self, chosen: Tensor, flags: Tensor) -> Batch:
        """The chosen samples as one batch, with `trained` or `judged` as flags (M, U)."""
        return self._batch(self.rows[chosen], flags.index_select(1, self.unit[chosen]))

    def inputs(self) -> Tensor:
        """Inputs (A, K, N) of all samples."""
        return self._inputs(self.rows.T)

    def targets(self) -> Tensor:
        """Targets (A, T, C, N) of all samples."""
        return self._targets(self.rows.T)

    def _inputs(self, columns: Tensor) -> Tensor:
        tables, width = self.input_shape
        return columns[..., : tables * width, :].unflatten(-2, self.input_shape)

    def _targets(self, columns: Tensor) -> Tensor:
        tables, width = self.input_shape
        return columns[..., tables * width :, :].contiguous().unflatten(-2, self.target_shape)

    def _batch(self, rows: Tensor, weights: Tensor) -> Batch:
        columns = rows.transpose(-1, -2)
        weights.div_(weights.sum(-1, keepdim=True).clamp_(min=1.0))
        return Batch(self._inputs(columns), self._targets(columns), weights)
