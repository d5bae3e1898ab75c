# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import quadpi_core

_PRINT = """
import importlib, sys
print(importlib.import_module(sys.argv[1]).f.stats.cache_path)
"""
_KERNEL = """
from quadpi_core.compiled import njit
from quadpi_core.constants import (
    LIMIT,
)

@njit(cache=True)
def f():
    return LIMIT
"""

_SHARED = """
import numpy as np
from quadpi_core.compiled import njit
from {}.limits import LIMIT

@njit(cache=True)
def g():
    return np.float64(LIMIT)
"""
_CALLING = """
from quadpi_core.compiled import njit

@njit(cache=True)
def f():
    return g()
"""


def cache_folder(source, home, module="quadpi_core.kernel"):
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(source), "XDG_CACHE_HOME": str(home)}
    run = subprocess.run(
        [sys.executable, "-c", _PRINT, module],
        env=environment,
        cwd=source,
        capture_output=True,
        text=True,
        check=True,
    )
    return Path(run.stdout.strip()).parent


@pytest.fixture
def copy(tmp_path):
    """A small package with a kernel that rests on another file, beside the real compiled.py."""
    package = tmp_path / "source" / "quadpi_core"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text("")
    shutil.copy(Path(quadpi_core.__file__).with_name("compiled.py"), package)
    (package / "kernel.py").write_text(_KERNEL)
    (package / "constants.py").write_text("from quadpi_core import deeper\nLIMIT = deeper.LIMIT\n")
    (package / "deeper.py").write_text("LIMIT = 1\n")
    return tmp_path / "source"


def test_a_changed_kernel_gets_a_new_cache(copy, tmp_path):
    first = cache_folder(copy, tmp_path / "home")
    assert cache_folder(copy, tmp_path / "home") == first
    (copy / "quadpi_core" / "kernel.py").write_text(_KERNEL + "\n")
    assert cache_folder(copy, tmp_path / "home") != first


def test_so_does_one_that_rests_on_what_changed_and_no_other(copy, tmp_path):
    first = cache_folder(copy, tmp_path / "home")
    (copy / "quadpi_core" / "unrelated.py").write_text("x = 1\n")
    assert cache_folder(copy, tmp_path / "home") == first
    (copy / "quadpi_core" / "deeper.py").write_text("LIMIT = 2\n")
    assert cache_folder(copy, tmp_path / "home") != first


@pytest.mark.parametrize(
    "imported",
    [
        "from kernels_of_mine.shared import g",
        "from . import shared; g = shared.g",
        "import sys, kernels_of_others.shared as shared; g = shared.g",
        "from beside import g",
    ],
)
def test_so_does_a_kernel_of_another_package(copy, tmp_path, imported):
    """The file that it imports from uses a constant of yet another file of its package."""
    for package in ("kernels_of_mine", "kernels_of_others"):
        (copy / package).mkdir()
        (copy / package / "__init__.py").write_text("")
        (copy / package / "limits.py").write_text("LIMIT = 1\n")
        (copy / package / "shared.py").write_text(_SHARED.format(package))
    (copy / "beside.py").write_text("from kernels_of_others.shared import g\n")
    (copy / "kernels_of_mine" / "kernel.py").write_text(f"{imported}\n{_CALLING}")
    folder = "kernels_of_others" if "others" in imported or "beside" in imported else "kernels_of_mine"
    first = cache_folder(copy, tmp_path / "home", "kernels_of_mine.kernel")
    (copy / "quadpi_core" / "constants.py").write_text("LIMIT = 3\n")
    assert cache_folder(copy, tmp_path / "home", "kernels_of_mine.kernel") == first
    (copy / folder / "limits.py").write_text("LIMIT = 2\n")
    assert cache_folder(copy, tmp_path / "home", "kernels_of_mine.kernel") != first


def test_so_does_one_that_depends_on_files_by_name(copy, tmp_path):
    """As the registry of effects does on files that it finds."""
    package = copy / "quadpi_core"
    own = "from quadpi_core.compiled import depends_on\ndepends_on(__file__, [__file__ + '/../found.py'])\n"
    (package / "registry.py").write_text(own)
    (package / "kernel.py").write_text("import quadpi_core.registry\n" + _KERNEL)
    (package / "found.py").write_text("from quadpi_core import rule\n")
    (package / "rule.py").write_text("x = 1\n")
    first = cache_folder(copy, tmp_path / "home")
    assert cache_folder(copy, tmp_path / "home") == first
    (package / "rule.py").write_text("x = 2\n")
    assert cache_folder(copy, tmp_path / "home") != first


def test_old_caches_are_forgotten(copy, tmp_path):
    old, recent = tmp_path / "home" / "quadpi" / "old", tmp_path / "home" / "quadpi" / "recent"
    old.mkdir(parents=True)
    recent.mkdir()
    os.utime(old, (0.0, 0.0))
    cache_folder(copy, tmp_path / "home")
    assert not old.exists()
    assert recent.exists()


def test_without_a_home_the_cache_ends_with_the_process(copy, tmp_path):
    (tmp_path / "file").write_text("")
    assert not cache_folder(copy, tmp_path / "file").exists()
