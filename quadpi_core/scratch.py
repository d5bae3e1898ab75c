# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Temporary folders that do not outlive their run for long, however it ends.

A run that is killed cannot clear up after itself, so the next one does that makes a temporary folder at the
same place. Each is locked while its run lives (flock(2)): the system lifts the lock when the process ends,
and a folder without a lock belongs to nobody. Where a file system cannot lock, nothing is cleared up.
"""

from __future__ import annotations

import fcntl
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# Where in a temporary folder output is made, and where what it replaces waits meanwhile.
MADE, REPLACED = "made", "replaced"

_PREFIX, _LOCK = ".quadpi.", "lock"
_NAME = re.compile(rf"{re.escape(_PREFIX)}[a-z0-9_]{{8}}")
# Of the folders that this run has cleared of what others left: once is enough.
_cleared: set[Path] = set()


@contextmanager
def scratch_folder(place: Path | None = None) -> Iterator[Path]:
    """A temporary folder in `place`, or where the system keeps such; it is removed after the block.

    Its folder `made` is there, empty. What killed runs left at the same place is removed before, and what
    they were about to replace is put back where nothing is in its place.

    Raises:
        OSError: if it cannot be made.
    """
    folder, lock = _locked(Path(tempfile.gettempdir()) if place is None else place)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def is_being_replaced(path: Path) -> bool:
    """Whether a run has moved away what stood at `path`, or may do so any moment, to put its own there."""
    with suppress(OSError):
        return any((folder / MADE / path.name).exists() for folder in _scratch_folders(path.parent))
    return False


def _locked(place: Path) -> tuple[Path, int]:
    """A new folder and its lock, held."""
    _clear(place)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=place))
        # Until it is locked another run may take it for one of a run that was killed.
        with suppress(FileNotFoundError):
            lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
            if _lock(lock) is not False and _is_at(lock, folder / _LOCK):
                (folder / MADE).mkdir()
                return folder, lock
            os.close(lock)


def _lock(file: int) -> bool | None:
    """Lock an open file; False where another process has, None where the file system cannot."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _is_at(file: int, path: Path) -> bool:
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(file), path.stat())
    return False


def _clear(place: Path) -> None:
    """Remove what killed runs left."""
    resolved = place.resolve()
    if resolved in _cleared:
        return
    _cleared.add(resolved)
    with suppress(OSError):
        for folder in _scratch_folders(resolved):
            # It may be gone meanwhile.
            with suppress(OSError):
                _remove_if_left(folder)


def _scratch_folders(place: Path) -> list[Path]:
    """Those in a folder, of runs that live or were killed, and what only has such a name."""
    with os.scandir(place) as entries:
        return [place / entry.name for entry in entries if _NAME.fullmatch(entry.name)]


def _remove_if_left(folder: Path) -> None:
    if folder.is_symlink() or folder.stat().st_uid != os.geteuid():
        return
    if not {path.name for path in folder.iterdir()} <= {_LOCK, MADE, REPLACED}:
        return
    lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    try:
        if _lock(lock) is True:
            _put_back(folder)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(lock)


def _put_back(folder: Path) -> None:
    """A run killed between two steps may have moved the old output away, and the new one not yet there."""
    replaced = folder / REPLACED
    made = list((folder / MADE).iterdir()) if (folder / MADE).is_dir() else []
    if replaced.exists() and len(made) == 1 and not (folder.parent / made[0].name).exists():
        replaced.rename(folder.parent / made[0].name)
