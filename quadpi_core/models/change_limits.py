# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What sound flights leave of a model, so that the alarm can tell how much a vehicle has changed."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Annotated, Any

from quadpi_core.config_schema import (
    NotEmpty,
    NotNegative,
    OneOf,
    Positive,
    Real,
    Share,
    Within,
    parse_config,
)
from quadpi_core.errors import ModelError
from quadpi_core.models.alarm_limits import BOUND_CONFIDENCE, FEWEST_FLIGHTS
from quadpi_core.thresholds import CONVENTION, Threshold

FALSE_FLIGHTS = Threshold(
    "share of sound flights that raise the alarm for a change",
    0.05,
    "",
    "of a flight of any length (Ville's inequality), as the evidence must grow to one over it",
    CONVENTION,
)
# Axes whose residuals are evidence. Mz is not one: what a rotor that weakens does to its torque is not known.
CHANGE_AXES = ("Fx", "Fy", "Fz", "Mx", "My")


@dataclass(frozen=True)
class LeftOnAxis:
    """What flights leave of a model on one axis, in N or Nm, by blocks of 0.1 s.

    Attributes:
        mean: of the constants of the flights.
        between: variance of the constant of one more flight.
        walk: variance by which that constant walks in a block.
        keep: share of the process that a block leaves.
        process: variance of the process.
        white: variance of the noise of a block's mean.
        scale: of Student's distribution with 3 degrees of freedom of what the filter cannot foresee, in units
            of its own standard deviation and by how loud it was in the 4 s before.
        loudest: largest mean square of what it cannot foresee in 4 s of any flight.
    """

    mean: Real
    between: NotNegative
    walk: NotNegative
    keep: Share
    process: NotNegative
    white: Positive
    scale: Positive
    loudest: Positive


@dataclass(frozen=True)
class ChangeLimits:
    """What is known of sound flights, each under the model of the others.

    Attributes:
        axes: by axis of CHANGE_AXES, those that the model holds.
        levers: for each rotor, by what the model has Fz, Mx and My change per newton that it gives less.
        flights: number of flights.
        hours: that they lasted.
        largest: evidence that one of them gathered at most, with the limits of the others.
    """

    axes: Annotated[dict[Annotated[str, OneOf(*CHANGE_AXES)], LeftOnAxis], NotEmpty()]
    levers: tuple[tuple[Real, Real, Real], ...]
    flights: Annotated[int, Within(FEWEST_FLIGHTS)]
    hours: Positive
    largest: NotNegative

    @property
    def evidence(self) -> float:
        """At which the alarm is raised: never less than any sound flight has gathered."""
        return max(1.0 / FALSE_FLIGHTS.value, self.largest)

    def sentence(self) -> str:
        """A sentence that tells what is proven from what is estimated."""
        count, sure = self.flights, BOUND_CONFIDENCE.value
        bound = 1.0 - (1.0 - sure) ** (1.0 / count)
        to_come = math.ceil(math.log(1.0 - sure) / math.log(1.0 - FALSE_FLIGHTS.value))
        more = max(to_come - count, 0)
        share = f"{100.0 * FALSE_FLIGHTS.value:g} %"
        estimated = f"estimated {share} of sound flights raise it at most"
        if self.largest > 1.0 / FALSE_FLIGHTS.value:
            estimated = (
                "no share is estimated, as a sound flight left out gathered evidence of "
                f"{self.largest:.2g} to 1, which is the limit"
            )
        asks = f"; {more} sound flights more could bound it at {share}" if more else ""
        return (
            f"change of the vehicle: {estimated}; {count} flights, none of which does, bound it at 1 flight "
            f"in {count + 1} on average, or {100.0 * bound:.2g} % ({100.0 * sure:g} %){asks}"
        )

    def to_json(self) -> dict[str, Any]:
        """Plain numbers for the model file; :meth:`from_json` reads them."""
        return asdict(self)

    @classmethod
    def from_json(cls, data: Any) -> ChangeLimits:
        """Limits from what :meth:`to_json` gave.

        Raises:
            ModelError: naming the key that is missing, or whose number no flights give.
        """
        return parse_config(cls, data, "change", ModelError)


def change_sentence(limits: ChangeLimits | None) -> str:
    """What `identify` and `info` say of the evidence of a change that a model can raise."""
    if limits is not None:
        return limits.sentence()
    return (
        "change of the vehicle not judged by the size of residuals: that takes "
        f"{FEWEST_FLIGHTS} flights within each other's ranges, and the axis Fz"
    )
