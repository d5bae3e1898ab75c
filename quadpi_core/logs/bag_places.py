# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which files a bag is of: told by their content, whatever their names, and metadata.yaml, say.

`ros2 bag reindex` of Humble leaves the storage identifier empty; users rename files, and compress or unpack
them by hand.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any

import yaml
from backports import zstd

from quadpi_core.errors import LogError, one_line
from quadpi_core.logs.sandbox import read_apart, require_unpackable
from quadpi_core.paths import read_bounded

PACKED = ".zstd"
_SUFFIXES = (".mcap", ".db3")
METADATA_FILE = "metadata.yaml"
# The metadata.yaml of a day's recording, split every minute, is smaller.
_METADATA_BYTES_MAX = 2**20
# A frame of Zstandard, and the frames that decompressors skip.
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_ZSTD_MAGICS = (ZSTD_MAGIC, *(bytes((0x50 + kind, 0x2A, 0x4D, 0x18)) for kind in range(16)))
_READ_AT_ONCE = 2**20


@dataclass(frozen=True)
class BagPlaces:
    """The files of a bag.

    Attributes:
        files: with messages, possibly compressed.
        custom: what the writer of a folder noted in its metadata.yaml; None where it does not say.
    """

    files: list[Path]
    custom: dict[str, Any] | None = field(default=None)


def bag_places(path: Path) -> BagPlaces:
    """The files of a bag that is a file or a folder.

    Raises:
        LogError: if metadata.yaml is too large or names files that are not there, or is absent or unreadable
            and there is not exactly one file.
    """
    if not path.is_dir():
        return BagPlaces([path])
    if not (path / METADATA_FILE).exists():
        return BagPlaces([_single_file(path, f"no {METADATA_FILE}")])
    text = read_bounded(path / METADATA_FILE, _METADATA_BYTES_MAX)
    try:
        information = yaml.safe_load(text)["rosbag2_bagfile_information"]
        named = [PurePath(name).name for name in information["relative_file_paths"]]
        custom = information.get("custom_data")
    except (yaml.YAMLError, RecursionError, LookupError, TypeError, ValueError, AttributeError):
        # Emptied when the power went, or damaged.
        return BagPlaces([_single_file(path, f"{METADATA_FILE} cannot be read")])
    return BagPlaces(_present(path, named), custom)


def _files_of_messages(folder: Path) -> list[Path]:
    return sorted(
        file
        for file in folder.iterdir()
        if file.is_file() and (file.stem if file.suffix == PACKED else file.name).endswith(_SUFFIXES)
    )


def _single_file(folder: Path, why: str) -> Path:
    """The file of messages in a folder whose metadata tell nothing.

    Raises:
        LogError: saying why, if there is not exactly one.
    """
    files = _files_of_messages(folder)
    if len(files) != 1:
        raise LogError(
            f"{why}, and {len(files)} files of messages: `ros2 bag reindex` makes it, or name one of the "
            "files"
        )
    return files[0]


def _present(folder: Path, named: list[str]) -> list[Path]:
    """The files that metadata.yaml names; where some were renamed, the others in their places."""
    missing = [name for name in named if not (folder / name).is_file()]
    others = [file for file in _files_of_messages(folder) if file.name not in named]
    if missing and len(missing) != len(others):
        raise LogError(
            f"{METADATA_FILE} names {', '.join(missing)}, which is not there; there are "
            f"{', '.join(file.name for file in others) or 'no other files of messages'}: `ros2 bag reindex` "
            "renews it"
        )
    return [folder / name for name in named if name not in missing] + (others if missing else [])


def is_packed(file: Path) -> bool:
    """Whether a file is compressed by Zstandard."""
    with file.open("rb") as stream:
        return stream.read(4).startswith(_ZSTD_MAGICS)


def unpack(file: Path, target: Path) -> None:
    """Unpack a file that is compressed by Zstandard.

    Raises:
        LogError: if it is damaged, or unpacks to too much.
    """
    size = file.stat().st_size
    for _ in read_apart(size, _unpack, file, target, size):
        pass


def _unpack(file: Path, target: Path, size: int) -> Iterator[None]:
    written = 0
    try:
        with zstd.open(file) as packed, target.open("xb") as copy:
            while part := packed.read(_READ_AT_ONCE):
                written += len(part)
                require_unpackable(size, written)
                copy.write(part)
    except (zstd.ZstdError, EOFError) as error:
        raise LogError(f"cannot be read: {one_line(error)}") from error
    yield
