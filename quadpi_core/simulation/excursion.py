# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where a simulated flight goes beyond the flights that its vehicle was identified on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, aerodynamic_inputs, relative_to_air
from quadpi_core.models.envelope import MARGIN, Envelope
from quadpi_core.records import Records
from quadpi_core.simulation.simulated_file import IdentifiedRange
from quadpi_core.vehicle import Vehicle


class Excursion(NamedTuple):
    """How a flight left the ranges of the inputs that a vehicle was identified on.

    Attributes:
        share: of the time outside, by more than the margin of a warning in flight.
        input: that went furthest, in widths of its range.
        reached: its value there.
        lower, upper: its range.
    """

    share: float
    input: str
    reached: float
    lower: float
    upper: float

    def sentence(self) -> str:
        """In words."""
        return (
            f"beyond the flights that the vehicle was identified on for {self.share:.1%} of its time, where "
            f"the simulation extrapolates: {self.input} reaches {self.reached:.3g} and was {self.lower:.3g} "
            f"to {self.upper:.3g}"
        )


def excursion(
    limits: IdentifiedRange | None, vehicle: Vehicle, log: Records, wind: Array
) -> Excursion | None:
    """How far logged instants lie outside; None inside, and for a vehicle that was not identified.

    Args:
        limits: of the vehicle.
        vehicle: as in its file.
        log: records `dynamics.LOGGED` (N,).
        wind: (N, 3) m/s of the world.
    """
    if limits is None or len(log) == 0:
        return None
    attitude, velocity, rates, speeds = (
        np.ascontiguousarray(log[name]) for name in ("attitude", "velocity", "rates", "rotor_speeds")
    )
    inputs = aerodynamic_inputs(relative_to_air(velocity, attitude, wind), attitude, rates, speeds, vehicle)
    distances = Envelope.outside(inputs, limits.lower, limits.upper)
    outside = np.any(distances > MARGIN, axis=1)
    if not np.any(outside):
        return None
    row, column = np.unravel_index(int(np.argmax(distances)), distances.shape)
    return Excursion(
        share=float(np.mean(outside)),
        input=INPUT_NAMES[column],
        reached=float(inputs[row, column]),
        lower=float(limits.lower[column]),
        upper=float(limits.upper[column]),
    )
