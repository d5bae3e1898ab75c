# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Folders of quadpi's own files, and output that appears whole or not at all."""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
import stat
import tempfile
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NoReturn

from quadpi_core.errors import OutputError


def config_directory() -> Path:
    """The folder of vehicles, candidate pools, mappings and node parameters."""
    return _share_directory() / "config"


def message_directory() -> Path:
    """The folder of quadpi's message definitions."""
    return _share_directory() / "msg"


def bags_directory() -> Path:
    """The folder of the bundled bags."""
    return _share_directory() / "bags"


def _share_directory() -> Path:
    """The checkout, or share/quadpi of the prefix that pip or colcon installed the package below."""
    package = Path(__file__).resolve().parent
    for candidate in (package.parent, *(prefix / "share" / "quadpi" for prefix in package.parents)):
        if (candidate / "package.xml").is_file():
            return candidate
    raise FileNotFoundError(f"no package.xml beside {package} or in share/quadpi above it")


@contextmanager
def scratch_folder(place: Path | None = None) -> Iterator[Path]:
    """A temporary folder in `place`, or where the system keeps such; it is removed after the block.

    Raises:
        OSError: if it cannot be made.
    """
    # Known before it is made: an interrupt that comes as `tempfile` returns would leave its folder.
    folder = (place or Path(tempfile.gettempdir())) / f".quadpi.{uuid.uuid4().hex}"
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        try:
            shutil.rmtree(folder, ignore_errors=True)
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise


