# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: numba's `njit`, with a cache on disk that a change of any kernel renews.

Numba renews a cached kernel when the kernel's own file changes, not when a kernel in another file that it
calls does. So the cache lies in a folder named after the content of all files with kernels.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import config, njit

__all__ = ["njit", "once"]

_compiling = threading.RLock()


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """Cache what a function that compiles returns; of threads that call it, the first compiles alone."""
    remembered = functools.cache(function)

    @functools.wraps(function)
    def alone(*arguments: Any) -> Any:
        with _compiling:
            return remembered(*arguments)

    return alone


_KEEP_DAYS = 30.0


def _digest() -> str:
    digest = hashlib.sha256()
    package = Path(__file__).resolve().parent
    for path in sorted(package.rglob("*.py")):
        content = path.read_bytes()
        if b"@njit" in content or b"@intrinsic" in content:
            digest.update(path.relative_to(package).as_posix().encode() + b"\0" + content)
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """In the user's cache; for this process alone where that cannot be written.

    Never a fixed place that others can write to: a cached kernel is code.
    """
    parent = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "quadpi"
    name = _digest()
    try:
        (parent / name).mkdir(parents=True, exist_ok=True)
    except OSError:
        return _for_this_process()
    if not os.access(parent / name, os.W_OK):
        return _for_this_process()
    _forget_old(parent, keep=name)
    return parent / name


def _for_this_process() -> Path:
    folder = tempfile.mkdtemp(prefix="quadpi-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _forget_old(parent: Path, keep: str) -> None:
    oldest = time.time() - _KEEP_DAYS * 86400.0
    for folder in parent.iterdir():
        if folder.name != keep and folder.stat().st_mtime < oldest:
            shutil.rmtree(folder, ignore_errors=True)


if not os.environ.get("NUMBA_CACHE_DIR"):
    config.CACHE_DIR = str(_cache_folder())  # type: ignore[attr-defined]
