# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A program of C++ elsewhere that finds the installed core by CMake and includes all of it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

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
