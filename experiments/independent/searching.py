# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One case searched as a user would: logs imported, bags read, each kind of simulation compared."""

from __future__ import annotations

import json
import logging
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from blind.searching import gap_left, rolled_out, rollout_changes

from independent.airframes import HERE
from independent.cases import IndependentCase, NotFlownError
from quadpi_core.discrepancy.augmented_simulation import augmented
from quadpi_core.discrepancy.closure import SearchResult
from quadpi_core.discrepancy.discrepancy_result import Discovery, discovery_json
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.other_simulations import RecordedSimulation
from quadpi_core.discrepancy.simulations import Simulation
from quadpi_core.discrepancy.study import found_and_flown, read_flights
from quadpi_core.errors import one_line
from quadpi_core.logs.importing import import_logs
from quadpi_core.parallel import Workers
from quadpi_core.vehicle import Vehicle

MAPPINGS = ("mocap", "odometry")
RECORDED, FUNCTION = "recorded", "function"
MODES = (RECORDED, FUNCTION)


class Task(NamedTuple):
    """A case, where its flights are kept, and how they are imported."""

    case: IndependentCase
    store: Path
    mapping: str

    @property
    def key(self) -> str:
        """Names the task, and tells nothing of what is hidden."""
        return f"{self.case.key}-{self.mapping}"


def searched(shared: None, task: Task) -> list[dict[str, Any]]:  # noqa: ARG001
    """Per kind of simulation what the search says, beside the seal and the true parameters.

    Nothing of a case that RotorPy cannot fly.
    """
    case, found = task.case, []
    # What the reader says of rows without a pose would be said of every flight.
    logging.getLogger("quadpi_core").setLevel(logging.ERROR)
    try:
        logs = case.logs(task.store)
    except NotFlownError:
        return []
    truth = json.loads((logs[0].parent / "truth.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as folder:
        bags = _imported(task, logs, Path(folder))
        vehicle = str(case.airframe.file)
        names = {RECORDED: RECORDED, FUNCTION: f"independent.nominal:{case.airframe.name}"}
        flights = None
        for mode in MODES:
            began = time.perf_counter()
            detail: dict[str, Any] = {}
            left, changes, seconds = None, None, None
            try:
                simulation = load_simulation(names[mode], vehicle, bags)
                flights = flights or read_flights(bags, simulation, workers=Workers(1))
                discovery = found_and_flown(simulation, flights)
                result, detail = discovery_json(discovery), _detail(discovery.found)
                seconds = time.perf_counter() - began
                if discovery.added:
                    left, changes = _checked(task, simulation, discovery, Path(folder) / f"{mode}-checks")
            except Exception as error:
                # Whatever is raised on possible flights is a failure to list, not the end of the run.
                result = {"verdict": f"error: {one_line(error)}", "effects": [], "ambiguous": []}
                left, changes = None, None
            found.append(
                {
                    "seal": case.seal,
                    "vehicle": case.airframe.name,
                    "mapping": task.mapping,
                    "mode": mode,
                    "each_coefficient": case.each_coefficient,
                    "truth": truth,
                    "seconds": seconds or time.perf_counter() - began,
                    "left": left,
                    "rollouts": changes,
                    "result": result,
                    "detail": detail,
                }
            )
    return found


def _checked(
    task: Task, simulation: Simulation, discovery: Discovery, folder: Path
) -> tuple[float | None, dict[str, tuple[float, float]] | None]:
    """What is added on flights that were not searched: see `scoring.Answer.left` and `rollouts`."""
    try:
        logs = task.case.checks(task.store)
    except NotFlownError:
        return None, None
    folder.mkdir()
    bags, added = _imported(task, logs, folder), augmented(discovery)
    if isinstance(simulation, RecordedSimulation) and isinstance(added.base, RecordedSimulation):
        # What its owner's simulation recorded beside these flights; nothing that was learned changes.
        recorded = RecordedSimulation.load(simulation.vehicle_file, bags).wrenches
        simulation = replace(simulation, wrenches=recorded)
        added = replace(added, base=replace(added.base, wrenches=recorded))
    flights = read_flights(bags, simulation, workers=Workers(1))
    left = gap_left(simulation, added, flights, np.square(discovery.gap.floor))
    return left, rollout_changes(rolled_out(flights, simulation, added))


def _imported(task: Task, logs: list[Path], folder: Path) -> list[Path]:
    vehicle = Vehicle.load(task.case.airframe.file)
    mapping = str(HERE / "mappings" / f"{task.mapping}.yaml")
    return [flight.bag for flight in import_logs(logs, vehicle, folder, mapping, workers=Workers(1))]


def _detail(found: SearchResult) -> dict[str, Any]:
    """What the search went by, to look at where it is wrong."""
    moved = zip(found.regression.tolerances.names, found.regression.moved_by(found.fit), strict=True)
    return {
        "coefficients": {name: float(value) for name, value in moved if abs(value) > 1.0},
        "noise": found.left.noise.tolist(),
        "threshold": found.threshold,
        "unexplained": [float(value) for value in found.left.gain],
        "judgements": [
            f"{judged.label} beside {'+'.join(judged.beside) or 'nothing'}: "
            f"{'accepted' if judged.accepted else 'rejected'}, {judged.reason.sentence}"
            for judged in found.judgements
            if judged.accepted or judged.reason.test not in {"evidence", "precedence"}
        ][:12],
    }
