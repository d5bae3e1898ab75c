# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One case searched: a model of other flights, which is kept, and flights read, changed and fused."""

from __future__ import annotations

import hashlib
import logging
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from blind.cases import PAIR
from blind.searching import rollout_changes

from hidden.cases import FLEETS, Case, Fleet
from hidden.changes import CHANGES, Given
from hidden.measures import REFUSED
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation
from quadpi_core.discrepancy.discrepancy_result import discovery_json, reflights_json
from quadpi_core.discrepancy.effect_response import residual
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation
from quadpi_core.discrepancy.sound_learning import learned_from
from quadpi_core.discrepancy.study import FEWEST_FLIGHTS, found_and_flown
from quadpi_core.discrepancy.unexplained import as_many_as_stated
from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.estimator.fusion import fuse_airborne
from quadpi_core.flight import AXES, Flight, Recording
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.readers import recording_hash
from quadpi_core.models.interval_rules import inside_interval
from quadpi_core.models.model_kind import CUTOFF_HZ, IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.parallel import Workers
from quadpi_core.screening.consistency import checked
from quadpi_core.screening.flight_runs import parts_without_pause
from quadpi_core.vehicle import Vehicle

ROOT = Path(__file__).resolve().parents[2]
# Share of samples that a change has to push out of an axis' intervals to count as seen there, of the same
# flights: less would not be why the axis does not hold what it states.
_SEEN = 0.02
# Rooms after identification, which it does not import: `make lint` holds their order. Of the search, a model
# knows what sound flights leave, by the columns of effects.
_LATER = ("evaluation", "discrepancy", "paper", "report", "view", "cli")
_LEARNED_BY = ("sound_learning.py", "candidates.py", "effect_response.py", "whitening.py")


class Model(NamedTuple):
    """A physical model of the model's flights in a split, and the folder of all models."""

    fleet: str
    split: int
    store: Path

    @property
    def folder(self) -> Path:
        """By all that it depends on."""
        fleet = FLEETS[self.fleet]
        key = repr((identification_code(), fleet.vehicle, fleet.mapping, fleet.split(self.split)[0]))
        return self.store / hashlib.sha256(key.encode()).hexdigest()[:16]


class Task(NamedTuple):
    """A case, and the folder of models."""

    case: Case
    store: Path

    @property
    def key(self) -> str:
        """Of the case."""
        return self.case.key

    @property
    def model(self) -> Model:
        """That is searched."""
        return Model(self.case.fleet, self.case.split, self.store)


@cache
def identification_code() -> str:
    """Hash of the rooms that a model comes from: others leave it as it is."""
    digest, package = hashlib.sha256(), ROOT / "quadpi_core"
    rooms = [path for path in package.rglob("*.py") if path.relative_to(package).parts[0] not in _LATER]
    rooms += [package / "discrepancy" / name for name in _LEARNED_BY]
    for path in sorted([*rooms, *(ROOT / "config").rglob("*.yaml")]):
        digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def identified(shared: None, model: Model) -> str:  # noqa: ARG001
    """The folder of a model, which is identified unless it is there."""
    if not model.folder.exists():
        fleet = FLEETS[model.fleet]
        vehicle, paths = Vehicle.load(fleet.vehicle), fleet.split(model.split)[0].paths
        flights = prepare_flights(
            paths, vehicle, mapping=fleet.mapping, workers=Workers(1), left_out=[], keep_flawed=False
        )
        options = IdentifyOptions(method="physical")
        found = identify(flights, vehicle, load_pools("quadrotor"), options)
        learned_from(found, flights).save(model.folder)
    return str(model.folder)


def kept(shared: None, model: Model) -> None:
    """Identify a model; where that fails, each search of it says why."""
    with suppress(QuadpiError):
        identified(shared, model)


def searched(shared: None, task: Task) -> dict[str, Any]:  # noqa: ARG001
    """What the search says of a case, as JSON can hold it, beside the truth and what the intervals show."""
    case, began = task.case, time.perf_counter()
    # What readers say of each flight would be said in each case.
    logging.getLogger("quadpi_core").setLevel(logging.ERROR)
    found: dict[str, Any] = {"left": None, "rollouts": None, "seen": [], "broken": [], "coverage": {}}
    try:
        was, simulation = _as_they_were(task)
        refused = list[str]()
        flights = _changed(case, was, load_simulation(task.model.folder), refused)
        # Before the search, and by what `evaluate` goes by.
        model, before = load_simulation(task.model.folder), [own for _, own in was]
        found |= _intervals(simulation, flights, model, before)
        if case.kind == PAIR:
            found["parts"] = [bool(_alone(case, name, was, model, before)["seen"]) for name in case.changes]
        if len(flights) < FEWEST_FLIGHTS.value and refused:
            found["result"] = {"verdict": f"{REFUSED}: {refused[0]}", "effects": [], "ambiguous": []}
            return {"case": asdict(case), "truth": asdict(case.truth()), "seconds": 0.0, **found}
        began = time.perf_counter()
        discovery = found_and_flown(simulation, flights)
        flown = discovery.flown
        found["result"] = discovery_json(discovery)
        if flown is not None:
            found["coverage"] = reflights_json(flown).get("coverage", {})
        if flown is not None and discovery.added:
            # Of flights left out in turn.
            found["left"] = 1.0 - discovery.gap.reduction
            found["rollouts"] = rollout_changes(flown.rollout)
    except Exception as error:
        # Whatever is raised on possible flights is a failure to list, not the end of the run.
        found["result"] = {"verdict": f"error: {one_line(error)}", "effects": [], "ambiguous": []}
    seconds = time.perf_counter() - began
    return {"case": asdict(case), "truth": asdict(case.truth()), "seconds": seconds, **found}


