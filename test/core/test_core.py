# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled core is that of the sources, its stub names all of it, and C++ elsewhere finds it."""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import quadpi_core
from quadpi_core.core import compiled
from quadpi_core.estimator.filter_state import MEASUREMENT, NOISE

PACKAGE = Path(quadpi_core.__file__).parent
SOURCES = PACKAGE.parent / "core"
GOLDEN_MODEL = Path(__file__).parents[1] / "golden" / "model"
_DECLARED = ast.FunctionDef, ast.ClassDef, ast.AnnAssign


def test_the_stub_names_what_is_there() -> None:
    parts = [one for one in ast.parse((PACKAGE / "_core.pyi").read_text()).body if isinstance(one, _DECLARED)]
    named = {ast.unparse(one.target) if isinstance(one, ast.AnnAssign) else one.name for one in parts}
    assert named == {name for name in dir(compiled) if not name.startswith("__")}


@pytest.mark.skipif(not SOURCES.is_dir(), reason="an installed package has no sources beside it")
def test_a_module_older_than_its_sources_is_refused(tmp_path: Path) -> None:
    (tmp_path / "quadpi_core").mkdir()
    for file in (PACKAGE / "core.py", *PACKAGE.glob("_core.*.so")):
        shutil.copy(file, tmp_path / "quadpi_core")
    (tmp_path / "quadpi_core" / "__init__.py").touch()
    shutil.copytree(SOURCES, tmp_path / "core")
    command = (sys.executable, "-c", "import sys; sys.path[:0] = ['.']; import quadpi_core.core")
    assert subprocess.run(command, check=False, cwd=tmp_path, capture_output=True).returncode == 0
    with (tmp_path / "core" / "include" / "quadpi" / "rotations.hpp").open("a") as header:
        header.write("// changed\n")
    ran = subprocess.run(command, check=False, cwd=tmp_path, capture_output=True, text=True)
    last = ran.stderr.splitlines()[-1]
    assert last.startswith("ImportError: quadpi's compiled core is older than core/: run `make environment`")


def test_nothing_is_said_of_what_a_program_still_holds_as_it_ends() -> None:
    kept = f"monitor = quadpi_core.Monitor(quadpi_core.load_model({str(GOLDEN_MODEL)!r}))"
    command = f"import ctypes, quadpi_core; {kept}; ctypes.pythonapi.Py_IncRef(ctypes.py_object(monitor))"
    ran = subprocess.run((sys.executable, "-c", command), check=True, capture_output=True, text=True)
    assert ran.stderr == ""


@pytest.mark.parametrize(
    "measurement",
    [np.zeros(1), np.zeros(1, NOISE), np.zeros((2, 2), MEASUREMENT)[:, 0], [1.0], None],
    ids=["numbers", "other records", "not contiguous", "a list", "None"],
)
def test_what_are_no_records_of_that_kind_is_refused(measurement: object) -> None:
    with pytest.raises(TypeError):
        compiled.usable_measurement(measurement)


def test_records_that_cannot_be_written_are_refused() -> None:
    measurement = np.zeros(1, MEASUREMENT)
    measurement.flags.writeable = False
    with pytest.raises(TypeError):
        compiled.usable_measurement(measurement)


def test_what_begins_anywhere_is_read_all_the_same() -> None:
    raw = np.zeros(8 * 9 + 1, np.uint8)
    force = np.frombuffer(raw.data, np.float64, 9, offset=1).reshape(3, 3)
    force[:] = np.arange(9.0).reshape(3, 3)
    still, wrench = np.zeros((3, 3)), np.empty((3, 6))
    compiled.newton_euler(force, still, still, 2.0, np.eye(3), wrench)
    np.testing.assert_array_equal(wrench[:, :3], 2.0 * np.arange(9.0).reshape(3, 3))


CORE = Path(__file__).parents[2] / "core"
PROJECT = """
cmake_minimum_required(VERSION 3.20)
project(elsewhere LANGUAGES CXX)
find_package(quadpi_core CONFIG REQUIRED)
add_executable(elsewhere main.cpp {alone})
target_link_libraries(elsewhere PRIVATE quadpi::core)
target_compile_options(elsewhere PRIVATE -O0 -Wall -Wextra -Werror)
"""
MAIN = """
#include <cstdio>
{includes}
int main() {{
    const quadpi::Quaternion turned = quadpi::from_rotation_vector({{0, 0, 0.5}});
    std::printf("%g", quadpi::to_rotation_vector(turned)[2]);
}}
"""


def ran(*command: str | Path) -> str:
    done = subprocess.run(list(map(str, command)), check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None or not CORE.is_dir(), reason="needs CMake and the sources")
def test_a_program_elsewhere_links_the_installed_headers_alone_and_together(tmp_path: Path) -> None:
    ran("cmake", "-S", CORE, "-B", tmp_path / "core", f"-DPython_EXECUTABLE={sys.executable}")
    ran("cmake", "--install", tmp_path / "core", "--prefix", tmp_path / "installed")
    include = tmp_path / "installed" / "include"
    headers = sorted(path.relative_to(include).as_posix() for path in include.rglob("*.hpp"))
    includes = [f'#include "{header}"' for header in headers]
    alone = [f"alone_{number}.cpp" for number in range(len(headers))]
    for name, line in zip(alone, includes, strict=True):
        (tmp_path / name).write_text(f"{line}\n")
    (tmp_path / "main.cpp").write_text(MAIN.format(includes="\n".join(includes)))
    (tmp_path / "CMakeLists.txt").write_text(PROJECT.format(alone=" ".join(alone)))
    ran("cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={tmp_path / 'installed'}")
    ran("cmake", "--build", tmp_path / "build", "--parallel")
    assert ran(tmp_path / "build" / "elsewhere") == "0.5"
