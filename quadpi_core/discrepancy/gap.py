# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far simulation and flights lie apart, before and after, on flights that were not used to find it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.design import Design
from quadpi_core.flight import AXES
from quadpi_core.frames import Array


class Gap(NamedTuple):
    """Root-mean-square differences up to the band of the comparison, order as `AXES`, N and Nm.

    Attributes:
        before, after: (6,) of measured and simulated wrench, each flight with what the others found.
        floor: (6,) of the noise: what no simulation can close.
        reduction: share of the removable gap that was closed, all axes in units of their noise.
    """

    before: Array
    after: Array
    floor: Array
    reduction: float


def gap(design: Design, chosen: Sequence[int]) -> Gap:
    """The gap of each flight with parameters found on all others."""
    spectra = design.spectra()
    before, after, floor = np.zeros(len(AXES)), np.zeros(len(AXES)), np.zeros(len(AXES))
    samples = 0
    for place, weights in enumerate(left_out_weights(design, chosen)):
        rows = spectra[place].rows
        before += np.square(rows[:, :, 0]).sum(axis=1)
        after += np.square(rows @ weights).sum(axis=1)
        floor += design.noise[:, spectra[place].band].sum(axis=1)
        samples += len(design.flights[place].thinned)
    removable = np.sum(np.maximum(before - floor, 0.0) / floor)
    kept = np.sum((after - floor) / floor)
    return Gap(
        before=np.sqrt(before / samples),
        after=np.sqrt(after / samples),
        floor=np.sqrt(floor / samples),
        reduction=float(1.0 - kept / removable) if removable > 0.0 else 0.0,
    )


def left_out_weights(design: Design, chosen: Sequence[int]) -> list[Array]:
    """Per flight the weight (K,) of each column in what is left of its residual by a fit of all others."""
    weights = []
    for own in design.per_flight:
        others = design.gram - own
        found = design.fit(chosen, others, form=False) or design.fit((), others)
        assert found is not None  # without effects there is always a fit
        weights.append(design.weights(found))
    return weights