def _alone(
    case: Case,
    name: str,
    was: Sequence[tuple[Recording, Flight]],
    model: Simulation,
    before: Sequence[Flight],
) -> dict[str, Any]:
    """What the intervals show of one change of a pair by itself, see :func:`_intervals`."""
    alone = replace(case, changes=(name,))
    simulation = carried(model, CHANGES[name].file(model.vehicle, alone.drawn[name]))
    return _intervals(simulation, _changed(alone, was, model, []), model, before)


def carried(simulation: Simulation, vehicle: Vehicle) -> Simulation:
    """The simulation with another vehicle file; coefficients and intervals stay."""
    if isinstance(simulation, AugmentedSimulation):
        return replace(simulation, base=carried(simulation.base, vehicle))
    assert isinstance(simulation, VehicleSimulation)
    return replace(simulation, model=simulation.model.carrying(vehicle))


def read(fleet: Fleet, path: Path) -> Recording:
    """The longest part of a log without a pause."""
    found = read_recording(path, Vehicle.load(fleet.vehicle), fleet.mapping)
    return replace(parts_without_pause(found)[0], name=path.stem)


def fused(recording: Recording, vehicle: Vehicle) -> Flight:
    """In the air, as `quadpi discrepancy` has it."""
    found = checked(recording, vehicle)
    return replace(fuse_airborne(found, vehicle, CUTOFF_HZ["default"]), sha256=recording_hash(found))


def _as_they_were(task: Task) -> tuple[list[tuple[Recording, Flight]], Simulation]:
    """The flights to search, the first that import, and the simulation that they are searched with."""
    fleet, was = FLEETS[task.case.fleet], list[tuple[Recording, Flight]]()
    vehicle = Vehicle.load(fleet.vehicle)
    simulation = load_simulation(identified(None, task.model))
    for path in fleet.split(task.case.split)[1].paths:
        try:
            recording = read(fleet, path)
            was.append((recording, fused(recording, vehicle)))
        except QuadpiError:
            continue
        if len(was) == fleet.searched:
            break
    for name, drawn in task.case.drawn.items():
        vehicle = CHANGES[name].file(vehicle, drawn)
    return was, carried(simulation, vehicle)


def _changed(
    case: Case, was: Sequence[tuple[Recording, Flight]], simulation: Simulation, refused: list[str]
) -> list[Flight]:
    """The flights with the changes; those that are then refused are left out, as by the command, with why."""
    fleet, flights = FLEETS[case.fleet], []
    vehicle = Vehicle.load(fleet.vehicle)
    for place, (recording, flight) in enumerate(was):
        given = Given(
            vehicle,
            flight,
            partial(_battery_of, fleet, recording),
            partial(_gust_of, case, place, simulation),
        )
        changed = recording
        for name, drawn in case.drawn.items():
            changed = CHANGES[name].recording(changed, drawn, given)
        try:
            flights.append(fused(changed, vehicle))
        except QuadpiError as error:
            refused.append(one_line(error))
    return flights


def _battery_of(fleet: Fleet, recording: Recording) -> tuple[npt.NDArray[np.int64], Array]:
    """Of the recording, or of the fleet's log for all, stretched to its duration."""
    if recording.battery is not None:
        return recording.battery.time_ns, recording.battery.voltage
    assert fleet.battery is not None
    other = read_recording(fleet.battery.paths[0], Vehicle.load("crazyflie_rpm"), None)
    assert other.battery is not None
    battery = other.battery
    share = (battery.time_ns - battery.time_ns[0]) / np.ptp(battery.time_ns)
    first, last = recording.imu.time_ns[[0, -1]]
    return first + np.rint(share * (last - first)).astype(np.int64), battery.voltage


def _gust_of(case: Case, place: int, simulation: Simulation) -> tuple[Array, Array]:
    """The force that another flight measured and the model lacks, over the mass, in the world."""
    fleet = FLEETS[case.fleet]
    paths = (fleet.gusts or fleet.split(case.split)[0]).paths
    flight = fused(read(fleet, paths[place % len(paths)]), simulation.vehicle)
    lacking = residual(flight, simulation)[:, :3] / simulation.vehicle.mass_kg
    return flight.time, np.einsum("nij,nj->ni", rotation_matrix(flight.attitude), lacking)


def _intervals(
    simulation: Simulation, flights: Sequence[Flight], right: Simulation, were: Sequence[Flight]
) -> dict[str, Any]:
    """Axes whose intervals do not hold what they state, and those of them where the change shows."""
    shares, confidence = shares_inside(simulation, flights)
    before, _ = shares_inside(right, were)
    broken = ~as_many_as_stated(shares, confidence)
    fewer = shares.mean(axis=0) < before.mean(axis=0) - _SEEN
    names = np.array(AXES)
    return {
        "broken": names[broken].tolist(),
        "seen": names[broken & fewer].tolist(),
        "inside": {"before": before.mean(axis=0).tolist(), "after": shares.mean(axis=0).tolist()},
    }


def shares_inside(simulation: Simulation, flights: Sequence[Flight]) -> tuple[Array, float]:
    """By flight and axis (F, 6) the share of samples inside the intervals, and what these state."""
    shares, confidence = [], 1.0
    for flight in flights:
        margins = simulation.margins(flight)
        assert margins is not None  # of an identified model
        inside = inside_interval(residual(flight, simulation), margins.lower, margins.upper)
        shares.append(inside.mean(axis=0))
        confidence = margins.confidence
    return np.array(shares), confidence
