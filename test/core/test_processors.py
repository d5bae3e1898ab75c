# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A replay has the same bits on every processor: its calls of the core are repeated on others."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from benchmarks.random_ensembles import random_ensembles, simulation_inputs
from benchmarks.synthetic_inputs import smooth_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.replay import replay
from quadpi_core.vehicle import Vehicle

from .recorded_calls import recorded_calls

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
DRIVER = ROOT / "core" / "driver" / "repeat_calls.cpp"
FLIGHTS = ("interpolation", "extrapolation", "faults")
# As core/CMakeLists.txt has them.
OPTIONS = ("-std=c++17", "-O3", "-ffp-contract=off", "-fwrapv", "-I", str(ROOT / "core" / "include"))
# Compiler with its options, and emulator.
PROCESSORS = {
    "x86-64 of 2003": (("x86_64-linux-gnu-g++", "-march=x86-64"), ()),
    "x86-64 with AVX2": (("x86_64-linux-gnu-g++", "-march=x86-64-v3", "-mno-fma"), ()),
    "aarch64": (("aarch64-linux-gnu-g++", "-static"), ("qemu-aarch64",)),
}


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, physical_folder: Path) -> dict[Path, str]:
    """Calls of replays and of ensembles, and what the driver prints of each where the bits are the same."""
    folder = tmp_path_factory.mktemp("calls")
    vehicle, settings = Vehicle.load("bebop2"), MonitorSettings(adaptive=True)
    polynomial, physical = map(AerodynamicModel.load, (ROOT / "test/golden/model", physical_folder))
    expected = {}

    def record(name: str, work: Callable[[], object]) -> None:
        with recorded_calls(folder / name) as sums:
            work()
        expected[folder / name] = "".join(f"{called} {sums[called]:08x}\n" for called in sorted(sums))

    for flight, model in zip(FLIGHTS, (polynomial, physical, polynomial), strict=True):
        bag = ROOT / "bags" / f"{flight}.mcap"
        record(flight, partial(replay, model, vehicle, bag, folder / "out.mcap", settings=settings))
    inputs = smooth_inputs(1000, seed=3, vehicle_name="neurobem")
    for method in ("bootstrap", "quality-driven"):
        ensembles = random_ensembles(method, inputs, simulation_inputs())
        record(method, partial(ensembles.evaluate, inputs, np.ones(6)))
    return expected


@pytest.mark.parametrize("processor", PROCESSORS)
def test_bits_of_replays_are_the_same_on(processor: str, recorded: dict[Path, str], tmp_path: Path) -> None:
    compiler, emulator = PROCESSORS[processor]
    for tool in (compiler[0], *emulator):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed")
    driver = str(tmp_path / "repeat_calls")
    subprocess.run((*compiler, *OPTIONS, str(DRIVER), "-o", driver), check=True)
    for calls, expected in recorded.items():
        ran = subprocess.run((*emulator, driver, str(calls)), check=True, capture_output=True, text=True)
        assert ran.stdout == expected, calls.name
