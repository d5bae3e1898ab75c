# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The whole study: from a simulation and bags to what the simulation lacks, where, and how it then flies."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.discrepancy.by_condition import locate
from quadpi_core.discrepancy.discovery import discover, require_flights
from quadpi_core.discrepancy.discrepancy_result import Study
from quadpi_core.discrepancy.reflight import reflights
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import Flight
from quadpi_core.frames import Array
from quadpi_core.identification.identify import CUTOFF_HZ
from quadpi_core.identification.prepared_flights import read_flight
from quadpi_core.inputs import relative_to_air
from quadpi_core.logs.duplicates import refuse_duplicates
from quadpi_core.parallel import DEFAULT_WORKERS, Workers
from quadpi_core.rotations import rotation_matrix
from quadpi_core.vehicle import Vehicle

# A manoeuvre has been flown where a quantity reaches these, about half of what a gentle one of any vehicle
# does: airspeeds in induced velocities of hover, body rates, extent of the heading, and extent of the sum of
# squared rotor speeds over its mean.
_SPEED, _CLIMB = 0.25, 0.12
_RATE_RAD_S = 0.6
_HEADING_RAD = 0.8
_LOAD = 0.15
# Extent of a rotor speed that does not change: below the resolution of any sensor.
_STUCK_RAD_S = 1e-3
# Share of the samples that is beyond the largest value, as noise.
_TAIL = 0.01


def read_flights(
    paths: Sequence[Path],
    simulation: Simulation,
    *,
    workers: Workers = DEFAULT_WORKERS,
) -> list[Flight]:
    """Flights of the simulation's vehicle, fused, low-passed as models are by default, and in the air.

    Args:
        paths: bags, or logs that need no mapping.
        simulation: of the vehicle that flew.
        workers: that read the files.

    Raises:
        LogError: for what cannot be read or used, another vehicle, and a flight present twice.
        SignalError: naming the file, where the signals cannot be fused.
        DiscrepancyError: for too few flights.
        ParallelError: see :meth:`quadpi_core.parallel.Workers.map`.
    """
    require_flights(len(paths))
    shared = (simulation.vehicle, CUTOFF_HZ["default"])
    read = workers.map_files(_read, paths, shared=shared, task="Reading flights")
    refuse_duplicates((flight.source, digest) for flight, digest in read)
    return [flight for flight, _ in read]


def _read(task: tuple[Any, float], path: Path) -> tuple[Flight, str]:
    return read_flight(path, *task)


def study(
    simulation: Simulation,
    flights: Sequence[Flight],
    *,
    names: Sequence[str] | None = None,
    seed: int = 0,
) -> Study:
    """Find what a simulation is missing, and where it shows.

    Args:
        simulation: to compare with.
        flights: see :func:`read_flights`.
        names: of effects to look for; unless given, all.
        seed: of all draws.

    Raises:
        DiscrepancyError: see :func:`quadpi_core.discrepancy.discover`; for flights that hold nothing but
            hover, and rotor speeds that do not change.
    """
    missing = require_excitation(flights, simulation.vehicle)
    discovery = discover(simulation, flights, names=names, seed=seed)
    return Study(
        simulation=simulation,
        flights=tuple(flights),
        discovery=discovery,
        where=locate(discovery.found, seed),
        not_flown=missing,
        seed=seed,
        flown_again=reflights(discovery) if discovery.effects else None,
    )


def require_excitation(flights: Sequence[Flight], vehicle: Vehicle) -> tuple[str, ...]:
    """Names of the manoeuvres that no flight holds, in a pilot's words.

    Raises:
        DiscrepancyError: for flights of hover alone, naming what is missing; and, naming the file, for rotor
            speeds that do not change, as of a stuck sensor or a log that was filled in.
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
