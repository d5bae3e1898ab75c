# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The cases: flights of which vehicle make the model, which are searched, and what is hidden in these."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from blind.cases import NULL, OUT, PAIR, SINGLE, SIZES

from hidden.changes import CHANGES, CONDITION, NOTHING, PAIRS, Drawn, Truth, drawn
from quadpi_core.paths import data_directory
from quadpi_core.vehicle import Vehicle

# What differs between flights of the model and those searched is real; nothing is changed.
REAL = "real"
KINDS = (NULL, SINGLE, CONDITION, OUT, PAIR, REAL)
TUNE, REPORT = HALVES = ("tune", "report")


@dataclass(frozen=True)
class Logs:
    """Some logs in the folder of real flights: a folder, and the names in it."""

    folder: str
    names: tuple[str, ...]

    @classmethod
    def of(cls, folder: str, pattern: str, numbers: str) -> Logs:
        """Logs whose names differ in a number alone; these are parted by spaces."""
        return cls(folder, tuple(pattern.format(number) for number in numbers.split()))

    @property
    def paths(self) -> list[Path]:
        """Their paths."""
        return [data_directory() / self.folder / name for name in self.names]


@dataclass(frozen=True)
class Fleet:
    """Flights of one vehicle, of which some make its model and others are searched.

    Attributes:
        half: TUNE or REPORT.
        vehicle: its file.
        logs: of the model, and searched unless there are `others`.
        of_model, searched: numbers of flights.
        mapping: of the logs.
        others: what is searched instead, as it is, with its right answers.
        truth: right answers of the others.
        nulls: splits without a change, or of the others as they are.
        gusts: logs whose measured forces are the gusts; those of the model unless given.
        strength: of its changes, in full sizes of the table: more where the model's intervals are wide.
        battery: logs of which the first has the battery of all, where these have none.
    """

    half: str
    vehicle: str
    logs: Logs
    of_model: int
    searched: int
    mapping: str | None = None
    others: Logs | None = None
    truth: Truth = NOTHING
    nulls: int = 6
    gusts: Logs | None = None
    battery: Logs | None = None
    strength: float = 1.0

    @property
    def folders(self) -> list[str]:
        """That its logs are in."""
        several = (self.logs, self.others, self.gusts, self.battery)
        return [logs.folder for logs in several if logs is not None]

    def split(self, number: int) -> tuple[Logs, Logs]:
        """Logs of the model, and those to search, of which the first that import are."""
        order = np.random.default_rng((zlib.crc32(self.logs.folder.encode()), number))
        shuffled = tuple(order.permutation(self.logs.names).tolist())
        model = replace(self.logs, names=tuple(sorted(shuffled[: self.of_model])))
        if self.others is None:
            return model, replace(self.logs, names=shuffled[self.of_model :])
        return model, replace(self.others, names=tuple(order.permutation(self.others.names).tolist()))


