# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Fixtures that every test may use: real flights, simulated flights, and the command line."""

from __future__ import annotations

import fcntl
import importlib.util
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import settings
from scipy.spatial.transform import Rotation

from quadpi_core.cli import main
from quadpi_core.flight import ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.frames import Array, rotate_world_to_body
from quadpi_core.logs.bags import write_bag
from quadpi_core.paths import bags_directory, data_directory
from quadpi_core.vehicle import Vehicle

# The same examples in every run: what fails on one computer fails on all.
settings.register_profile("same", derandomize=True, database=None)
settings.load_profile("same")
# A background job of a shell ignores Ctrl-C, and so would the programs that tests start and interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).parents[1]
ROS_IS_HERE = all(importlib.util.find_spec(name) for name in ("rclpy", "domain_coordinator", "quadpi"))
collect_ignore_glob = [] if ROS_IS_HERE else ["ros/*"]
POOL = """
Fx: {fixed: [u], candidates: ["P^2(u, |v|, w)"]}
Fz: {fixed: [w], candidates: ["P^2(omega_avg)"]}
Mx: {fixed: [U_p], candidates: ["P^1(p)"]}
"""
WITHOUT_TORCH = """
import sys

class NotInstalled:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == "torch":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, NotInstalled())
"""
TORQUE_PER_THRUST_M = 0.015
IMU_HZ, IMU_SAMPLES_PER_POSE = 400.0, 4
GYRO_NOISE, ACCELEROMETER_NOISE, ROTOR_NOISE, POSITION_NOISE = 0.01, 0.1, 2.0, 0.002


def pytest_report_header() -> str | None:
    return None if ROS_IS_HERE else "test/ros is left out: ROS 2 is not installed, or quadpi's messages"


@pytest.fixture
def package_of_ones_own() -> Iterator[None]:
    """Import `my_package`, as the guides name a user's package, from where the test has it."""

    def forget() -> None:
        for name in [name for name in sys.modules if name.partition(".")[0] == "my_package"]:
            del sys.modules[name]

    forget()
    yield
    forget()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real flights; the test skips where it is absent."""
    directory = data_directory()
    if not directory.is_dir():
        pytest.skip(f"real flights not found at {directory} (set QUADPI_DATA)")
    return directory


class Outcome(NamedTuple):
    """What a run of the command line left behind."""

    status: int
    output: str
    errors: str


@pytest.fixture
def quadpi(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """quadpi("info", path, …) → Outcome of the command line, run in this process."""

    def run(*arguments: object) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["quadpi", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        return Outcome(ended.value.code or 0, *capsys.readouterr())

    return run


@pytest.fixture
def refused(quadpi: Callable[..., Outcome], tmp_path: Path) -> Callable[..., None]:
    """refused(message, command, …): one line on standard error, and the test's folder as it was.

    What the flights are found to have before that is on standard output, each line with `finding`; flights
    that were `left_out` of those that are too few now have a line each before.
    """

    def contents() -> dict[Path, bytes | None]:
        return {path: path.read_bytes() if path.is_file() else None for path in tmp_path.rglob("*")}

    def run(message: str, *arguments: object, finding: str = "", left_out: int = 0) -> None:
        before = contents()
        result = quadpi(*arguments)
        assert (result.status, bool(result.output)) == (2, bool(finding)), result
        assert all(finding in line for line in result.output.splitlines()), result.output
        before_it = rf"(quadpi: left out [^\n]*\n){{{left_out}}}"
        assert re.fullmatch(rf"{before_it}quadpi: [^\n]*{message}[^\n]*\n", result.errors), result.errors
        assert contents() == before

    return run


@pytest.fixture
def tool(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The program of tools/ that a test file is named after: golden_trace for test_golden_trace.py."""
    name = request.path.stem.removeprefix("test_")
    monkeypatch.syspath_prepend(ROOT / "tools")
    monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module(name)


