# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the tables of results/alarm.md on CHANGE: altered recordings of real flights through the live path.

Every second flight of the Crazyflie identifies a model, the others judge it, and the other way round; with
`--split` random halves do.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from alarm_tables import PAGE, model_of
from page_tables import renew, stamp

from quadpi_core.flight import Recording
from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.monitor.change import OF_THRUST
from quadpi_core.monitor.monitor import Monitor
from quadpi_core.monitor.preparation import Prepared
from quadpi_core.monitor.replay import monitored, recorded_flight
from quadpi_core.paths import data_directory
from quadpi_core.report.table import Column, Row, Table, markdown_table
from quadpi_core.results import (
    CAUSES,
    CHANGE,
    CHANGED_MASS,
    CHANGED_ROTOR,
    EXTRAPOLATION,
    LEVEL_ALARM,
    MISCOVERAGE,
)
from quadpi_core.vehicle import Vehicle

VEHICLE, METHOD = "crazyflie_rpm", "physical"
SOUND, LADEN = "imrc_brushless", "imrc_payload"
# Of the moments and rotors; while the method was set on these flights it was another one.
SEED = 2026
# From the first judged sample to a change, and from it to the last, at least.
_MARGIN_S = 2.0
_GRAVITY = 9.80665
# Longer than any flight.
_EVER_S = 1e6
# Hook, markers and payload of the laden flights, and how near to it a mass is to be named, when.
_LOAD_KG, _NEAR, _NAMED_S = 0.0397 + 0.0047 - 0.037, 0.15, 3.0
# Fewest flights for CHANGE: so many of the slower half identify the model that faster ones are judged by.
_SLOWER = 8


class Told(NamedTuple):
    """What the alarm says of a replay.

    Attributes:
        judged_ns: stamps of the first and the last row in which CHANGE was judged; None without one.
        raised_ns: at which it was raised; None where it was not.
        kind, rotor, size, lower, upper: of the change named last.
        early: size of a change of mass as named 3 s after the first of these rows; 0 for none.
    """

    judged_ns: tuple[int, int] | None
    raised_ns: int | None
    kind: int
    rotor: int
    size: float
    lower: float
    upper: float
    early: float = 0.0


@dataclass(frozen=True)
class Alteration:
    """What is done to a flight from a moment on.

    Attributes:
        name: of the row.
        from_start: whether it is there from the beginning.
        size: of it.
        recording: what it makes of a recording, from a stamp on, of a rotor.
        prepared: what it makes of samples that are prepared.
        kind: of the change that is to be named.
    """

    name: str
    from_start: bool
    size: float
    recording: Callable[[Recording, int, int, float], Recording] | None
    prepared: Callable[[Prepared, int, int, float, Vehicle], Prepared] | None
    kind: int


def faster_rotor(recording: Recording, begin_ns: int, rotor: int, share: float) -> Recording:
    """A rotor whose thrust is less than its speed says, by its speed; all of them for rotor −1."""
    stream = recording.rotor_speeds
    assert stream is not None
    speeds = stream.speeds.copy()
    columns = slice(None) if rotor < 0 else slice(rotor, rotor + 1)
    speeds[stream.time_ns >= begin_ns, columns] /= np.sqrt(1.0 - share)
    return replace(recording, rotor_speeds=replace(stream, speeds=speeds))


def all_faster(recording: Recording, begin_ns: int, _: int, share: float) -> Recording:
    """All rotors give less thrust than their speeds say: a bias of the force along z."""
    return faster_rotor(recording, begin_ns, -1, share)


def all_weaker(prepared: Prepared, begin_ns: int, _: int, share: float, vehicle: Vehicle) -> Prepared:
    """All rotors give less thrust: a bias of the measured force along z by a share of the weight."""
    measured = prepared.measured.copy()
    measured[prepared.usable_ns >= begin_ns, 2] += share * vehicle.mass_kg * _GRAVITY
    return prepared._replace(measured=measured)


def offset_accelerometer(recording: Recording, begin_ns: int, _: int, share: float) -> Recording:
    """An accelerometer that is off along z by a share of the weight."""
    force = recording.imu.specific_force.copy()
    force[recording.imu.time_ns >= begin_ns, 2] += share * _GRAVITY
    return replace(recording, imu=replace(recording.imu, specific_force=force))


