# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Renew the tables of results/mistakes.md: how often each mistake is named in real flights.

Each mistake is done to every real flight of a folder, and to the bundled ones. Flights are judged one by one,
so that sets of several change nothing. The same code and data give the same numbers.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from page_tables import RESULTS, ROOT, renew, stamp

from quadpi_core.flight import Recording
from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory, data_directory
from quadpi_core.report.table import Column, Table, markdown_table
from quadpi_core.screening.consistency import contradictions
from quadpi_core.vehicle import Vehicle

sys.path.insert(0, str(ROOT / "test" / "core"))

from mistakes import FRONT_REAR, LEFT_RIGHT, XY, frozen, imu, origin, rotors, vehicle

PAGE = RESULTS / "mistakes.md"
# Flights whose rotor speeds stand in for those of a flight.
_OTHERS = 3
# Flights of a set that are read with the files of other vehicles.
_SWAPPED = 8
_EYE = np.eye(3)

Done: TypeAlias = Callable[[Recording, Any], tuple[Recording, Any]]


class Flights(NamedTuple):
    """Logs of one data set, by pattern; their vehicle and mapping, where they have one."""

    pattern: str
    vehicle: str | None
    mapping: str | None = None


SETS = {
    "imrc_brushless": Flights("eckart*", "crazyflie_rpm"),
    "imrc_payload": Flights("eckart*", "crazyflie_rpm"),
    "imrc_brushed": Flights("jana*", "crazyflie_rpm"),
    "nanodrone_benchmark": Flights("*.parquet", "nanodrone", "nanodrone"),
    "indiflight": Flights("*.BFL", "indiflight"),
    "neurobem": Flights("*.mat", "neurobem"),
    "nanobench": Flights("*.csv", None, "nanobench"),
    "bundled": Flights("*.mcap", "bebop2"),
}
VEHICLES = ("crazyflie_rpm", "nanodrone", "indiflight", "neurobem", "bebop2", "hdbeetle")

_CHANNELS = [[b if column == a else column for column in range(4)] for a, b in combinations(range(4), 2)]
# What is done, in one way or several, and the mistake that should be named.
MOTION: Mapping[str, tuple[str, list[Done]]] = {
    "accelerometer x and y swapped": ("accelerometer axes", [imu(_EYE, XY)]),
    "accelerometer x, or y, reversed": ("accelerometer axes", [imu(_EYE, FRONT_REAR), imu(_EYE, LEFT_RIGHT)]),
    "accelerometer × 1.05": ("accelerometer scale", [imu(_EYE, 1.05 * _EYE)]),
    "accelerometer × 0.95": ("accelerometer scale", [imu(_EYE, 0.95 * _EYE)]),
    "origin 8 cm beside": (
        "mocap origin",
        [origin(0.08, 0, 0), origin(-0.08, 0, 0), origin(0, 0.08, 0), origin(0, -0.08, 0)],
    ),
    "origin 8 cm below": ("mocap origin", [origin(0, 0, 0.08)]),
    "origin 8 cm above": ("mocap origin", [origin(0, 0, -0.08)]),
    "origin 10 cm beside and above": ("mocap origin", [origin(0.06, -0.06, -0.053)]),
    "motion capture frozen for 1.5 s": ("frozen state", [frozen(1.5, share) for share in (0.35, 0.5, 0.65)]),
}
ROTORS: Mapping[str, tuple[str, list[Done]]] = {
    "two rotors on one channel": ("one channel", [rotors(columns) for columns in _CHANNELS]),
    "squares of rotor speeds": ("squared speeds", [rotors(power=2.0)]),
    "arms × 2": ("arms", [vehicle(rotor_positions=lambda p: 2.0 * p)]),
    "arms × 0.5": ("inertia", [vehicle(rotor_positions=lambda p: 0.5 * p)]),
    "mass × 1.2": ("thrust", [vehicle(mass_kg=lambda m: 1.2 * m)]),
    "mass × 0.8": ("thrust", [vehicle(mass_kg=lambda m: 0.8 * m)]),
}
FOREIGN = "rotor speeds of another flight"
SOUND = "nothing"
STATELESS = ("two rotors on one channel", "arms × 2", "arms × 0.5", FOREIGN)


