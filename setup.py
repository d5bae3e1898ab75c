# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Build the compiled core by CMake, as a part of the package that pyproject.toml describes."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = Path(__file__).resolve().parent


class BuildCore(build_ext):
    """Where a compiler and CMake are; what was built before by the same Python is built on."""

    def build_extension(self, ext: Extension) -> None:
        """Configure and build the module at the place where setuptools wants it."""
        build = ROOT / "build" / f"core-{sys.implementation.cache_tag}"
        folder = Path(self.get_ext_fullpath(ext.name)).resolve().parent
        options = f"-DPython_EXECUTABLE={sys.executable}", f"-DQUADPI_MODULE_FOLDER={folder}"
        cache = build / "CMakeCache.txt"
        build.parent.mkdir(exist_ok=True)
        # An installation that runs beside finds it built.
        with build.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            # Of a checkout that was copied or moved, CMake refuses what was built at its old place.
            home = f"CMAKE_HOME_DIRECTORY:INTERNAL={ROOT / 'core'}\n"
            if cache.is_file() and home not in cache.read_text():
                shutil.rmtree(build)
            subprocess.run(["cmake", "-S", ROOT / "core", "-B", build, *options], check=True)
            subprocess.run(["cmake", "--build", build, "--parallel", str(os.cpu_count() or 1)], check=True)


setup(ext_modules=[Extension("quadpi_core._core", sources=[])], cmdclass={"build_ext": BuildCore})
