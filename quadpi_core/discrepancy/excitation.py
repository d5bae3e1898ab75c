# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What flights have to hold so that a discrepancy can show, and what they lack."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.inputs import relative_to_air
from quadpi_core.vehicle import Vehicle

# Airspeeds in induced velocities of hover, about half of which a gentle manoeuvre of any vehicle reaches.
_SPEED, _CLIMB = 0.25, 0.12
_RATE_RAD_S = 0.6
_HEADING_RAD = 0.8
_LOAD = 0.15
_STUCK_RAD_S = 1e-3
# Of samples: what lies beyond is taken for noise.
_TAIL = 0.01


def require_excitation(flights: Sequence[Flight], vehicle: Vehicle) -> tuple[str, ...]:
    """Manoeuvres that no flight holds, as a pilot would be told them; refuse flights that hold none of all.

    Raises:
        DiscrepancyError: for hover alone, naming what is missing; and naming the file, for rotor speeds that
            do not change, as a sensor that is stuck or a log that was filled in has them.
    """
    for flight in flights:
        stuck = np.flatnonzero(np.ptp(flight.rotor_speeds, axis=0) < _STUCK_RAD_S)
        if len(stuck):
            raise DiscrepancyError(
                f"{flight.source}: topic rotor_speeds: rotor {stuck[0] + 1} has the same speed throughout, "
                f"{flight.rotor_speeds[0, stuck[0]]:.4g} rad/s; speeds as measured are needed"
            )
    flown = _flown(flights, vehicle)
    missing = tuple(name for name, there in flown.items() if not there)
    if len(missing) == len(flown):
        raise DiscrepancyError(
            f"{', '.join(flight.name for flight in flights)}: nothing but hover, in which effects look "
            f"alike; fly {', '.join(missing)}"
        )
    return missing


def _flown(flights: Sequence[Flight], vehicle: Vehicle) -> dict[str, bool]:
    """Whether any flight holds a manoeuvre, by its name."""
    induced = vehicle.hover_induced_velocity
    velocity = [relative_to_air(flight.velocity, flight.attitude, flight.wind) for flight in flights]
    rates = [flight.rates for flight in flights]
    loads = [np.square(flight.rotor_speeds).sum(axis=1) for flight in flights]
    return {
        "forward and backward flight": _largest([own[:, 0] for own in velocity]) > _SPEED * induced,
        "sideways flight": _largest([own[:, 1] for own in velocity]) > _SPEED * induced,
        "climb and descent": _largest([own[:, 2] for own in velocity]) > _CLIMB * induced,
        "throttle steps": max(_extent(load) / float(load.mean()) for load in loads) > _LOAD,
        "roll doublets": _largest([own[:, 0] for own in rates]) > _RATE_RAD_S,
        "pitch doublets": _largest([own[:, 1] for own in rates]) > _RATE_RAD_S,
        "yaw doublets": _largest([own[:, 2] for own in rates]) > _RATE_RAD_S,
        "turns of the heading": max(_extent(_heading(flight)) for flight in flights) > _HEADING_RAD,
    }


def _largest(columns: Sequence[Array]) -> float:
    return float(np.quantile(np.abs(np.concatenate(columns)), 1.0 - _TAIL))


def _extent(values: Array) -> float:
    low, high = np.quantile(values, [_TAIL, 1.0 - _TAIL])
    return float(high - low)


def _heading(flight: Flight) -> Array:
    ahead = rotation_matrix(flight.attitude)[:, :2, 0]
    heading: Array = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
    return heading
