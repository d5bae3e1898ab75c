# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How far simulation and flights lie apart, before and after, on flights that were not used to find it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.design import Design
from quadpi_core.discrepancy.evidence import Fit, residual_weights
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


def gap(design: Design, chosen: Sequence[int], shaped: Sequence[int]) -> Gap:
    """The gap of each flight with parameters found on all others; as it is where no effect was chosen.

    Coefficients alone are not moved: without an effect that is missing they would go beyond their tolerances.

    Args:
        design: of the flights.
        chosen: indices of the candidates that were named.
        shaped: those of them whose laws flights shape, see :func:`shaped_by_flights`.
    """
    before, after, floor = np.zeros(len(AXES)), np.zeros(len(AXES)), np.zeros(len(AXES))
    samples = 0
    unchanged = residual_weights(1, ())
    for place, found in enumerate(left_out_fits(design, chosen, shaped)):
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


def shaped_by_flights(design: Design, chosen: Sequence[int]) -> tuple[int, ...]:
    """Those chosen whose laws flights may shape, if that brings flights that are left out closer."""
    # What is not in proportion to its parameters is shaped by them.
    laws = [design.candidates[index] for index in chosen]
    shaped = tuple(index for index, law in zip(chosen, laws, strict=True) if law.effect.shape and law.linear)
    if not shaped:
        return ()
    bare, closer = (
        sum(
            float(fit.left @ own[: len(fit.left), : len(fit.left)] @ fit.left)
            for fit, own in zip(left_out_fits(design, chosen, formed), design.per_flight, strict=True)
        )
        for formed in ((), shaped)
    )
    return shaped if closer < bare else ()


def left_out_fits(design: Design, chosen: Sequence[int], shaped: Sequence[int] = ()) -> list[Fit]:
    """Per flight a fit of all others, by the laws of the effects, some of them shaped by flights."""
    fits = []
    for own in design.per_flight:
        others = design.gram - own
        found = design.fit(chosen, others, form=shaped) or design.fit((), others)
        assert found is not None  # without effects there is always a fit
        fits.append(found)
    return fits
