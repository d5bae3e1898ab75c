# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far simulation and flights lie apart, before and after, on flights that were not used to find it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.evidence import residual_weights
from quadpi_core.discrepancy.shape_fit import Closing
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


def gap(closing: Closing) -> Gap:
    """The gap of each flight with what all others tell; as it is where no effect was chosen.

    Coefficients alone are not moved: without an effect that is missing they would go beyond their tolerances.
    """
    design, chosen = closing.design, closing.chosen
    before, after, floor = np.zeros(len(AXES)), np.zeros(len(AXES)), np.zeros(len(AXES))
    samples = 0
    unchanged = residual_weights(1, ())
    for place, found in enumerate(closing.left_out):
        before += np.square(design.combined(place, unchanged)).sum(axis=1)
        after += np.square(design.combined(place, found.left if chosen else unchanged)).sum(axis=1)
        floor += design.noise[:, design.bands[place]].sum(axis=1)
        samples += len(design.flights[place].thinned)
    removable = np.sum(np.maximum(before - floor, 0.0) / floor)
    kept = np.sum(np.maximum(after - floor, 0.0) / floor)
    return Gap(
        before=np.sqrt(before / samples),
        after=np.sqrt(after / samples),
        floor=np.sqrt(floor / samples),
        reduction=float(1.0 - kept / removable) if removable > 0.0 else 0.0,
    )