def weaker_rotor(prepared: Prepared, begin_ns: int, rotor: int, share: float, vehicle: Vehicle) -> Prepared:
    """A rotor that gives less thrust, with its own arm."""
    measured = prepared.measured.copy()
    squares = np.square(prepared.derivatives["rotor_speeds"][:, : vehicle.rotor_count])
    thrust = share * vehicle.mass_kg * _GRAVITY * squares[:, rotor] / squares.sum(axis=1)
    x, y = vehicle.rotor_positions[rotor, :2]
    late = prepared.usable_ns >= begin_ns
    measured[late, 2:5] += thrust[late, np.newaxis] * np.array([1.0, y, -x])
    return prepared._replace(measured=measured)


ALTERATIONS = (
    Alteration("a rotor gives 5 % less, mid-flight", False, 0.05, None, weaker_rotor, CHANGED_ROTOR),
    Alteration("a rotor gives 3 % less, mid-flight", False, 0.03, None, weaker_rotor, CHANGED_ROTOR),
    Alteration("a rotor gives 2 % less, mid-flight", False, 0.02, None, weaker_rotor, CHANGED_ROTOR),
    Alteration("a rotor gives 2 % less, from take-off", True, 0.02, None, weaker_rotor, CHANGED_ROTOR),
    Alteration("a speed reads 1.0153 times, mid-flight", False, 0.03, faster_rotor, None, CHANGED_ROTOR),
    Alteration("a speed reads 1.0101 times, mid-flight", False, 0.02, faster_rotor, None, CHANGED_ROTOR),
    Alteration("a speed reads 1.0101 times, from take-off", True, 0.02, faster_rotor, None, CHANGED_ROTOR),
    Alteration("all speeds read 1.0076 times, mid-flight", False, 0.015, all_faster, None, CHANGED_MASS),
    Alteration("all rotors give 1.5 % of the weight less", False, 0.015, None, all_weaker, CHANGED_MASS),
    Alteration(
        "accelerometer off by 1.5 % of g, mid-flight", False, 0.015, offset_accelerometer, None, CHANGED_MASS
    ),
)


def told_of(
    model: AerodynamicModel,
    vehicle: Vehicle,
    recording: Recording,
    alter: Callable[[Prepared], Prepared] = lambda prepared: prepared,
) -> Told:
    """Replay a recording, as `quadpi replay` does, and sum up what the alarm says of a change."""
    monitor, column = Monitor(model, vehicle, None), CAUSES.index(CHANGE)
    judged, raised, last = [], [], None
    masses: list[tuple[int, float]] = [(0, 0.0)]
    for part, conditions in monitored(recorded_flight(recording, vehicle), [monitor]):
        _, alarms, _ = monitor.judge(alter(monitor.preparation.step(*part.samples, conditions)))
        health, level = alarms.cause_health[:, column], alarms.cause_level[:, column]
        judged += alarms.time_ns[(health == 0) | (health == 3)].tolist()
        raised += alarms.time_ns[level == LEVEL_ALARM].tolist()
        mass = np.where(alarms.changed == CHANGED_MASS, alarms.change_size, 0.0)
        masses += zip(alarms.time_ns.tolist(), mass.tolist(), strict=True)
        if len(alarms) and level[-1] == LEVEL_ALARM:
            last = alarms
    until_ns = judged[0] + 1e9 * _NAMED_S if judged else 0.0
    told = Told(
        (judged[0], judged[-1]) if judged else None,
        raised[0] if raised else None,
        0 if last is None else int(last.changed[-1]),
        0 if last is None else int(last.changed_rotor[-1]),
        *(
            (0.0, 0.0, 0.0)
            if last is None
            else (last.change_size[-1], last.change_lower[-1], last.change_upper[-1])
        ),
    )
    return told._replace(early=next(size for time_ns, size in reversed(masses) if time_ns <= until_ns))


class Causes(NamedTuple):
    """Which causes a replay raises.

    Attributes:
        extrapolation, evidence: the cause, and either of MISCOVERAGE and CHANGE.
        beyond: whether an input or leverage is beyond the limit of an alarm, but for the inputs of thrust.
    """

    extrapolation: bool
    evidence: bool
    beyond: bool


