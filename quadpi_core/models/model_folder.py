# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A folder with a model: model.json (what and from where), arrays.safetensors (numbers), further files.

model.json holds the hashes of the others, and the model's identity is the hash of model.json, so any change
of one of them shows. All are data: reading them executes nothing.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from quadpi_core.errors import ModelError, OutputError, one_line
from quadpi_core.frames import Array
from quadpi_core.paths import JSON_BYTES_MAX, parse_json, read_bounded, require_folder, whole_output

MODEL_FILE = "model.json"
ARRAYS_FILE = "arrays.safetensors"
ARRAYS_KEY, FURTHER_KEY = "arrays_sha256", "files_sha256"
FORMAT = 6
# That of version 0.1 too; its physical models lack the covariance of their parameters, and are refused.
_FORMATS = (5, FORMAT)


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
    # Imported here, as live nodes only read models.
    from safetensors.numpy import save as save_arrays

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
        if content["format"] not in _FORMATS:
            raise ModelError(
                f"{MODEL_FILE}: format {content['format']!r} is not known to this version ({FORMAT})"
            )
        hashes = {ARRAYS_FILE: content.get(ARRAYS_KEY), **content.get(FURTHER_KEY, {})}
        for name, hashed in hashes.items():
            content_bytes = array_bytes if name == ARRAYS_FILE else files.get(name)
            if content_bytes is None:
                raise ModelError(f"{name}: missing, although {MODEL_FILE} names it")
            if _sha256(content_bytes) != hashed:
                raise ModelError(f"{name}: its hash is not the one in {MODEL_FILE}: the file was altered")
        arrays = read_safetensors(array_bytes)
        for name, values in arrays.items():
            if not np.all(np.isfinite(values)):
                raise ModelError(f"{ARRAYS_FILE}: {name}: numbers that are not finite")
        return FolderContent(content, arrays, files), _identity(folder, text)


def read_safetensors(content: bytes) -> dict[str, Array]:
    """The arrays of a file in the format of safetensors: a header, and a buffer that they fill in some order.

    Not by the package of that name: live nodes read models, and no ROS distribution has it.

    Raises:
        ModelError: for a header that does not describe the buffer.
    """
    try:
        start = _HEADER_START + int.from_bytes(content[:_HEADER_START], "little")
        header = parse_json(content[_HEADER_START:start])
        header.pop("__metadata__", None)
        arrays, filled = {}, start
        for name, entry in sorted(header.items(), key=lambda item: item[1]["data_offsets"]):
            dtype, shape, span = np.dtype(_DTYPES[entry["dtype"]]), entry["shape"], entry["data_offsets"]
            begin, end = (start + offset for offset in span)
            if (
                begin != filled
                or end - begin != math.prod(shape) * dtype.itemsize
                or min(shape, default=0) < 0
            ):
                raise ValueError(f"the place of {name} does not fit its shape")
            arrays[name] = np.frombuffer(content[begin:end], dtype).reshape(shape)
            filled = end
        if filled != len(content):
            raise ValueError(f"{len(content)} bytes where the arrays take {filled}")
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise ModelError(f"{ARRAYS_FILE}: not a quadpi model, nor safetensors: {one_line(error)}") from error
    return arrays


# Bytes that hold the length of the header.
_HEADER_START = 8
_DTYPES = {
    f"{kind.upper()}{8 * size}": f"<{kind}{size}" for kind in "fiu" for size in (1, 2, 4, 8)[kind == "f" :]
}


@contextmanager
def damage_named(folder: Path, written: int = FORMAT) -> Iterator[None]:
    """Name the folder in refusals of its content, and make one of any error that damaged content raises.

    What a folder of an earlier format lacks is no damage: its refusal says what helps.
    """
    try:
        yield
    except ModelError as error:
        helps = "" if written == FORMAT else " in a folder of an earlier version: identify the model again"
        raise ModelError(f"{folder}: {error}{helps}") from error
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
    text = ""
    with suppress(ModelError):
        text = _read(folder / MODEL_FILE).decode(errors="replace")
    if foreign := _foreign(folder, _further(text)):
        raise OutputError(f"{folder}: holds {foreign}, which is not part of a model: not replaced")


def _further(text: str) -> set[str]:
    """Names of the further files that model.json declares; none where it is damaged."""
    with suppress(ValueError):
        content = parse_json(text)
        if isinstance(content, dict) and isinstance(declared := content.get(FURTHER_KEY), dict):
            return set(declared)
    return set()


def _foreign(folder: Path, further: set[str]) -> str | None:
    """Name of something in a folder that is not part of a model."""
    return min(_names(folder) - {MODEL_FILE, ARRAYS_FILE} - further, default=None)


def _names(folder: Path) -> set[str]:
    """What lies in a folder; nothing where there is none, as for a moment while it is replaced."""
    with suppress(OSError):
        return {path.name for path in folder.iterdir()}
    return set()


def _read_files(folder: Path) -> tuple[str, bytes, dict[str, bytes]]:
    """All files of one model, also where a writer replaces the folder meanwhile."""
    for _ in range(_READS):
        before = _number(folder)
        try:
            files = _files(folder)
        except ModelError:
            if _number(folder) == before and before is not None:
                raise
        else:
            if _number(folder) == before:
                return files
        # There is none for a moment while another takes its place.
        time.sleep(_READ_AGAIN_S)
    return _files(folder)


# A writer replaces a folder in far less than all of them; several may do so one after the other.
_READS, _READ_AGAIN_S = 10, 0.01


def _files(folder: Path) -> tuple[str, bytes, dict[str, bytes]]:
    # First, so that a folder without a model is refused as such, not for its other files.
    text = _read(folder / MODEL_FILE).decode(errors="replace")
    further = _further(text)
    if foreign := _foreign(folder, further):
        raise ModelError(f"{folder}: holds {foreign}, which is not part of a model: take it out")
    array_bytes = _read(folder / ARRAYS_FILE)
    # Only what lies in the folder: a declared name may lead out of it.
    return text, array_bytes, {name: _read(folder / name) for name in sorted(_names(folder) & further)}


def _number(folder: Path) -> tuple[int, int] | None:
    """Identity of a folder, which differs from that of another of the same name; None if there is none."""
    with suppress(OSError):
        status = folder.stat()
        return status.st_ino, status.st_mtime_ns
    return None


def _read(path: Path) -> bytes:
    try:
        return read_bounded(path, JSON_BYTES_MAX)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise ModelError(f"{path}: {error}") from error
