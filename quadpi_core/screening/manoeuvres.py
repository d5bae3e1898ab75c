# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Manoeuvres that flights contain, without which effects look alike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.rotations import rotation_matrix
from quadpi_core.screening.rotors_in_flight import STUCK_RAD_S
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.vehicle import Vehicle

_HALF_OF_GENTLE = "about half of what a gentle manoeuvre of any vehicle reaches"
FLOWN_SPEED = Threshold(
    "flown forward or sideways", 0.25, "induced velocities of hover", _HALF_OF_GENTLE, CONVENTION
)
FLOWN_CLIMB = Threshold("climbed", 0.12, "induced velocities of hover", _HALF_OF_GENTLE, CONVENTION)
FLOWN_RATE = Threshold("doublet flown", 0.6, "rad/s", _HALF_OF_GENTLE, CONVENTION)
FLOWN_HEADING = Threshold("heading turned", 0.8, "rad", _HALF_OF_GENTLE, CONVENTION)
FLOWN_LOAD = Threshold(
    "throttle step flown",
    0.15,
    "extent of the sum of squared rotor speeds over its mean",
    _HALF_OF_GENTLE,
    CONVENTION,
)
TAIL = Threshold(
    "samples beyond the largest value",
    0.01,
    "of all samples",
    "noise alone exceeds a threshold now and then",
    CONVENTION,
)


def require_excitation(flights: Sequence[Flight], vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the manoeuvres that no flight contains, in a pilot's words.

    Raises:
        DiscrepancyError: for flights of hover alone, naming what is missing; and, naming the file, for rotor
            speeds that do not change, as of a stuck sensor or a log that was filled in.
    """
    for flight in flights:
        require_changes(flight)
    flown = _flown(flights, vehicle)
    missing = tuple(name for name, there in flown.items() if not there)
    if len(missing) == len(flown):
        raise DiscrepancyError(
            f"{', '.join(flight.name for flight in flights)}: nothing but hover, in which effects look "
            f"alike; fly {', '.join(missing)}"
        )
    return missing


def require_changes(flight: Flight) -> None:
    """Refuse rotor speeds that do not change, naming the file."""
    stuck = np.flatnonzero(np.ptp(flight.rotor_speeds, axis=0) < STUCK_RAD_S.value)
    if len(stuck):
        raise DiscrepancyError(
            f"{flight.source}: topic rotor_speeds: rotor {stuck[0] + 1} has the same speed throughout, "
            f"{flight.rotor_speeds[0, stuck[0]]:.4g} rad/s; speeds as measured are needed"
        )


def _flown(flights: Sequence[Flight], vehicle: Vehicle) -> dict[str, bool]:
    """Whether any flight contains a manoeuvre, by its name."""
    induced = vehicle.hover_induced_velocity
    velocity = [relative_to_air(flight.velocity, flight.attitude, flight.wind) for flight in flights]
    speeds = np.quantile(np.abs(np.concatenate(velocity)), 1.0 - TAIL.value, axis=0) / induced
    rates = np.quantile(np.abs(np.concatenate([own.rates for own in flights])), 1.0 - TAIL.value, axis=0)
    loads = [np.square(flight.rotor_speeds).sum(axis=1) for flight in flights]
    return {
        "forward and backward flight": speeds[0] > FLOWN_SPEED.value,
        "sideways flight": speeds[1] > FLOWN_SPEED.value,
        "climb and descent": speeds[2] > FLOWN_CLIMB.value,
        "throttle steps": max(_extent(load) / float(load.mean()) for load in loads) > FLOWN_LOAD.value,
        "roll doublets": rates[0] > FLOWN_RATE.value,
        "pitch doublets": rates[1] > FLOWN_RATE.value,
        "yaw doublets": rates[2] > FLOWN_RATE.value,
        "turns of the heading": max(_extent(_heading(flight)) for flight in flights) > FLOWN_HEADING.value,
    }


def _extent(values: Array) -> float:
    low, high = np.quantile(values, [TAIL.value, 1.0 - TAIL.value])
    return float(high - low)


def _heading(flight: Flight) -> Array:
    ahead = rotation_matrix(flight.attitude)[:, :2, 0]
    return np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