_BARE = Logs.of("imrc_brushless", "eckart{}", "00 01 02 03 04 06 07 08 09 11 12 13 14 15 16 17 18 19 20 21")
# The four whose rotor speeds are whole.
_BRUSHED = Logs.of("imrc_brushed", "jana{}", "00 02 03 10")
_NEUROBEM = Logs.of("neurobem", "bemnn202102{}.mat", "18170320seg2 18171908seg2 18172600seg1 23104803seg2")
_INDIFLIGHT = Logs.of("indiflight", "LOG00{}.BFL", "230 231 257 258 259 262 264 267 269 273 276 277 279 340")
_RUNS = {"multisine": 4, "random1": 4, "random2": 4, "square": 5}
_NANODRONE = Logs(
    "nanodrone_benchmark",
    tuple(f"{name}_20251017_run{run + 1}.parquet" for name, runs in _RUNS.items() for run in range(runs)),
)
_EIGHTS = Logs.of("imrc_payload", "eckart{}", "14 15 17 18 19 20 21 22 24 26 27")
_STEPS = Logs.of("imrc_payload", "eckart{}", "43 45 46 47 51 52 53 61 62 67 68 69 72 73 82 83")
_ALL = replace(_EIGHTS, names=_EIGHTS.names + _STEPS.names)
# 4.7 g on 0.52 m, and 2.7 g of hook and markers, which are rigid.
_LOAD = Truth(
    (("slung_load",), ("slung_load", "payload")),
    parameters={"slung_load.mass_kg": 0.0047, "slung_load.length_m": 0.52, "payload.mass_kg": 0.0027},
)
# One file for both: 2.3 g lighter, and in hover 1.98e-8 for 3.67e-8 N s²; see results/discovery-real.md.
_MOTORS = Truth(
    (("thrust_coefficient",), ("rotor_speed_scale",)),
    parameters={"thrust_coefficient.change": -0.43, "rotor_speed_scale.rotor": 0},
)
FLEETS: Mapping[str, Fleet] = {
    "crazyflie": Fleet(TUNE, "crazyflie_rpm", _BARE, 10, 6, nulls=20, gusts=_STEPS),
    "neurobem": Fleet(TUNE, "neurobem", _NEUROBEM, 2, 2, nulls=3, strength=2.0),
    "loaded-eights": Fleet(TUNE, "crazyflie_rpm", _BARE, 10, 8, others=_EIGHTS, truth=_LOAD, nulls=10),
    "nanodrone": Fleet(REPORT, "nanodrone", _NANODRONE, 8, 5, "nanodrone", strength=2.0),
    "indiflight": Fleet(REPORT, "indiflight", _INDIFLIGHT, 7, 4, battery=_BARE, strength=2.0),
    "brushed": Fleet(REPORT, "crazyflie_rpm", _BRUSHED, 2, 2, nulls=3),
    "brushed-beside-brushless": Fleet(
        REPORT, "crazyflie_rpm", _BARE, 10, 3, others=_BRUSHED, truth=_MOTORS, nulls=20
    ),
    "loaded-steps": Fleet(REPORT, "crazyflie_rpm", _BARE, 10, 8, others=_STEPS, truth=_LOAD, nulls=10),
    "loaded": Fleet(REPORT, "crazyflie_rpm", _BARE, 10, 8, others=_ALL, truth=_LOAD, nulls=20),
}


@dataclass(frozen=True)
class Case:
    """A search: changes of a size in the searched flights of a split of a fleet's; none for NULL and REAL."""

    fleet: str
    kind: str
    changes: tuple[str, ...]
    size: float
    split: int

    @property
    def key(self) -> str:
        """Its name; the search gets flights alone."""
        words = "+".join(self.changes).replace(" ", "-") or self.kind
        return f"{self.fleet}-{words}-{self.size:g}-{self.split}"

    @property
    def drawn(self) -> dict[str, Drawn]:
        """By name of each change what chance decides: the same for all sizes."""
        size = self.size * FLEETS[self.fleet].strength
        return {
            name: drawn(name, size, zlib.crc32(f"{self.fleet} {name} {self.split}".encode()))
            for name in self.changes
        }

    def truth(self) -> Truth:
        """The right answers."""
        fleet = FLEETS[self.fleet]
        vehicle, found = Vehicle.load(fleet.vehicle), fleet.truth
        for name, own in self.drawn.items():
            found = found.beside(CHANGES[name].truth(own, vehicle))
        return found


def all_cases(*, splits: int = 2, sizes: Sequence[float] = SIZES) -> list[Case]:
    """Every case, in an order that a seed shuffles: the first of them are a fair sample."""
    cases: list[Case] = []
    for name, fleet in FLEETS.items():
        as_it_is = NULL if fleet.others is None else REAL
        cases += [Case(name, as_it_is, (), 1.0, number) for number in range(fleet.nulls)]
        if fleet.others is not None:
            continue
        for number in range(splits):
            cases += [
                Case(name, change.kind, (own,), size, number)
                for own, change in CHANGES.items()
                for size in sizes
            ]
            cases += [Case(name, PAIR, pair, 1.0, number) for pair in PAIRS]
    order = np.random.default_rng(0).permutation(len(cases))
    return [cases[index] for index in order]


def short_cases() -> list[Case]:
    """A few that are plain to see, of one split of one model."""
    kinds = ((NULL, ()), (SINGLE, ("fast rotors",)), (SINGLE, ("wind",)), (OUT, ("battery",)))
    return [Case("crazyflie", kind, changes, 1.0, 0) for kind, changes in kinds] + [
        Case("crazyflie", PAIR, PAIRS[0], 1.0, 0),
        Case("loaded", REAL, (), 1.0, 0),
    ]
