# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where simulation and measurement disagree, by which effect, and how far the effect closes the gap."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from quadpi_core.discrepancy.acceptance import judge_unexplained, predictable, unexplained_share
from quadpi_core.discrepancy.candidates import candidates
from quadpi_core.discrepancy.discrepancy_result import Discovery, FoundEffect, FoundParameter
from quadpi_core.discrepancy.effect_response import Compared
from quadpi_core.discrepancy.evidence import Fit
from quadpi_core.discrepancy.search import Found, search
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, Flight

# Standard deviations to either side of an interval of 95 %.
_INTERVAL = 1.96
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
    rows = sum(len(band) for band in found.regression.columns.bands)
    left = predictable(found.left.gain, rows)
    share = unexplained_share(left, np.maximum(found.named, 0.0), rows)
    unknown = not judge_unexplained(share).passed
    law, whole = found.closing.fits()
    effects = [_effect(found, index, law, whole) for index in found.chosen]
    return Discovery(
        verdict="unknown" if unknown else "effects" if effects else "none",
        effects=tuple(effects),
        unexplained=share,
        unexplained_by={axis: found.left.functions[i] for i, axis in enumerate(AXES) if left[i]},
        gap=found.closing.gap(),
        found=found,
    )


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
    regression, candidate = found.regression, found.regression.candidates[index]
    values = candidate.values(regression.parameters(index, law))
    deviation = np.zeros(len(values))
    own = found.fit.deviation(regression.block(index).parameters)
    deviation[list(candidate.free)] = own * candidate.scale
    rivals = found.rivals[index]
    odds = sum(against for _, against in rivals)
    names = tuple(dict.fromkeys(regression.candidates[rival].name for rival, _ in rivals))
    manoeuvres = (candidate.effect.shown_by, *(regression.candidates[r].effect.shown_by for r, _ in rivals))
    return FoundEffect(
        name=candidate.name,
        probability=float(1.0 / (1.0 + odds)),
        parameters=tuple(
            FoundParameter(p.name, p.unit, float(v), float(v - _INTERVAL * d), float(v + _INTERVAL * d))
            for p, v, d in zip(candidate.effect.parameters, values, deviation, strict=True)
        ),
        shape=found.closing.shape(index, law, whole),
        axes=candidate.effect.axes,
        rivals=names,
        shown_by=tuple(dict.fromkeys(manoeuvres)),
    )
