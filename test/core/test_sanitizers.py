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

from quadpi_core.core import compiled

ROOT = Path(__file__).parents[2]
# Together they call each function of the core; in most other tests Python takes far longer.
TESTS = (
    "discrepancy/test_unmeasured_states.py::test_a_bias_that_hardly_wanders",
    "discrepancy/test_unmeasured_states.py::test_a_swing_that_is_not_found_is_left_at_rest",
    "estimator",
    "identification/test_change_calibration.py::test_what_flights_leave_is_found_again",
    "identification/test_tail_limits.py",
    "logs/test_blackbox.py",
    "logs/test_blackbox_encodings.py",
    "logs/test_mcap_files.py",
    "messages/test_frame_ids.py",
    "messages/test_one_by_one.py",
    "messages/test_payloads.py",
    "messages/test_result_messages.py",
    "messages/test_sensor_messages.py",
    "messages/adapters/test_rotor_messages.py",
    "models/test_envelope.py",
    "models/test_fitted_ensemble.py",
    "models/test_least_squares.py",
    "models/test_physical_kernel.py",
    "models/test_physical_regressors.py",
    "models/test_physical_rollout.py",
    "models/test_tubes.py",
    "monitor/test_adaptive.py",
    "monitor/test_alarm_kernel.py",
    "monitor/test_change.py::test_a_weak_rotor_is_named_with_its_size",
    "monitor/test_change.py::test_the_alarm_says_what_has_changed_and_any_blocks_give_the_same",
    "monitor/test_conditions.py",
    "monitor/test_data_quality.py",
    "monitor/test_monitor.py",
    "monitor/test_pairing.py",
    "monitor/test_pairing_kernel.py",
    "monitor/test_preparation.py",
    "screening/test_sample_order.py",
    "screening/test_wild_samples.py",
    "signals",
    "simulation/test_applied_effects.py",
    "simulation/test_controller.py",
    "simulation/test_dynamics.py",
    "simulation/test_reference_signals.py",
    "simulation/test_rotor_local.py",
    "test_elementary.py",
    "test_inputs.py",
    "test_frames.py",
    "test_sample_limits.py",
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
def test_nothing_is_read_or_written_beside_an_array_and_nothing_is_undefined(
    sanitized: Path, tmp_path: Path
) -> None:
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
        "QUADPI_CALLED": str(tmp_path / "called"),
        # The sanitizers take far more address space than readers are given.
        "QUADPI_UNPACKED_MIB": "99999999",
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
    functions = {name for name, own in vars(compiled).items() if callable(own) and not isinstance(own, type)}
    assert functions == set((tmp_path / "called").read_text().split())
