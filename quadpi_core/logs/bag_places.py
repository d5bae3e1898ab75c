# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which files a bag is of: told by their content, whatever their names, and metadata.yaml, say.

`ros2 bag reindex` of Humble leaves the storage identifier empty; users rename files, and compress or unpack
them by hand. What rosbags could not open so is shown to it in a temporary folder.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePath
from types import MappingProxyType
from typing import Any

from backports import zstd
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from quadpi_core.bounded_files import read_bounded
from quadpi_core.errors import LogError
from quadpi_core.logs.mcap_files import MAGIC, METADATA_BYTES_MAX
from quadpi_core.logs.unpacking import require_unpackable, unpacked_limit, unzstd_blocks, zstd_size
from quadpi_core.scratch import MADE, scratch_folder

# The suffix by which rosbags chooses a reader, by the first bytes of a file.
MAGICS = MappingProxyType({MAGIC: ".mcap", b"SQLite format 3\0": ".db3", b"#ROSBAG V": ".bag"})
PACKED = ".zstd"
_STORAGES = MappingProxyType({".mcap": "mcap", ".db3": "sqlite3"})
_METADATA_FILE = "metadata.yaml"
# A frame of Zstandard, and the frames that decompressors skip.
_ZSTD_MAGICS = (b"\x28\xb5\x2f\xfd", *(bytes((0x50 + kind, 0x2A, 0x4D, 0x18)) for kind in range(16)))
_HEAD_BYTES = 1 << 17


def files_of(path: Path) -> list[Path]:
    """The files in a folder, by name, or the one file that a path is."""
    return sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]


@contextmanager
def place_to_open(path: Path) -> Iterator[Path]:
    """What rosbags can open of a bag: the same, or in a temporary folder what its content asks for.

    Raises:
        LogError: if metadata.yaml is too large, names files that are not there, or is absent and there is not
            exactly one file, or a compressed file unpacks to too much or holds no bag.
    """
    with ExitStack() as opened:

        def made() -> Path:
            return opened.enter_context(scratch_folder()) / MADE

        if not path.is_dir():
            yield _file_to_open(path, made)
        elif (path / _METADATA_FILE).exists():
            yield _folder_to_open(path, made)
        else:
            yield _file_to_open(_single_file(path, f"no {_METADATA_FILE}"), made)


def _single_file(folder: Path, why: str) -> Path:
    """The file of messages in a folder whose metadata tell nothing.

    Raises:
        LogError: saying why, if there is not exactly one.
    """
    files = [file for file in files_of(folder) if _is_of_messages(file)]
    if len(files) != 1:
        raise LogError(
            f"{why}, and {len(files)} files of messages: `ros2 bag reindex` makes it, or name one of the "
            "files"
        )
    return files[0]


def _is_of_messages(file: Path) -> bool:
    return (file.stem if file.suffix == PACKED else file.name).endswith(tuple(_STORAGES))


def _file_to_open(file: Path, made: Callable[[], Path]) -> Path:
    """A file whose suffix is that of its content."""
    suffix, is_packed = _content(file)
    if is_packed:
        if suffix is None:
            raise LogError(f"{file}: what it holds compressed is no bag; `zstd -d` unpacks it")
        unpacked = made() / f"{file.stem}{suffix}"
        packed = file.read_bytes()
        with unpacked.open("xb") as stream:
            for block in unzstd_blocks(packed, unpacked_limit(len(packed))):
                stream.write(block)
        require_unpackable(len(packed), unpacked.stat().st_size)
        return unpacked
    if suffix is None or file.suffix == suffix:
        return file
    named = made() / f"{file.stem}{suffix}"
    named.symlink_to(file.absolute())
    return named


def _content(file: Path) -> tuple[str | None, bool]:
    """The suffix of what a file holds, None if that is no bag, and whether it is compressed."""
    with file.open("rb") as stream:
        head = stream.read(_HEAD_BYTES)
    is_packed = head.startswith(_ZSTD_MAGICS)
    if is_packed:
        with suppress(LogError, zstd.ZstdError):
            head = next((block for block in unzstd_blocks(head, _HEAD_BYTES) if block), b"")
    return next((suffix for magic, suffix in MAGICS.items() if head.startswith(magic)), None), is_packed


def _folder_to_open(folder: Path, made: Callable[[], Path]) -> Path:
    """A folder whose metadata.yaml names its files and how they are stored."""
    text = read_bounded(folder / _METADATA_FILE, METADATA_BYTES_MAX)
    for file in files_of(folder):
        _require_unpackable(file)
    try:
        metadata = YAML(typ="safe").load(text)
    except YAMLError:
        metadata = None
    if not isinstance(metadata, dict):
        # Emptied when the power went, or damaged.
        return _file_to_open(_single_file(folder, f"{_METADATA_FILE} cannot be read"), made)
    try:
        information = metadata["rosbag2_bagfile_information"]
        corrected = {**information, **_corrections(folder, information)}
    except (YAMLError, LookupError, TypeError, AttributeError, ValueError):
        return folder  # rosbags says what is wrong with it
    if corrected == information:
        return folder
    shown = made() / folder.name
    shown.mkdir()
    for name in map(str, corrected["relative_file_paths"]):
        (shown / name).symlink_to((folder / name).absolute())
    with (shown / _METADATA_FILE).open("w") as stream:
        YAML(typ="safe").dump({"rosbag2_bagfile_information": corrected}, stream)
    return shown


def _corrections(folder: Path, information: dict[str, Any]) -> dict[str, Any]:
    """Entries of metadata.yaml that the files contradict."""
    named = [PurePath(name).name for name in information["relative_file_paths"]]
    missing = [name for name in named if not (folder / name).is_file()]
    present = [file.name for file in files_of(folder) if _is_of_messages(file) and file.name not in named]
    if len(missing) != len(present) and missing:
        raise LogError(
            f"{_METADATA_FILE} names {', '.join(missing)}, which is not there; there are "
            f"{', '.join(present) or 'no other files of messages'}: `ros2 bag reindex` renews it"
        )
    renamed = dict(zip(missing, present, strict=False))
    names = [renamed.get(name, name) for name in named]
    corrections: dict[str, Any] = {"relative_file_paths": names} if missing else {}
    contents = {_content(folder / name) for name in names}
    if len(contents) == 1:
        ((suffix, is_packed),) = contents
        storage = _STORAGES.get(suffix or "")
        if storage and information.get("storage_identifier") != storage:
            corrections["storage_identifier"] = storage
        mode = str(information.get("compression_mode", "")).lower()
        if is_packed and mode != "file":
            corrections |= {"compression_mode": "FILE", "compression_format": "zstd"}
        elif not is_packed and mode == "file":
            corrections |= {"compression_mode": "", "compression_format": ""}
    return corrections


def _require_unpackable(file: Path) -> None:
    """Refuse a compressed file that unpacks to too much; rosbags unpacks it to disk without a limit."""
    with file.open("rb") as stream:
        if not stream.read(max(map(len, _ZSTD_MAGICS))).startswith(_ZSTD_MAGICS):
            return
    packed = file.read_bytes()
    try:
        require_unpackable(len(packed), zstd_size(packed, unpacked_limit(len(packed))))
    except (LogError, zstd.ZstdError) as error:
        raise LogError(f"{file}: {error}") from error
