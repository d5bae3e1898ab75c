# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From a simulation and bags to what is missing, where, and a simulation that has it: the whole workflow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from quadpi_core import __version__
from quadpi_core.discrepancy.by_condition import Where, locate
from quadpi_core.discrepancy.discovery import Discovery, discover, require_flights
from quadpi_core.discrepancy.excitation import require_excitation
from quadpi_core.discrepancy.reflight import reflights
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.flight import Flight
from quadpi_core.identification.identify import CUTOFF_HZ
from quadpi_core.identification.prepared_flights import read_flight
from quadpi_core.logs.duplicates import refuse_duplicates
from quadpi_core.parallel import map_files


@dataclass(frozen=True)
class Study:
    """A simulation beside flights.

    Attributes:
        simulation: that was compared.
        flights: in the air.
        discovery: what is missing.
        where: it shows.
        not_flown: manoeuvres that no flight holds.
        seed: of all draws.
        flown_again: the gap in roll-outs and closed loop, see
            :func:`quadpi_core.discrepancy.reflight.reflights`; empty where nothing was added.
    """

    simulation: Simulation
    flights: tuple[Flight, ...]
    discovery: Discovery
    where: Where
    not_flown: tuple[str, ...]
    seed: int
    flown_again: Mapping[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return {
            "quadpi_version": __version__,
            "simulation": self.simulation.name,
            "code": self.simulation.code or None,
            "vehicle": self.simulation.vehicle.name,
            "seed": self.seed,
            "flights": {
                flight.name: {
                    "duration_s": float(flight.time[-1] - flight.time[0]),
                    "data_quality": flight.quality.to_json(),
                }
                for flight in self.flights
            },
            **self.discovery.as_dict(),
            **self.where.as_dict(),
            **self.flown_again,
            "not_flown": list(self.not_flown),
        }


def read_flights(
    paths: Sequence[Path],
    simulation: Simulation,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Flight]:
    """Flights of the simulation's vehicle, fused, low-passed as models are by default, and in the air.

    Args:
        paths: bags, or logs that need no mapping.
        simulation: of the vehicle that flew.
        workers: see :func:`quadpi_core.parallel.map_files`.
        scheduler: see there.
        progress: see there.

    Raises:
        LogError: for what cannot be read or used, another vehicle, and a flight present twice.
        SignalError: naming the file, where the signals cannot be fused.
        DiscrepancyError: for too few flights.
        ParallelError: see :func:`quadpi_core.parallel.map_tasks`.
    """
    require_flights(len(paths))
    read = map_files(
        _read,
        paths,
        shared=(simulation.vehicle, CUTOFF_HZ["default"]),
        workers=workers,
        scheduler=scheduler,
        progress=progress,
    )
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
        flown_again=reflights(discovery) if discovery.effects else {},
    )
