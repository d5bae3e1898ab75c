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
from quadpi_core import kernel
print(kernel.f.stats.cache_path)
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


def cache_folder(source, home):
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(source), "XDG_CACHE_HOME": str(home)}
    run = subprocess.run(
        [sys.executable, "-c", _PRINT],
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
    for name in ("compiled.py", "scratch.py"):
        shutil.copy(Path(quadpi_core.__file__).parent / name, package)
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
