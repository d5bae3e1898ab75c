# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What a simulation is missing beside flights, and the simulation that has it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from quadpi_core import array_checks
from quadpi_core.discrepancy.augmented_simulation import augmented, write_addition
from quadpi_core.discrepancy.discrepancy_result import Discovery, FoundEffect, Study
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.other_simulations import CallableSimulation
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation
from quadpi_core.discrepancy.study import study, study_flight
from quadpi_core.errors import ArgumentError, DiscrepancyError, require_library
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.library.flight_arrays import counted, html_table, new_axes
from quadpi_core.library.flights import Flights, flights_in
from quadpi_core.library.wrench_model import WrenchModel
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.paths import require_file, scratch_folder, whole_output

if TYPE_CHECKING:
    import pandas as pd

_COLUMNS = ("effect", "parameter", "value", "lower", "upper", "unit", "probability", "axes", "rivals")


@dataclass(frozen=True, repr=False)
class BetterSimulation:
    """A simulation with the effects that flights showed to be missing.

    Attributes:
        discovery: what was found.
    """

    discovery: Discovery

    def wrench(self, flights: Flights) -> Array:
        """Simulated forces and moments (N, 6) N and Nm of all samples, columns Fx … Mz.

        Raises:
            ArgumentError: for what are no flights.
        """
        simulation = augmented(self.discovery)
        return np.concatenate([simulation.wrench(flight) for flight in _states(flights)])

    def save(self, path: str | Path) -> Path:
        """Write it as a file that `find_discrepancy`, `quadpi discrepancy` and `quadpi simulate` take.

        Args:
            path: ends in .yaml for the simulation of a vehicle file, which this is too; in .json for any
                other, to which the file refers.

        Raises:
            ArgumentError: for another ending.
            DiscrepancyError: for a function of this session, which no file can name.
            OutputError: if `path` cannot be written.
        """
        path = array_checks.path("path", path)
        base = augmented(self.discovery).base
        if isinstance(base, CallableSimulation) and not base.code:
            raise DiscrepancyError(
                f"{base.name}: a file cannot name this function: give it as text, module:function"
            )
        suffix = ".yaml" if isinstance(base, VehicleSimulation) else ".json"
        if path.suffix != suffix:
            raise ArgumentError(f"path: expected one that ends in {suffix}, found {path.name}")
        require_file(path)
        with scratch_folder() as folder, whole_output(path) as temporary:
            written = write_addition(self.discovery, folder)
            assert written is not None  # a verdict of effects
            temporary.write_text(written.read_text())
        return path

    def __repr__(self) -> str:
        effects = ", ".join(effect.name for effect in self.discovery.effects)
        return f"<BetterSimulation {augmented(self.discovery).base.name:.60} with {effects:.80}>"


