# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: numba's `njit`, with a cache on disk that a change of all that a kernel rests on renews.

Numba renews a cached kernel when the kernel's own file changes, not when another file does whose kernels or
constants it uses. So each file with kernels has a cache folder of its own, named after the content of the
file and of all files of this package that it imports, directly or through others. Files that
:func:`modules_in` imports count.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import importlib
import os
import re
import shutil
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, TypeVar

import numba
from numba import config

__all__ = ["modules_in", "njit", "once"]

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

_compiling = threading.RLock()

_KEEP_DAYS = 30.0
_PACKAGE = Path(__file__).resolve().parent
# Imports in a function or for type checking alone are indented: no kernel rests on them.
_IMPORT = re.compile(
    rf"^(?:from ({_PACKAGE.name}[\w.]*) import (\([^)]*\)|.*)|import ({_PACKAGE.name}[\w.]*))", re.M
)

_FOLDER = re.compile(r"modules_in\(__file__, \"(\w+)\"\)")


def njit(*signatures: Any, **options: Any) -> Callable[[Kernel], Kernel]:
    """`numba.njit`, cached where the cache of the function's file is."""
    if len(signatures) == 1 and isinstance(signatures[0], FunctionType):
        return njit()(signatures[0])
    compile_it = numba.njit(*signatures, **options)

    def compiled(function: Kernel) -> Kernel:
        if os.environ.get("NUMBA_CACHE_DIR"):
            return compile_it(function)  # type: ignore[no-any-return]
        before = config.CACHE_DIR  # type: ignore[attr-defined]
        config.CACHE_DIR = str(_cache_folder(Path(function.__code__.co_filename).resolve()))  # type: ignore[attr-defined]
        try:
            return compile_it(function)  # type: ignore[no-any-return]
        finally:
            config.CACHE_DIR = before  # type: ignore[attr-defined]

    return compiled


def modules_in(file: str, folder: str) -> list[ModuleType]:
    """Import all modules of a folder beside a file of this package; kernels of the file then depend on them.

    Args:
        file: the caller's `__file__`, written literally so that the cache can find the dependency.
        folder: name of the folder, as a literal too.
    """
    path = Path(file).resolve().parent / folder
    package = ".".join((_PACKAGE.name, *path.relative_to(_PACKAGE).parts))
    names = sorted(module.stem for module in path.glob("*.py") if module.stem != "__init__")
    return [importlib.import_module(f"{package}.{name}") for name in names]


def once(function: Callable[..., Any]) -> Callable[..., Any]:
    """Cache what a function that compiles returns; of threads that call it, the first compiles alone."""
    remembered = functools.cache(function)

    @functools.wraps(function)
    def alone(*arguments: Any) -> Any:
        with _compiling:
            return remembered(*arguments)

    return alone


@functools.cache
def _cache_folder(source: Path) -> Path:
    """The cache of a file: in the user's cache, or for this process alone where that cannot be written.

    Never a fixed place that others can write to: a cached kernel is code.
    """
    folder = _parent() / _digest(source)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return _for_this_process()
    if not os.access(folder, os.W_OK):
        return _for_this_process()
    return folder


@functools.cache
def _parent() -> Path:
    parent = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "quadpi"
    _forget_old(parent)
    return parent


@functools.cache
def _for_this_process() -> Path:
    from quadpi_core.scratch import MADE, scratch_folder

    stack = ExitStack()
    atexit.register(stack.close)
    return stack.enter_context(scratch_folder()) / MADE


def _forget_old(parent: Path) -> None:
    oldest = time.time() - _KEEP_DAYS * 86400.0
    if parent.is_dir():
        for folder in parent.iterdir():
            if folder.stat().st_mtime < oldest:
                shutil.rmtree(folder, ignore_errors=True)


def _digest(source: Path) -> str:
    rests_on, found = {source}, [source]
    while found:
        new = _read(found.pop())[1] - rests_on
        rests_on |= new
        found.extend(new)
    digest = hashlib.sha256()
    for path in sorted(rests_on):
        digest.update(path.name.encode() + b"\0" + _read(path)[0])
    return digest.hexdigest()[:16]


@functools.cache
def _read(path: Path) -> tuple[bytes, frozenset[Path]]:
    """Hash of the content of a file, and the files that it imports."""
    content = path.read_bytes()
    imported = set()
    for package, names, module in _IMPORT.findall(content.decode()):
        dotted = [module or package, *(f"{package}.{name}" for name in re.findall(r"\w+", names))]
        for place in (_PACKAGE.parent.joinpath(*name.split(".")) for name in dotted):
            imported |= {place.with_suffix(".py"), place / "__init__.py"}
    for folder in _FOLDER.findall(content.decode()):
        imported |= set((path.parent / folder).glob("*.py"))
    return hashlib.sha256(content).digest(), frozenset(path for path in imported if path.is_file())
