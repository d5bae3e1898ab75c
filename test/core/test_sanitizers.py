# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The functions of the core under the sanitizers of addresses and of undefined behaviour."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Each function of the core that works on arrays, once; in other tests Python takes far longer than the core.
TESTS = (
    "estimator",
    "models/test_evaluated_ensembles.py",
    "models/test_fitted_polynomial.py",
    "models/test_physical_kernel.py",
    "models/test_physical_regressors.py",
    "monitor/test_pairing.py",
    "monitor/test_preparation.py",
    "signals",
    "simulation/test_applied_effects.py",
    "test_elementary.py",
    "test_inputs.py",
)
FLAGS = "-O1 -g1 -Werror -fsanitize=address,undefined -fno-sanitize-recover=undefined"


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The core, built with both."""
    folder = tmp_path_factory.mktemp("sanitized")
    options = {
        "CMAKE_BUILD_TYPE": "Debug",
        "CMAKE_CXX_FLAGS": FLAGS,
        "Python_EXECUTABLE": sys.executable,
        "QUADPI_MODULE_FOLDER": str(folder),
    }
    given = [f"-D{name}={value}" for name, value in options.items()]
    build = str(folder / "build")
    for command in (("-S", str(ROOT / "core"), "-B", build, *given), ("--build", build, "--parallel")):
        ran = subprocess.run(("cmake", *command), check=False, capture_output=True, text=True)
        assert ran.returncode == 0, ran.stdout + ran.stderr
    (module,) = folder.glob("_core.*.so")
    return module


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="the sanitizers are asked of g++ by name")
def test_nothing_is_read_or_written_beside_an_array_and_nothing_is_undefined(sanitized: Path) -> None:
    names = ("libasan.so", "libubsan.so")
    libraries = [
        subprocess.run(
            ("g++", f"-print-file-name={name}"), check=True, capture_output=True, text=True
        ).stdout.strip()
        for name in names
    ]
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT / "test"),
        "QUADPI_SANITIZED": str(sanitized),
        "LD_PRELOAD": " ".join(libraries),
        # Python keeps what it has until it ends.
        "ASAN_OPTIONS": "detect_leaks=0",
    }
    tests = [str(ROOT / "test" / "core" / test) for test in TESTS]
    options = ("-q", "-x", "-p", "sanitized_core", "-p", "no:cacheprovider", "-m", "not slow")
    command = (sys.executable, "-m", "pytest", *options, *tests)
    ran = subprocess.run(command, check=False, capture_output=True, text=True, cwd=ROOT, env=environment)
    assert ran.returncode == 0, ran.stdout[-5000:] + ran.stderr[-5000:]
    assert " passed" in ran.stdout.splitlines()[-1]