@contextmanager
def whole_output(path: Path) -> Iterator[Path]:
    """Give a temporary path in the target's folder that replaces `path` once the block succeeds.

    Works for a file or a folder, but no file replaces a folder, and nothing a device or pipe. On an exception
    the temporary one is removed and what was at `path` before stays as it was.

    Raises:
        OutputError: if `path` cannot be written.
    """
    with _naming(path):
        _refuse_device(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with scratch_folder(path.parent) as scratch:
            temporary = scratch / path.name
            yield temporary
            if temporary.is_dir():
                _replace_folder(temporary, path, scratch / f"{path.name}.replaced")
            else:
                temporary.replace(path)


def _replace_folder(made: Path, path: Path, replaced: Path) -> None:
    """Move a folder to `path`, and what is there to `replaced`, while other writers may do the same."""
    try:
        for _ in range(_REPLACEMENTS_MAX):
            try:
                made.rename(path)
                return
            except OSError as error:
                if error.errno not in {errno.ENOTEMPTY, errno.EEXIST}:
                    raise
            # This run's older one, where another writer was faster than it.
            shutil.rmtree(replaced, ignore_errors=True)
            with suppress(FileNotFoundError):
                path.rename(replaced)
        raise OutputError(f"{path}: others keep replacing it")
    except BaseException:
        if replaced.exists() and not path.exists():
            replaced.rename(path)
        raise


# More than the number of writers that may compete for one folder.
_REPLACEMENTS_MAX = 100


@contextmanager
def whole_outputs(folder: Path) -> Iterator[Path]:
    """Give a temporary folder, the files in which move to `folder` once the block succeeds: all or none.

    They replace files of the same names there, and leave others alone. The temporary folder lies in `folder`,
    or above it where there is none yet.

    Raises:
        OutputError: if they cannot be written there.
    """
    require_folder(folder)
    with ExitStack() as stack:
        with _naming(folder):
            staging = stack.enter_context(scratch_folder(_standing(folder)))
        yield staging
        made = [file for file in sorted(staging.iterdir()) if file.is_file()]
        for file in made:
            require_file(folder / file.name)
        with _naming(folder):
            folder.mkdir(parents=True, exist_ok=True)
            for file in made:
                file.replace(folder / file.name)


def staged(staging: Path, name: str) -> Path:
    """Path of a file to write in the temporary folder of :func:`whole_outputs`.

    Raises:
        OutputError: if that is gone: workers of a cluster outlive a run that was interrupted.
    """
    if not staging.is_dir():
        raise OutputError(f"{staging / name}: not written: the run that asked for it has ended")
    return staging / name


def require_file(path: Path) -> None:
    """Refuse a path at which no file can be written.

    Raises:
        OutputError: if it is a folder or device, or nothing can be written beside it.
    """
    with _naming(path):
        _refuse_device(path)
        if path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        _require_place(path.parent)


def require_folder(path: Path) -> None:
    """Refuse a path at which no folder can be made, or filled.

    Raises:
        OutputError: if it is a file or device, or nothing can be written there.
    """
    with _naming(path):
        _refuse_device(path)
        _require_place(path)


def _require_place(folder: Path) -> None:
    """Test by writing whether a folder can be made or filled: permissions alone do not tell."""
    with scratch_folder(_standing(folder)):
        pass


def _standing(folder: Path) -> Path:
    """The folder, or its closest parent that exists."""
    return next(place for place in (folder, *folder.parents) if place.exists())


def _refuse_device(path: Path) -> None:
    try:
        kind = path.stat().st_mode
    except FileNotFoundError:
        return
    if not (stat.S_ISREG(kind) or stat.S_ISDIR(kind)):
        raise OutputError(f"{path}: is neither a file nor a folder: not replaced")


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Name in an error the path that could not be written."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def write_json(path: Path, data: Any) -> None:
    """Write JSON, whole or not at all.

    Raises:
        OutputError: if `path` cannot be written.
        ValueError: for a number that is not finite.
    """
    with whole_output(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")


def finite_json(value: Any) -> Any:
    """A value as JSON has it: numbers of numpy as Python's, and null for one that is not finite."""
    if isinstance(value, Mapping):
        return {key: finite_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_json(item) for item in value]
    # Without numpy itself, which commands that only print do not read.
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def resolved_below(path: str | Path, folders: Sequence[Path]) -> Path | None:
    """The path with links and `..` resolved, if it is in or below one of the folders; else None."""
    found = Path(path).resolve()
    return found if any(found.is_relative_to(folder.resolve()) for folder in folders) else None


def data_directory() -> Path:
    """The folder of real flights: $QUADPI_DATA, or shared/data beside the checkout; need not exist."""
    beside_checkout = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    return Path(os.environ.get("QUADPI_DATA", beside_checkout))


# What a small log may unpack to; quadpi_core.logs.sandbox holds logs against it.
LIMIT_VARIABLE = "QUADPI_UNPACKED_MIB"
# Far more than a small log needs; arrays made of it still fit into the memory of a small computer.
LIMIT_DEFAULT_MIB = 256
# Configuration and models are written by hand or by `identify`: a few kB, and a few MB.
CONFIG_BYTES_MAX = 256 * 1024
JSON_BYTES_MAX = 64 * 1024 * 1024
# Squares and cubes of such numbers stay finite.
_LARGEST = 1e100


def read_bounded(path: Path, most: int) -> bytes:
    """The content of a regular file.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is larger than `most` bytes, or a device or pipe, which may never end.
    """
    if path.exists() and not path.is_file():
        raise ValueError("not a file")
    with path.open("rb") as file:
        # Python allocates as much as `read` is asked for, however small the file.
        size = os.fstat(file.fileno()).st_size
        data = file.read(size + 1) if size <= most else b""
    if max(len(data), size) > most:
        raise ValueError(f"larger than the {most // 1024} KiB that such a file may have")
    return data


def parse_json(text: str | bytes) -> Any:
    """The content of a JSON text without duplicate keys, whose numbers are finite.

    Raises:
        ValueError: saying what is wrong with the text, such as nesting too deep for Python.
    """
    try:
        return json.loads(
            text,
            parse_constant=_refuse_constant,
            parse_float=_finite,
            parse_int=_whole,
            object_pairs_hook=_object,
        )
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _refuse_constant(text: str) -> NoReturn:
    raise ValueError(f"holds the number {text}")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value) or abs(value) > _LARGEST:
        raise ValueError(f"holds the number {text[:40]}, beyond {_LARGEST:g}")
    return value


def _whole(text: str) -> int:
    if len(text) > math.log10(_LARGEST):
        raise ValueError(f"holds the number {text[:40]}…, beyond {_LARGEST:g}")
    return int(text)


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in found if keys.count(key) > 1)
        raise ValueError(f"duplicate key `{twice[:80]}`")
    return found
