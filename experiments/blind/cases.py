# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The cases of the benchmark. What is hidden in one is sealed: only flights and the seal leave this file."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from blind import elsewhere
from blind.effects import EFFECTS, OUTSIDE, altered
from blind.specimen import Specimen, flights_of, ordinary
from quadpi_core.discrepancy.simulations import Simulation, VehicleSimulation
from quadpi_core.flight import Flight
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite

VEHICLE = "bebop2"
NOISE = "paper"
RICH, CHECK, HOVER = "discovery", "discovery_check", "discovery_hover"
SIZES = (1.0, 0.5, 0.25)
PAIRS = (
    ("rotor_drag", "ground_effect"),
    ("wind", "payload"),
    ("translational_lift", "rate_damping"),
    ("gyroscopic", "body_drag"),
    ("blade_flapping", "weak_rotor"),
    ("spin_up", "cg_offset"),
    ("sensor_delay", "rotor_drag"),
    ("vortex_ring", "inertia"),
    ("rotor_interaction", "imu_misalignment"),
    ("tether", "thrust_coefficient"),
)
# Kinds of cases; ELSE are flights of RotorPy.
KINDS = ("null", "single", "outside", "pair", "under-excited", "RotorPy")
NULL, SINGLE, OUT, PAIR, POOR, ELSE = KINDS


@dataclass(frozen=True)
class Hidden:
    """What is hidden in a case.

    Attributes:
        kind: NULL, SINGLE, OUT, PAIR, POOR or ELSE.
        effects: their names.
        size: of each, 1 being typical.
        seed: of the vehicle, of directions and of noise.
    """

    kind: str
    effects: tuple[str, ...]
    size: float
    seed: int

    def sealed(self) -> str:
        """As text that does not tell it at a glance; the scorer opens it."""
        return json.dumps([self.kind, self.effects, self.size, self.seed]).encode().hex()

    @classmethod
    def opened(cls, seal: str) -> Hidden:
        kind, effects, size, seed = json.loads(bytes.fromhex(seal))
        return cls(kind, tuple(effects), size, seed)


@dataclass(frozen=True)
class Case:
    """One search: flights of one vehicle, and the seal of what is hidden in them."""

    seal: str

    @property
    def key(self) -> str:
        """A name that tells nothing."""
        return hashlib.sha256(self.seal.encode()).hexdigest()[:12]

    def flights(self) -> list[Flight]:
        """To search in."""
        hidden = Hidden.opened(self.seal)
        if hidden.kind == ELSE:
            seed = zlib.crc32(self.seal.encode())
            return elsewhere.flights_of(hidden.effects, _plans(RICH), SensorSuite.load(NOISE), seed)
        return _flown(hidden, HOVER if hidden.kind == POOR else RICH)

    def simulation(self) -> Simulation:
        """To search with: of the vehicle as its file says."""
        if Hidden.opened(self.seal).kind == ELSE:
            return elsewhere.simulation()
        return VehicleSimulation.load(VEHICLE)

    def checks(self) -> list[Flight]:
        """Of the same vehicle, to check on what was found; none where they show little or take long."""
        hidden = Hidden.opened(self.seal)
        return [] if hidden.kind in {POOR, ELSE} else _flown(hidden, CHECK)


def true_parameters(hidden: Hidden) -> Mapping[str, float]:
    """What the library's effects should have, by `effect.parameter`, where both mean the same."""
    return {} if hidden.kind == ELSE else _specimen(hidden).truth


def noise_alone() -> tuple[list[Flight], Simulation]:
    """Flights to check on, of a vehicle that is exactly as its file says."""
    specimen = Specimen(SimulatedVehicle.load(VEHICLE))
    flights = flights_of(specimen, _plans(CHECK), SensorSuite.load(NOISE), 0)
    return flights, VehicleSimulation.load(VEHICLE)


def _flown(hidden: Hidden, scenario: str) -> list[Flight]:
    suite, seed = SensorSuite.load(NOISE), _seed(hidden)
    return flights_of(_specimen(hidden), _plans(scenario), suite, seed + (scenario == CHECK))


def _seed(hidden: Hidden) -> int:
    return zlib.crc32(hidden.sealed().encode())


def _specimen(hidden: Hidden) -> Specimen:
    rng = np.random.default_rng(_seed(hidden))
    specimen = ordinary(SimulatedVehicle.load(VEHICLE), rng)
    for name in hidden.effects:
        specimen = altered(specimen, name, hidden.size, rng)
    return specimen


@lru_cache
def _plans(scenario: str) -> Sequence[FlightPlan]:
    return load_scenario(scenario).flights


def all_cases(*, seeds: int = 5, nulls: int = 100, sizes: Sequence[float] = SIZES) -> list[Case]:
    """Every case, in an order that a seed shuffles: the first of them are a fair sample."""
    # Cases of earlier seeds were looked at before the search was changed again.
    first = 25
    own = range(first, first + seeds)
    truths = _truths(own, range(10_500, 10_500 + nulls), range(20_000 + first, 20_000 + own.stop), sizes)
    if elsewhere.available():
        truths += [Hidden(ELSE, (name,), 1.0, first) for name in elsewhere.EFFECTS]
    return _sealed(truths)


def development_cases() -> list[Case]:
    """Of seeds that no other case has: to look at while the search changes."""
    return _sealed(_truths(range(1000, 1001), range(11_000, 11_020), range(21_000, 21_001), SIZES))


def _truths(seeds: range, nulls: range, poor: range, sizes: Sequence[float]) -> list[Hidden]:
    truths = [Hidden(NULL, (), 0.0, seed) for seed in nulls]
    for seed in seeds:
        truths += [Hidden(SINGLE, (name,), size, seed) for name in EFFECTS for size in sizes]
        truths += [Hidden(OUT, (name,), 1.0, seed) for name in OUTSIDE]
        truths += [Hidden(PAIR, pair, 1.0, seed) for pair in PAIRS]
    return truths + [Hidden(POOR, (name,), 1.0, seed) for seed in poor for name in EFFECTS]


def short_cases() -> list[Case]:
    """One or two of every kind, each plain to see."""
    truths = [Hidden(NULL, (), 0.0, 30_000)]
    truths += [Hidden(SINGLE, (name,), 1.0, 30_000) for name in ("weak_rotor", "spin_up")]
    truths += [Hidden(OUT, ("thrust_fade",), 1.0, 30_000), Hidden(PAIR, PAIRS[0], 1.0, 30_000)]
    truths += [Hidden(POOR, ("thrust_coefficient",), 1.0, 30_000)]
    return _sealed(truths)


def _sealed(truths: Sequence[Hidden]) -> list[Case]:
    order = np.random.default_rng(0).permutation(len(truths))
    return [Case(truths[index].sealed()) for index in order]