def causes_of(model: AerodynamicModel, vehicle: Vehicle, recording: Recording) -> Causes:
    """Replay a recording, as `quadpi replay` does."""
    monitor, raised, beyond = Monitor(model, vehicle, None), np.zeros(len(CAUSES), dtype=bool), False
    for part, conditions in monitored(recorded_flight(recording, vehicle), [monitor]):
        _, alarms, _ = monitor.step(*part.samples, conditions)
        if len(alarms):
            raised |= (alarms.cause_level == LEVEL_ALARM).any(axis=0)
            scores = (alarms.input_score[:, ~OF_THRUST], alarms.leverage, alarms.width)
            beyond = beyond or max(float(score.max()) for score in scores) > 1.0
    evidence = raised[[CAUSES.index(MISCOVERAGE), CAUSES.index(CHANGE)]].any()
    return Causes(bool(raised[CAUSES.index(EXTRAPOLATION)]), bool(evidence), beyond)


def flights_of(data: Path, split: int | None) -> list[Path]:
    """The sound flights, in an order of which every second one belongs together."""
    paths = sorted((data / SOUND).iterdir())
    if split is None:
        return paths
    return [paths[k] for k in np.random.default_rng(split).permutation(len(paths))]


def told_apart(data: Path, split: int | None) -> str:
    """The table of faster flights and of changed vehicles."""
    vehicle = Vehicle.load(VEHICLE)
    paths, laden = flights_of(data, split), sorted((data / LADEN).iterdir())
    counts: dict[str, list[Causes]] = {}

    def judge(name: str, model: AerodynamicModel, recording: Recording) -> Causes:
        found = causes_of(model, vehicle, recording)
        counts.setdefault(name, []).append(found)
        return found

    def identified(flights: Sequence[Path]) -> AerodynamicModel:
        return model_of(prepare_flights(flights, vehicle, CUTOFF_HZ["default"]), VEHICLE, METHOD)

    # They are named by their speeds.
    half = sorted(paths)[len(paths) // 2]
    slower, faster = ([path for path in paths if (path < half) == is_slower] for is_slower in (True, False))
    model = identified(slower if split is None else slower[:_SLOWER])
    for path in faster:
        judge(
            "the faster half of the flights, by a model of slower ones", model, read_recording(path, vehicle)
        )
    for parity in (0, 1):
        model = identified(paths[parity::2])
        for path in paths[1 - parity :: 2]:
            recording = read_recording(path, vehicle)
            judge("sound, by a model of every second flight", model, recording)
            for share in (0.03, 0.06):
                weaker = all_faster(recording, 0, 0, share)
                judge(f"{100.0 * share:g} % less thrust of all rotors", model, weaker)
    model = identified(paths if split is None else paths[::2])
    for path in laden:
        found = causes_of(model, vehicle, read_recording(path, vehicle))
        name = (
            "beyond the envelope in another input too"
            if found.beyond
            else "inside it, but for its rotor speeds"
        )
        counts.setdefault(f"payload, {name}", []).append(found)
    rows: list[Row] = [
        [
            name,
            str(len(of)),
            str(sum(one.extrapolation and not one.evidence for one in of)),
            str(sum(one.evidence and not one.extrapolation for one in of)),
            str(sum(one.evidence and one.extrapolation for one in of)),
        ]
        for name, of in counts.items()
    ]
    headings = ("replays", "EXTRAPOLATION alone", "evidence alone", "both")
    return markdown_table(Table([Column("flights", is_text=True), *map(Column, headings)], rows))


def row_of(
    name: str,
    delays: Sequence[float],
    right: Sequence[bool],
    sizes: Sequence[float],
    held: Sequence[bool | None],
) -> Row:
    """A row of the table; delays are infinite where no alarm came."""
    late = np.array(delays)
    shares = [f"{100.0 * np.mean(late <= limit):.0f} %" for limit in (0.5, 1.5, 3.0, _EVER_S)]
    found = np.isfinite(late)
    named = f"{100.0 * np.mean(np.array(right)[found]):.0f} %" if found.any() else "–"
    size = f"{100.0 * float(np.median(np.array(sizes)[found])):.2g} %" if found.any() else "–"
    holds = [one for one, of in zip(held, right, strict=True) if of and one is not None]
    holding = f"{100.0 * np.mean(holds):.0f} %" if holds else "–"
    return [name, str(len(late)), *shares, named, size, holding]


def changes(data: Path, repeats: int, split: int | None) -> str:
    """The table, and how many payloads are named by their mass in time."""
    vehicle, random = Vehicle.load(VEHICLE), np.random.default_rng(SEED if split is None else (SEED, split))
    near: list[bool] = []
    delays: dict[str, list[float]] = {}
    right: dict[str, list[bool]] = {}
    sizes: dict[str, list[float]] = {}
    held: dict[str, list[bool | None]] = {}

    def note(name: str, delay: float, named: bool, size: float, holds: bool | None = None) -> None:
        for column, value in ((delays, delay), (right, named), (sizes, size), (held, holds)):
            column.setdefault(name, []).append(value)  # type: ignore[arg-type]

    paths = flights_of(data, split)
    for half in (0, 1):
        model = model_of(prepare_flights(paths[half::2], vehicle, CUTOFF_HZ["default"]), VEHICLE, METHOD)
        for path in paths[1 - half :: 2]:
            recording = read_recording(path, vehicle)
            sound = told_of(model, vehicle, recording)
            assert sound.judged_ns is not None
            first, last = sound.judged_ns
            delay = np.inf if sound.raised_ns is None else 1e-9 * (sound.raised_ns - first)
            note("sound", delay, False, sound.size)
            for alteration in ALTERATIONS:
                for _ in range(1 if alteration.from_start else repeats):
                    rotor, margin_ns = int(random.integers(vehicle.rotor_count)), 1e9 * _MARGIN_S
                    spare = max(last - first - 2.5 * margin_ns, 0.0)
                    begin_ns = int(first + margin_ns + random.uniform() * spare)
                    if alteration.from_start:
                        begin_ns = int(recording.imu.time_ns[0])
                    change = (begin_ns, rotor, alteration.size)
                    told = told_of(
                        model,
                        vehicle,
                        alteration.recording(recording, *change) if alteration.recording else recording,
                        lambda prepared, a=alteration, c=change: (  # type: ignore[misc]
                            a.prepared(prepared, *c, vehicle) if a.prepared else prepared
                        ),
                    )
                    since = max(begin_ns, first)
                    delay = np.inf if told.raised_ns is None else 1e-9 * (told.raised_ns - since)
                    named = told.kind == alteration.kind and told.rotor in (0, rotor + 1)
                    size = told.size if told.kind == CHANGED_ROTOR else told.size / vehicle.mass_kg
                    true = alteration.size
                    if told.kind == CHANGED_MASS:
                        true = vehicle.mass_kg * true / (1.0 - true)
                    note(alteration.name, delay, named, size, told.lower <= true <= told.upper)
            print(f"{path.name}: sound {sound.raised_ns is None}", flush=True)
        for path in sorted((data / LADEN).iterdir())[half::2]:
            told = told_of(model, vehicle, read_recording(path, vehicle))
            first = told.judged_ns[0] if told.judged_ns else 0
            delay = np.inf if told.raised_ns is None else 1e-9 * (told.raised_ns - first)
            note("payload of 12 %", delay, told.kind == CHANGED_MASS, told.size / vehicle.mass_kg)
            near.append(abs(told.early - _LOAD_KG) <= _NEAR * _LOAD_KG)
    headings = (
        *("replays", "within 0.5 s", "1.5 s", "3 s", "at all", "of these named right", "size, median"),
        "its interval holds",
    )
    rows = [row_of(name, delays[name], right[name], sizes[name], held[name]) for name in delays]
    table = markdown_table(Table([Column("flights", is_text=True), *map(Column, headings)], rows))
    found = f"Payloads named with {1e3 * _LOAD_KG:.1f} g ± {100.0 * _NEAR:g} % after {_NAMED_S:g} s"
    return f"{table}\n\n{found}: {sum(near)} of {len(near)}."


def main(arguments: Sequence[str] | None = None) -> None:
    """Renew the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help=f"folder that holds {SOUND}/")
    parser.add_argument("--page", type=Path, default=PAGE, help="to renew")
    parser.add_argument("--repeats", type=int, default=3, help="moments in each flight")
    parser.add_argument("--split", type=int, help="seed of random halves in the place of every second flight")
    parser.add_argument("--only", choices=("apart", "changes"), help="one of the tables")
    options = parser.parse_args(arguments)
    data = options.data.resolve()
    if options.only != "changes":
        renew(options.page, {"apart": f"{told_apart(data, options.split)}\n\n*{stamp()}*"})
    if options.only != "apart":
        renew(options.page, {"changes": f"{changes(data, options.repeats, options.split)}\n\n*{stamp()}*"})


if __name__ == "__main__":
    main()
