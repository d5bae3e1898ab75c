# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Compiled kernels: numba's `njit`, with a cache on disk that is renewed when anything a kernel uses changes.

Numba renews a cached kernel when the kernel's own file changes, but not when another file changes whose
kernels or constants it uses. So each file with kernels has a cache folder of its own, named after the content
of the file and of the files that it imports, directly or through others: those of this package, of the file's
own package or folder, and of any package with kernels, and what :func:`depends_on` names.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import importlib.util
import os
import re
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar

import numba
from numba import config

__all__ = ["depends_on", "njit", "once"]

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

_compiling = threading.RLock()

_KEEP_DAYS = 30.0
_PACKAGE = Path(__file__).resolve().parent
# Imports in a function or for type checking alone are indented: no kernel depends on them.
_IMPORT = re.compile(r"^(?:from ([\w.]+) import (\([^)]*\)|.*)|import (.+))", re.M)
# Folders of installed packages.
_INSTALLED = frozenset({"site-packages", "dist-packages"})
_depends_on: dict[Path, frozenset[Path]] = {}


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


def depends_on(file: str, others: Iterable[str]) -> None:
    """Renew the kernels of a file, and of what imports it, when files change that it does not import by name.

    Args:
        file: the caller's `__file__`; called before its first kernel.
        others: files of whose kernels it makes its own.
    """
    _depends_on[Path(file).resolve()] = frozenset(Path(other).resolve() for other in others)


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
    folder = tempfile.mkdtemp(prefix=".quadpi.")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _forget_old(parent: Path) -> None:
    oldest = time.time() - _KEEP_DAYS * 86400.0
    if parent.is_dir():
        for folder in parent.iterdir():
            if folder.stat().st_mtime < oldest:
                shutil.rmtree(folder, ignore_errors=True)


def _digest(source: Path) -> str:
    used, found = {source}, [source]
    while found:
        path = found.pop()
        new = (_read(path)[1] | _depends_on.get(path, frozenset())) - used
        used |= new
        found.extend(new)
    digest = hashlib.sha256()
    for path in sorted(used):
        digest.update(path.name.encode() + b"\0" + _read(path)[0])
    return digest.hexdigest()[:16]


@functools.cache
def _read(path: Path) -> tuple[bytes, frozenset[Path]]:
    """Hash of the content of a file, and the files that it imports and that count."""
    content = path.read_bytes()
    imported = set()
    for package, names, modules in _IMPORT.findall(content.decode()):
        if package:
            between = "" if package.endswith(".") else "."
            dotted = [package, *(f"{package}{between}{name}" for name in re.findall(r"\w+", names))]
        else:
            dotted = [module.split()[0] for module in modules.split(",") if module.strip()]
        for name in dotted:
            imported |= set(_files(path, name))
    return hashlib.sha256(content).digest(), frozenset(imported)


def _files(path: Path, dotted: str) -> list[Path]:
    """Files of a module, by the name that a file imports it by, if they count."""
    absolute = dotted.lstrip(".")
    top = absolute.partition(".")[0]
    if dotted != absolute:
        return _in(path.parents[len(dotted) - len(absolute) - 1], absolute)
    if top in sys.stdlib_module_names:
        return []
    root = _root(path.parent, top)
    return _with_kernels(absolute) if root is None else _in(root, absolute)


def _in(folder: Path, dotted: str) -> list[Path]:
    place = folder.joinpath(*dotted.split("."))
    return [file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()]


@functools.cache
def _with_kernels(dotted: str) -> list[Path]:
    """Files of a module of another package, if they use this one."""
    root = _installed(dotted.partition(".")[0])
    files = [] if root is None else _in(root, dotted)
    return [file for file in files if _PACKAGE.name.encode() in file.read_bytes()]


@functools.cache
def _installed(top: str) -> Path | None:
    """Folder that holds a package or module; None for one that is not written in Python."""
    spec = importlib.util.find_spec(top)
    if spec is None or spec.origin is None or not spec.origin.endswith(".py"):
        return None
    return Path(spec.origin).resolve().parents[1 if spec.submodule_search_locations else 0]


@functools.cache
def _root(importing: Path, top: str) -> Path | None:
    """Folder that holds this package, or a package or module of the user beside the importing one's."""
    if top == _PACKAGE.name:
        return _PACKAGE.parent
    root = importing
    while (root / "__init__.py").is_file():
        root = root.parent
    own = root != importing and top == importing.relative_to(root).parts[0]
    beside = _INSTALLED.isdisjoint(root.parts) and ((root / top).is_dir() or (root / f"{top}.py").is_file())
    return root if own or beside else None