def foreign(other: Recording) -> Done:
    """The rotor speeds of another flight, from the first sample on."""

    def done(recording: Recording, of: Any) -> tuple[Recording, Any]:
        speeds, own = other.rotor_speeds, recording.rotor_speeds
        assert speeds is not None
        assert own is not None
        moved = replace(speeds, time_ns=speeds.time_ns - speeds.time_ns[0] + own.time_ns[0])
        return replace(recording, rotor_speeds=moved), of

    return done


def _logs(data: Path, name: str) -> list[Path]:
    folder = bags_directory() if name == "bundled" else data / name
    return sorted(folder.glob(SETS[name].pattern))


def judged(data: Path, name: str, place: int) -> list[tuple[str, bool]]:
    """The mistakes done to one flight of a set, each with whether it is named, or of none, something is."""
    logs, (_, of, mapping) = _logs(data, name), SETS[name]
    flown = None if of is None else Vehicle.load(of)
    recording = read_recording(logs[place], flown, mapping)
    sound = {finding.mistake for finding in contradictions(recording, flown)}
    answers = [(SOUND, bool(sound))]
    for what, (named, ways) in _mistakes(recording, flown, data, name, place):
        for done in ways:
            # Of motion the rotors say nothing, nor the state of what the rotors alone show.
            changed, its = done(recording, None if what in MOTION else flown)
            if what in STATELESS:
                changed = replace(changed, pose=None, twist=None, odometry=None)
            answers.append((what, named in {found.mistake for found in contradictions(changed, its)}))
    if flown is not None and recording.rotor_speeds is not None and place < _SWAPPED:
        for other in VEHICLES:
            found = {one.mistake for one in contradictions(recording, Vehicle.load(other))}
            answers.append((f"vehicle {other}", bool(found - sound)))
    return answers


def _mistakes(
    recording: Recording, flown: Vehicle | None, data: Path, name: str, place: int
) -> Iterator[tuple[str, tuple[str, list[Done]]]]:
    if recording.pose is not None:
        yield from MOTION.items()
    else:
        yield from ((what, one) for what, one in MOTION.items() if what.startswith("accelerometer"))
    if flown is None or recording.rotor_speeds is None:
        return
    yield from (
        (what, one)
        for what, one in ROTORS.items()
        if flown.thrust_coefficient is not None or not what.startswith("mass")
    )
    logs = _logs(data, name)
    steps = np.random.default_rng(place).permutation(np.arange(1, len(logs)))[:_OTHERS]
    others = [read_recording(logs[(place + step) % len(logs)], flown, SETS[name].mapping) for step in steps]
    yield FOREIGN, ("foreign rotors", [foreign(one) for one in others])


def tables(counts: Mapping[str, Counter[tuple[str, bool]]]) -> dict[str, str]:
    """Both tables, of the answers to each set."""
    names = list(counts)

    def shares(whats: Mapping[str, str]) -> str:
        rows = [[label, *(_share(counts[name], what) for name in names)] for what, label in whats.items()]
        columns = [Column("", is_text=True), *(Column(name, is_text=True) for name in names)]
        return markdown_table(Table(columns, rows))

    files = {f"vehicle {one}": f"`{one}`" for one in VEHICLES}
    return {
        "named": shares({what: what for what in (SOUND, *MOTION, *ROTORS, FOREIGN)}) + f"\n\n{stamp()}",
        "vehicles": shares(files),
    }


def _share(counts: Counter[tuple[str, bool]], what: str) -> str:
    named, silent = counts[what, True], counts[what, False]
    return f"{named} / {named + silent}" if named + silent else "–"


def main() -> None:
    """Judge every flight, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=data_directory(), help="folder of real flights")
    parser.add_argument("--only", choices=SETS, action="append", help="print the tables of these sets alone")
    parser.add_argument("--workers", type=int, help="processes; all cores by default")
    options = parser.parse_args()
    counts: dict[str, Counter[tuple[str, bool]]] = {}
    with ProcessPoolExecutor(options.workers) as workers:
        for name in options.only or SETS:
            found = workers.map(partial(judged, options.data, name), range(len(_logs(options.data, name))))
            counts[name] = Counter(answer for answers in found for answer in answers)
    renewed = tables(counts)
    if options.only:
        print("\n\n".join(renewed.values()))
    else:
        renew(PAGE, renewed)


if __name__ == "__main__":
    main()
