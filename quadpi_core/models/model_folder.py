# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A folder with a model: model.json (what and from where), arrays.safetensors (numbers), further files.

model.json holds the hashes of the others, and the model's identity is the hash of model.json, so any change
of one of them shows. All are data: reading them executes nothing.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from safetensors.numpy import load as load_arrays
from safetensors.numpy import save as save_arrays

from quadpi_core.bounded_files import JSON_BYTES_MAX, parse_json, read_bounded
from quadpi_core.errors import ModelError, OutputError
from quadpi_core.frames import Array
from quadpi_core.paths import require_folder, whole_output
from quadpi_core.scratch import is_being_replaced

MODEL_FILE = "model.json"
ARRAYS_FILE = "arrays.safetensors"
ARRAYS_KEY, FURTHER_KEY = "arrays_sha256", "files_sha256"
FORMAT = 6


@dataclass(frozen=True)
class FolderContent:
    """What a model folder holds.

    Attributes:
        description: content of model.json but for format and hashes.
        arrays: by name.
        files: content of the further files, by name.
    """

    description: Mapping[str, Any]
    arrays: Mapping[str, Array]
    files: Mapping[str, bytes] = field(default_factory=dict)


def write_folder(content: FolderContent, folder: Path) -> str:
    """Write a model folder, whole or not at all; returns the model's identity.

    Raises:
        OutputError: if the folder cannot be written, or holds what is not part of a model and would be lost.
    """
    require_replaceable(folder)
    array_bytes = save_arrays(dict(content.arrays))
    described = {"format": FORMAT, **content.description, ARRAYS_KEY: _sha256(array_bytes)}
    if content.files:
        described[FURTHER_KEY] = {name: _sha256(held) for name, held in content.files.items()}
    text = json.dumps(described, indent=1, allow_nan=False) + "\n"
    with whole_output(folder) as temporary:
        temporary.mkdir()
        (temporary / ARRAYS_FILE).write_bytes(array_bytes)
        for name, held in content.files.items():
            (temporary / name).write_bytes(held)
        (temporary / MODEL_FILE).write_text(text)
    return _identity(folder, text)


def read_folder(folder: Path) -> tuple[FolderContent, str]:
    """Content and identity of a model folder.

    Raises:
        ModelError: naming the file that is missing, altered, not understood or no part of a model.
    """
    text, array_bytes, files = _read_files(folder)
    with damage_named(folder):
        content = parse_json(text)
        if not isinstance(content, dict) or "format" not in content:
            raise ModelError(f"{MODEL_FILE}: not a quadpi model: missing key `format`")
        if content["format"] != FORMAT:
            raise ModelError(
                f"{MODEL_FILE}: format {content['format']!r} is not known to this version ({FORMAT})"
            )
        hashes = {ARRAYS_FILE: content.get(ARRAYS_KEY), **content.get(FURTHER_KEY, {})}
        for name, hashed in hashes.items():
            held = array_bytes if name == ARRAYS_FILE else files.get(name)
            if held is None:
                raise ModelError(f"{name}: missing, although {MODEL_FILE} names it")
            if _sha256(held) != hashed:
                raise ModelError(f"{name}: its hash is not the one in {MODEL_FILE}: the file was altered")
        arrays = load_arrays(array_bytes)
        for name, values in arrays.items():
            if not np.all(np.isfinite(values)):
                raise ModelError(f"{ARRAYS_FILE}: {name}: numbers that are not finite")
        return FolderContent(content, arrays, files), _identity(folder, text)


@contextmanager
def damage_named(folder: Path) -> Iterator[None]:
    """Name the folder in refusals of its content, and make one of any error that damaged content raises."""
    try:
        yield
    except ModelError as error:
        raise ModelError(f"{folder}: {error}") from error
    except Exception as error:  # parts of a model raise many kinds of errors on damaged input
        raise ModelError(
            f"{folder / MODEL_FILE}: not a quadpi model: {type(error).__name__} {error}"
        ) from error


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _identity(folder: Path, text: str) -> str:
    """Name of the folder and the first digits of the hash of model.json."""
    return f"{folder.name}@{_sha256(text.encode())[:12]}"


def require_replaceable(folder: Path) -> None:
    """Refuse a folder that a model cannot take the place of.

    Raises:
        OutputError: if it cannot be replaced, or holds what is not part of a model and would be lost.
    """
    require_folder(folder.parent)
    if foreign := _foreign(folder, _declared(folder)):
        raise OutputError(f"{folder}: holds {foreign}, which is not part of a model: not replaced")


def _declared(folder: Path) -> frozenset[str]:
    """Names of the further files of a model in a folder; none where there is no model."""
    try:
        return _further(_read(folder / MODEL_FILE).decode(errors="replace"))
    except ModelError:
        return frozenset()


def _further(text: str) -> frozenset[str]:
    """Names of the further files that model.json declares; none where it is damaged."""
    try:
        content = parse_json(text)
    except ValueError:
        return frozenset()
    declared = content.get(FURTHER_KEY) if isinstance(content, dict) else None
    return frozenset(declared) if isinstance(declared, dict) else frozenset()


def _foreign(folder: Path, further: frozenset[str]) -> str | None:
    """Name of something in a folder that is not part of a model."""
    return min(_names(folder) - {MODEL_FILE, ARRAYS_FILE} - further, default=None)


def _names(folder: Path) -> set[str]:
    """What lies in a folder; nothing where there is none, as for a moment while it is replaced."""
    try:
        return {path.name for path in folder.iterdir()}
    except OSError:
        return set()


def _read_files(folder: Path) -> tuple[str, bytes, dict[str, bytes]]:
    """All files of one model, also where a writer replaces the folder meanwhile."""
    for _ in range(_READS_MAX):
        before = _number(folder)
        try:
            # First, so that a folder without a model is refused as such, not for its other files.
            text = _read(folder / MODEL_FILE).decode(errors="replace")
            further = _further(text)
            if foreign := _foreign(folder, further):
                raise ModelError(f"{folder}: holds {foreign}, which is not part of a model: take it out")
            array_bytes = _read(folder / ARRAYS_FILE)
            # Only what lies in the folder: a declared name may lead out of it.
            files = {name: _read(folder / name) for name in sorted(_names(folder) & further)}
        except ModelError:
            if _number(folder) == before and before is not None:
                raise
            missing = before is None
        else:
            if _number(folder) == before:
                return text, array_bytes, files
            missing = False
        if missing and not is_being_replaced(folder):
            _read(folder / MODEL_FILE)
        time.sleep(_READ_AGAIN_S)
    raise ModelError(f"{folder}: replaced while it was read, {_READS_MAX} times")


# A writer replaces a folder in far less; several may do so one after the other.
_READS_MAX, _READ_AGAIN_S = 50, 0.01


def _number(folder: Path) -> tuple[int, int] | None:
    """Identity of a folder, which differs from that of another of the same name; None if there is none."""
    try:
        found = folder.stat()
    except OSError:
        return None
    return found.st_ino, found.st_mtime_ns


def _read(path: Path) -> bytes:
    try:
        return read_bounded(path, JSON_BYTES_MAX)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ModelError(f"{path}: {error}") from error
