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
import random
import re
import shutil
import string
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# Where in a temporary folder output is made, and where what it replaces waits meanwhile.
MADE, REPLACED = "made", "replaced"

_PREFIX, _LOCK = ".quadpi.", "lock"
_NAME = re.compile(rf"{re.escape(_PREFIX)}[a-z0-9_]{{8}}")
_LETTERS = string.ascii_lowercase + string.digits
# Not the generator that a program may have seeded: two runs would choose the same names.
_random = random.SystemRandom()
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
    place = Path(tempfile.gettempdir()) if place is None else place
    _clear(place)
    # A signal may come at any instant: what is about to be made is noted before, and removed in any case.
    made, lock = [_free_name(place)], None
    try:
        while (lock := _make(made[-1])) is None:
            made.append(_free_name(place))
        yield made[-1]
    finally:
        try:
            _remove(made)
        except BaseException:
            # A signal has interrupted the removal: finish it before the run ends.
            _remove(made)
            raise
        finally:
            if lock is not None:
                os.close(lock)


def _remove(folders: list[Path]) -> None:
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)


def is_being_replaced(path: Path) -> bool:
    """Whether a run has moved away what stood at `path`, or may do so any moment, to put its own there."""
    with suppress(OSError):
        return any((folder / MADE / path.name).exists() for folder in _scratch_folders(path.parent))
    return False


def _free_name(place: Path) -> Path:
    """A path in a folder for a temporary folder, of a name that nothing has there."""
    while (folder := place / (_PREFIX + "".join(_random.choices(_LETTERS, k=8)))).exists():
        pass
    return folder


def _make(folder: Path) -> int | None:
    """Make a temporary folder and hold its lock; None if another run removed it before it was locked.

    Such a run takes a folder without a lock for one of a run that was killed.
    """
    folder.mkdir(mode=0o700)
    with suppress(FileNotFoundError):
        lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
        if _lock(lock) is not False and _is_at(lock, folder / _LOCK):
            (folder / MADE).mkdir()
            return lock
        os.close(lock)
    return None


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
