# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The cases of the independent benchmark, and their flights, flown once and kept by hash."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import json
import os
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from blind.cases import NULL, OUT, SINGLE, Hidden

from independent import flying, recording
from independent.airframes import HERE, Airframe, airframes
from independent.hidden_effects import EFFECTS, OUTSIDE, Flown, ordinary
from quadpi_core.paths import whole_outputs

SIZES = (1.0, 0.5)
# Looked at while the search changes; kept aside until they were opened; and for the end, see README.md.
DEVELOPMENT, OPENED, RESERVED = (1, 2, 3), tuple(range(101, 110)), (110, 111, 112)
NULLS_PER_SEED = 8
# Flights beside those searched, on which what is added is judged: the last of the paths, which are mixed.
CHECKS = 2
# What the flights depend on. Nothing of the library is among it.
_SOURCES = ("airframes", "hidden_physics", "hidden_effects", "flying", "nominal", "recording")


class NotFlownError(Exception):
    """RotorPy cannot fly a case: its controller loses the vehicle."""


def available() -> bool:
    """Whether RotorPy is installed."""
    return importlib.util.find_spec("rotorpy") is not None


def default_store() -> Path:
    """Where flights are kept: outside the repository, as `make clean` would cost hours."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return cache / "quadpi" / "independent-flights"


@dataclass(frozen=True)
class IndependentCase:
    """Flights of one vehicle, and the seal of what is hidden in them."""

    seal: str

    @property
    def hidden(self) -> Hidden:
        return Hidden.opened(self.seal)

    @property
    def key(self) -> str:
        """A name that tells nothing."""
        return hashlib.sha256(self.seal.encode()).hexdigest()[:12]

    @property
    def each_coefficient(self) -> bool:
        """Whether nothing is hidden, but every coefficient is off by a draw of its own: every second null."""
        return self.hidden.kind == NULL and self.hidden.seed % 4 >= 2

    @property
    def airframe(self) -> Airframe:
        """Half of the cases of every kind are of either vehicle."""
        hidden = self.hidden
        names = sorted((*EFFECTS, *OUTSIDE))
        place = names.index(hidden.effects[0]) if hidden.effects else 0
        return airframes()[(place + hidden.seed) % 2]

    def flown(self) -> tuple[Flown, np.random.Generator]:
        """The vehicle as it is, and what draws the rest of the case."""
        hidden = self.hidden
        rng = np.random.default_rng(zlib.crc32(self.seal.encode()))
        flown = ordinary(self.airframe, rng, each=self.each_coefficient)
        for name in hidden.effects:
            flown = {**EFFECTS, **OUTSIDE}[name](flown, hidden.size, rng)
        return flown, rng

    def logs(self, store: Path) -> list[Path]:
        """The tables of the flights, which are flown where the store does not hold them.

        Raises:
            NotFlownError: where RotorPy cannot fly one of them.
        """
        flown, rng = self.flown()
        folder = store / f"{self.key}-{generation()}"
        return _kept(folder, flown, flying.paths(self.airframe, rng), rng)

    def checks(self, store: Path) -> list[Path]:
        """Tables of further flights along other paths, which no search gets; see :meth:`logs`."""
        flown, _ = self.flown()
        rng = np.random.default_rng(zlib.crc32(f"{self.seal} checks".encode()))
        folder = store / f"{self.key}-checks-{generation()}"
        return _kept(folder, flown, flying.paths(self.airframe, rng)[-CHECKS:], rng)


def _kept(folder: Path, flown: Flown, paths: Sequence[flying.Path4], rng: np.random.Generator) -> list[Path]:
    """Tables of flights along paths in a folder, which are flown where it does not exist."""
    if not folder.exists():
        folder.parent.mkdir(parents=True, exist_ok=True)
        with whole_outputs(folder) as staging:
            for path in paths:
                try:
                    truth = flying.fly(flown, path, rng)
                except RuntimeError as error:
                    if "loses its path" not in str(error):
                        raise
                    raise NotFlownError(str(error)) from error
                recording.write(flown, truth, rng, staging)
            (staging / "truth.json").write_text(json.dumps(dict(flown.truth)), encoding="utf-8")
    return sorted(folder.glob("*.parquet"))


@lru_cache
def generation() -> str:
    """Hash of the code that flies."""
    digest = hashlib.sha256(importlib.metadata.version("rotorpy").encode())
    for name in _SOURCES:
        digest.update((HERE / f"{name}.py").read_bytes())
    return digest.hexdigest()[:12]


def benchmark_cases(seeds: Sequence[int] = DEVELOPMENT) -> list[IndependentCase]:
    """Every case of some seeds: full size first and shuffled, so that the first are a fair sample."""
    truths: list[Hidden] = []
    for size in SIZES:
        for seed in seeds:
            some = [Hidden(SINGLE, (name,), size, seed) for name in EFFECTS]
            if size == SIZES[0]:
                some += [Hidden(OUT, (name,), size, seed) for name in OUTSIDE]
                some += [Hidden(NULL, (), 0.0, 1000 * seed + number) for number in range(NULLS_PER_SEED)]
            order = np.random.default_rng(seed).permutation(len(some))
            truths += [some[index] for index in order]
    return [IndependentCase(truth.sealed()) for truth in truths]


def short_cases() -> list[IndependentCase]:
    """A few that are plain to see, of a seed of their own."""
    truths = [Hidden(NULL, (), 0.0, 5000), Hidden(SINGLE, ("weak_rotor",), 1.0, 50)]
    return [IndependentCase(truth.sealed()) for truth in truths]
