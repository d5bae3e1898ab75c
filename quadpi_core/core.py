# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The compiled core: functions of C++ on records (see :mod:`quadpi_core.records`), built at installation.

In a checkout, a module that was built from other sources than are there is refused.
"""

from __future__ import annotations

from hashlib import sha256
from pathlib import Path

_AGAIN = "run `make environment`, or install quadpi again"

try:
    import quadpi_core._core as compiled
except ImportError as error:
    raise ImportError(f"quadpi's compiled core cannot be used: {error}; {_AGAIN}") from error

__all__ = ["compiled"]

_SUFFIXES = (".hpp", ".cpp", ".txt")


def _sources_digest(folder: Path) -> str:
    """SHA-256 of the sources, as core/CMakeLists.txt makes it."""
    paths = [path for path in folder.rglob("*") if path.suffix in _SUFFIXES and path.is_file()]
    names = sorted((path.relative_to(folder).as_posix(), path) for path in paths)
    digests = "".join(sha256(path.read_bytes()).hexdigest() for _, path in names)
    return sha256(digests.encode()).hexdigest()


_sources = Path(__file__).resolve().parent.parent / "core"
if (_sources / "include" / "quadpi").is_dir() and _sources_digest(_sources) != compiled.SOURCES:
    raise ImportError(f"quadpi's compiled core is older than core/: {_AGAIN}")
