# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where simulation and measurement disagree, by which effect, and how far the effect closes the gap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.closure import gap
from quadpi_core.discrepancy.discrepancy_result import Discovery, FoundEffect, FoundParameter
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.search import UNEXPLAINED_SHARE, Found, search
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array

_INTERVAL = 1.96
# What is predicted of an axis beyond the effects matters where its squares are this multiple of those of the
# noise: of flights without any effect nothing is predicted, of a hover up to a quarter, where all motion is
# noise of the estimator. Where it is about as loud as the noise, and no small part of what was named in the
# axis, the axis is judged by itself, too: an effect may explain another axis so well that it hides this one.
_MATTERS, _LOUD, _PART = 0.3, 0.8, 0.2
_FEWEST_FLIGHTS = 2


def discover(
    simulation: Simulation,
    flights: Sequence[Flight],
    *,
    names: Sequence[str] | None = None,
    seed: int = 0,
) -> Discovery:
    """Find where a simulation and flights disagree, and which effects explain it.

    Args:
        simulation: to compare with.
        flights: fused and in the air, of the simulation's vehicle; two at least.
        names: of effects to look for; unless given, all.
        seed: of the calibration.

    Raises:
        DiscrepancyError: for fewer flights, flights of another vehicle, a simulation that gives no wrench.
    """
    require_flights(len(flights))
    for flight in flights:
        if flight.vehicle and flight.vehicle != simulation.vehicle.name:
            raise DiscrepancyError(
                f"{flight.source}: flown by vehicle {flight.vehicle}, "
                f"but the simulation {simulation.name} is of {simulation.vehicle.name}"
            )
    compared = [Compared(flight, simulation) for flight in flights]
    # Products this small are over before threads have shared one out: two of them took twice the time of one.
    with threadpool_limits(limits=1, user_api="blas"):
        found = search(compared, candidates(simulation.vehicle, names), seed)
    design = found.design
    rows = sum(len(band) for band in design.bands)
    left = np.where(found.left.gain > _MATTERS * rows, found.left.gain, 0.0)
    share = _unexplained(left, np.maximum(found.named, 0.0), _LOUD * rows)
    unknown = share > UNEXPLAINED_SHARE
    law, whole = found.closing.fits()
    effects = [_effect(found, index, law, whole) for index in found.chosen]
    return Discovery(
        verdict="unknown" if unknown else "effects" if effects else "none",
        effects=tuple(effects),
        unexplained=share,
        unexplained_by={axis: found.left.functions[i] for i, axis in enumerate(AXES) if left[i]},
        gap=gap(found.closing),
        found=found,
    )


def _unexplained(left: Array, named: Array, loudness: float) -> float:
    """Share without a name of squares (6,) left and named, of all axes or of one that is louder than that."""
    if not left.any():
        return 0.0
    loud = (left > loudness) & (left > _PART * named)
    alone = left[loud] / (left[loud] + named[loud])
    return float(max(left.sum() / (left.sum() + named.sum()), np.max(alone, initial=0.0)))


def require_flights(count: int) -> None:
    """Refuse fewer flights than a search needs.

    Raises:
        DiscrepancyError: naming how many there are.
    """
    if count < _FEWEST_FLIGHTS:
        raise DiscrepancyError(
            f"{count} flight: what is found on some flights is tested on others; "
            f"{_FEWEST_FLIGHTS} are the least"
        )


def _effect(found: Found, index: int, law: Fit, whole: Fit) -> FoundEffect:
    design, candidate = found.design, found.design.candidates[index]
    block = design.blocks[index]
    values = candidate.values(design.parameters(index, law))
    deviation = np.zeros(len(values))
    deviation[list(candidate.free)] = found.fit.deviation(block.parameters) * candidate.scale
    rivals = found.rivals[index]
    odds = sum(against for _, against in rivals)
    names = tuple(dict.fromkeys(design.candidates[rival].name for rival, _ in rivals))
    manoeuvres = (candidate.effect.shown_by, *(design.candidates[r].effect.shown_by for r, _ in rivals))
    return FoundEffect(
        name=candidate.name,
        probability=float(1.0 / (1.0 + odds)),
        parameters=tuple(
            FoundParameter(p.name, p.unit, float(v), float(v - _INTERVAL * d), float(v + _INTERVAL * d))
            for p, v, d in zip(candidate.effect.parameters, values, deviation, strict=True)
        ),
        shape=design.shape(index, law, whole),
        axes=candidate.effect.axes,
        rivals=names,
        shown_by=tuple(dict.fromkeys(manoeuvres)),
    )
