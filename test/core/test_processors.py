# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A replay has the same bits on every processor.

Its calls of the core are repeated on others, and libraries choose as they would there.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

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
REPLAYS = (
    ("polynomial", "faults"),
    ("physical", "extrapolation"),
    ("bootstrap", "faults"),
    ("quality-driven", "faults"),
)
# As core/CMakeLists.txt has them.
OPTIONS = ("-std=c++17", "-O3", "-ffp-contract=off", "-fwrapv", "-I", str(ROOT / "core" / "include"))
# Compiler with its options, and emulator.
PROCESSORS = {
    "x86-64 of 2003": (("x86_64-linux-gnu-g++", "-march=x86-64"), ()),
    "x86-64 with AVX2": (("x86_64-linux-gnu-g++", "-march=x86-64-v3", "-mno-fma"), ()),
    "aarch64": (("aarch64-linux-gnu-g++", "-static"), ("qemu-aarch64",)),
}

_NUMPY = import_module(f"numpy.{'core' if np.__version__.startswith('1.') else '_core'}._multiarray_umath")
# What libraries choose by processor, and what has them choose as on one of 2005.
CHOICES = {
    "loops of numpy": (
        "NPY_DISABLE_CPU_FEATURES",
        " ".join(name for name in _NUMPY.__cpu_dispatch__ if _NUMPY.__cpu_features__[name]),
    ),
    "functions of the C library": ("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX,-AVX2,-AVX512F,-FMA,-FMA4"),
    "products of OpenBLAS": ("OPENBLAS_CORETYPE", "Prescott"),
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


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory, physical_folder: Path) -> dict[str, Path]:
    """A model folder of each method; networks have random weights."""
    folder = tmp_path_factory.mktemp("models")
    folders = {"polynomial": ROOT / "test/golden/model", "physical": physical_folder}
    polynomial, inputs = AerodynamicModel.load(folders["polynomial"]), smooth_inputs(1000, seed=3)
    for method in ("bootstrap", "quality-driven"):
        folders[method] = folder / method
        fitted = random_ensembles(method, inputs, simulation_inputs())
        replace(polynomial, fitted=fitted).save(folders[method])
    return folders


def replayed(model: Path, flight: str, output: Path, **environment: str) -> bytes:
    """The bag that the command writes."""
    command = (
        sys.executable,
        "-m",
        "quadpi_core.cli",
        "replay",
        str(model),
        str(ROOT / "bags" / f"{flight}.mcap"),
    )
    subprocess.run(
        (*command, "-o", str(output), "--adaptive"),
        check=True,
        capture_output=True,
        env=os.environ | environment,
    )
    return output.read_bytes()


@pytest.fixture(scope="module")
def usual(models: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, str], bytes]:
    """What each model and flight give here."""
    folder = tmp_path_factory.mktemp("usual")
    return {
        (method, flight): replayed(models[method], flight, folder / "out.mcap") for method, flight in REPLAYS
    }


@pytest.mark.parametrize("choice", CHOICES)
def test_bits_of_replays_are_the_same_by_other(
    choice: str, models: dict[str, Path], usual: dict[tuple[str, str], bytes], tmp_path: Path
) -> None:
    variable, value = CHOICES[choice]
    if not value or platform.machine() != "x86_64":
        pytest.skip(f"there are no other {choice}")
    if choice == "functions of the C library" and platform.libc_ver()[0] != "glibc":
        pytest.skip("the C library is not glibc")
    if choice == "products of OpenBLAS" and all(
        own["internal_api"] != "openblas" for own in threadpool_info()
    ):
        pytest.skip("numpy has another BLAS")
    for (method, flight), expected in usual.items():
        found = replayed(models[method], flight, tmp_path / "out.mcap", **{variable: value})
        assert found == expected, f"{method}, {flight}"