def run_without_torch(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run code in a Python of its own in which PyTorch is not installed."""
    return subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH + code, *map(str, arguments)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )


def fly(
    seed: int, seconds: float = 8.0, *, drag_kg_s: float = 0.3, thrust_n_s2: float = 1.56e-6
) -> Recording:
    """A flight of the vehicle `neurobem` that obeys physics: rotor thrust, linear drag and gravity.

    A random smooth path fixes the acceleration; the thrust that it asks for fixes the attitude, and both fix
    the rotor speeds. In body axes F = (0, 0, -k Σω²) - D (u, v, w), with drag D and thrust k ω² of a rotor.
    What the sensors read has white noise.
    """
    vehicle = Vehicle.load("neurobem")
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, 1.0 / IMU_HZ)
    amplitude = rng.uniform([1.5, 1.5, 0.5], [2.5, 2.5, 1.0])
    frequency, phase = rng.uniform(1.0, 1.8, 3), rng.uniform(0.0, 2.0 * np.pi, 3)

    def path(order: int) -> Array:
        turns = np.outer(time, frequency) + phase + order * np.pi / 2
        return amplitude * frequency**order * np.sin(turns)

    gravity = np.array([0.0, 0.0, vehicle.gravity_m_s2])
    down = vehicle.mass_kg * (gravity - path(2)) - drag_kg_s * path(1)
    thrust = np.linalg.norm(down, axis=1)
    rotation = _rotation(down, heading=0.3 * np.sin(0.7 * time))
    turn = rotation.swapaxes(1, 2) @ np.gradient(rotation, time, axis=0)
    rates = np.stack((turn[:, 2, 1], turn[:, 0, 2], turn[:, 1, 0]), axis=1)
    momentum = rates @ vehicle.inertia
    moment = np.gradient(momentum, time, axis=0) + np.cross(rates, momentum)

    time_ns = 1_700_000_000 * 10**9 + seed * 10**12 + np.round(time * 1e9).astype(np.int64)
    attitude = np.roll(Rotation.from_matrix(rotation).as_quat(), 1, axis=1)
    specific_force = rotate_world_to_body(attitude, path(2) - gravity)
    squares = _rotor_thrusts(vehicle, thrust, moment) / thrust_n_s2
    seen = slice(None, None, IMU_SAMPLES_PER_POSE)

    def noisy(values: Array, noise: float) -> Array:
        return values + noise * rng.standard_normal(values.shape)

    return Recording(
        name=f"flight{seed}",
        vehicle=vehicle.name,
        source=f"flight{seed}",
        imu=ImuStream(time_ns, noisy(rates, GYRO_NOISE), noisy(specific_force, ACCELEROMETER_NOISE)),
        rotor_speeds=RotorSpeedStream(time_ns + 500_000, noisy(np.sqrt(squares), ROTOR_NOISE)),
        pose=PoseStream(time_ns[seen] + 300_000, noisy(path(0)[seen], POSITION_NOISE), attitude[seen]),
    )


def _rotation(down: Array, heading: Array) -> Array:
    """Body to world (N, 3, 3), its z axis along `down` and its x axis as near to `heading` as that allows."""
    z = down / np.linalg.norm(down, axis=1, keepdims=True)
    ahead = np.stack((np.cos(heading), np.sin(heading), np.zeros_like(heading)), axis=1)
    y = np.cross(z, ahead)
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack((np.cross(y, z), y, z), axis=2)


def _rotor_thrusts(vehicle: Vehicle, thrust: Array, moment: Array) -> Array:
    """Thrusts (N, 4) N that add up to thrust (N,) N and moment (N, 3) Nm."""
    x, y, _ = vehicle.rotor_positions.T
    mixing = np.stack((np.ones(4), -y, x, -TORQUE_PER_THRUST_M * vehicle.rotor_spins))
    return np.linalg.solve(mixing, np.column_stack((thrust, moment)).T).T


@pytest.fixture(scope="session", name="fly")
def fly_fixture() -> Callable[..., Recording]:
    """fly(seed, …) → Recording, see :func:`fly`."""
    return fly


@pytest.fixture(scope="session")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three flights of :func:`fly`, named flight0.mcap to flight2.mcap."""
    folder = tmp_path_factory.mktemp("bags")
    paths = [folder / f"flight{seed}.mcap" for seed in range(3)]
    for seed, path in enumerate(paths):
        write_bag(path, fly(seed))
    return paths


@pytest.fixture(scope="session")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small file of candidates."""
    path = tmp_path_factory.mktemp("pool") / "pool.yaml"
    path.write_text(POOL)
    return path


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """Address of a Dask scheduler with two workers, processes of their own, that import what tests import.

    Of a module: idle, the three take a tenth of a core, as much in a minute as their start.
    """
    distributed = pytest.importorskip("distributed", reason="Dask is not installed: extra `cluster`")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0"
    ) as local:
        yield local.scheduler_address


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], object]], Path]:
    """made_once(name, make) → folder that `make` fills, in the first worker that asks; others wait for it."""
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def made(name: str, make: Callable[[Path], object]) -> Path:
        folder, partial = shared / name, shared / f"{name}.partial"
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not folder.exists():
                partial.mkdir(exist_ok=True)
                make(partial)
                partial.rename(folder)
        return folder

    return made


@pytest.fixture(scope="session")
def physical_folder(made_once) -> Path:
    """Folder of the model of the Bebop 2 that documents identify on four bundled bags: half a minute."""

    def identified(folder: Path) -> None:
        bags = [bags_directory() / f"train_{k}.mcap" for k in (1, 2, 3, 4)]
        arguments = "identify", *bags, "--vehicle", "bebop2", "-o", folder / "flown"
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        command = sys.executable, "-m", "quadpi_core.cli", *arguments
        subprocess.run(command, env=environment, check=True, capture_output=True)

    return made_once("physical", identified) / "flown"