@dataclass(frozen=True, repr=False)
class Discrepancy:
    """What a search found in flights that a simulation lacks; LogError without pandas or matplotlib.

    Attributes:
        study: all that is known, of `quadpi_core.discrepancy.discrepancy_result`.
    """

    study: Study

    @property
    def verdict(self) -> str:
        """One of "effects", "none" and "unknown", for effects that do not hold elsewhere; see `doubts`."""
        return self.study.discovery.verdict

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """Named effects, the largest first, with parameters and what else could explain the same."""
        return self.study.discovery.effects

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why the verdict is "unknown"; empty for any other."""
        return self.study.discovery.doubts

    @property
    def where(self) -> tuple[str, ...]:
        """Conditions in which simulation and flights disagree, in words."""
        return tuple(part.text for part in self.study.where.telling)

    @property
    def simulation(self) -> BetterSimulation:
        """The simulation with the effects added, and coefficients moved within their tolerances.

        Raises:
            DiscrepancyError: for any other verdict than "effects".
        """
        if self.verdict != "effects":
            raise DiscrepancyError(
                f"nothing to add to {self.study.simulation.name}: the verdict is {self.verdict}"
                f"{''.join(f': {doubt}' for doubt in self.doubts[:1])}"
            )
        return BetterSimulation(self.study.discovery)

    def to_pandas(self) -> pd.DataFrame:
        """A row for each parameter of each effect, with its interval of 95 %; empty where none was named.

        Columns: effect, parameter, value, lower, upper, unit, probability, axes, rivals.
        """
        rows = [
            (
                *(one.name, size.name, size.value, size.lower, size.upper, size.unit),
                *(one.probability, " ".join(one.axes), ", ".join(one.rivals)),
            )
            for one in self.effects
            for size in one.parameters
        ]
        frame: pd.DataFrame = require_library("pandas", "notebook").DataFrame(rows, columns=_COLUMNS)
        return frame

    def __repr__(self) -> str:
        study, gap = self.study, self.study.discovery.gap
        names = ", ".join(effect.name for effect in self.effects) or "no effect named"
        return (
            f"<Discrepancy {study.simulation.name:.60} and {counted(len(study.flights))}: {self.verdict}, "
            f"{names:.80}, {gap.reduction:.0%} of the gap closed>"
        )

    def _repr_html_(self) -> str:
        rows = [
            (effect.name, size.name, f"{size.value:.3g}", f"{size.lower:.3g} to {size.upper:.3g}", size.unit)
            for effect in self.effects
            for size in effect.parameters
        ]
        headings = ("effect", "parameter", "value", "95 % interval", "unit")
        return html_table(" ".join((repr(self), *self.doubts)), headings, rows)

    def plot(self, axes: Any = None) -> Any:
        """Draw the differences of each axis before and after, over their floor; returns axes of matplotlib.

        Args:
            axes: one of matplotlib; a new figure unless given.
        """
        (axes,), gap, places = new_axes(axes), self.study.discovery.gap, np.arange(len(AXES))
        axes.bar(places - 0.2, gap.before / gap.floor, 0.4, label="before")
        axes.bar(places + 0.2, gap.after / gap.floor, 0.4, label="with the effects")
        axes.axhline(1.0, color="black", linestyle="--", linewidth=0.8, label="floor: noise of the sensors")
        axes.set_xticks(places, AXES)
        axes.set_ylabel("difference / floor")
        axes.legend()
        return axes


def find_discrepancy(
    simulation: str | Path | Simulation | Callable[[Flight], Array],
    flights: Flights,
    *,
    effects: Sequence[str] | None = None,
    seed: int = 0,
) -> Discrepancy:
    """Find the physical effects that a simulation lacks beside flights; as `quadpi discrepancy` does.

    Args:
        simulation: a vehicle that can be simulated, by name or file; a folder of an identified model; a
            function of yours from a `quadpi_core.flight.Flight` to its wrench (N, 6), itself or as text
            "module:function"; or what :func:`load_simulation` gave.
        flights: two or more of its vehicle, low-passed at the 30 Hz of `load_flights`.
        effects: names of effects to look for; all unless given.
        seed: of all draws.

    Raises:
        ArgumentError: for what are no simulation or flights.
        DiscrepancyError: for too few or too short flights, flights of another vehicle, of hover alone.
    """
    given = flights_in("flights", flights)
    if given.cutoff_hz != CUTOFF_HZ["default"]:
        raise DiscrepancyError(
            f"flights: low-passed at {given.cutoff_hz:g} Hz; a search compares at {CUTOFF_HZ['default']:g}"
        )
    if isinstance(simulation, WrenchModel):
        raise ArgumentError(
            "simulation: a model is searched by its folder: model.save(folder), and give that"
        )
    if isinstance(simulation, str | Path):
        named = isinstance(simulation, str) and ":" in simulation
        simulation = load_simulation(simulation, given.vehicle.name if named else None)
    elif not isinstance(simulation, Simulation) and callable(simulation):
        name = getattr(simulation, "__name__", type(simulation).__name__)
        simulation = CallableSimulation(name, given.vehicle, simulation)
    if isinstance(simulation, Simulation) and simulation.vehicle.fingerprint != given.vehicle.fingerprint:
        raise DiscrepancyError(
            f"{simulation.name}: of another vehicle than the flights of {given.vehicle.name}: numbers differ"
        )
    names = None if effects is None else array_checks.several("effects", effects, str)
    if names == []:
        raise ArgumentError("effects: expected names, found none; None looks for all")
    return Discrepancy(study(simulation, _states(given), names=names, seed=seed))


def _states(flights: Flights) -> list[Flight]:
    """The states of flights, as a search compares them."""
    given = flights_in("flights", flights).prepared
    return [study_flight(replace(one.states, name=one.name, sha256=one.sha256)) for one in given]
