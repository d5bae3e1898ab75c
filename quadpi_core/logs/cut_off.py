# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MCAP files that were cut off, as by a crash or a full disk: a copy that ends with the last whole record."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from quadpi_core.errors import LogError
from quadpi_core.logs.mcap_files import DATA_END, FOOTER, MAGIC, RECORD_PREFIX, records_of
from quadpi_core.paths import scratch_folder

# The end of a file without a summary (MCAP specification): a data end without checksum, a footer, the magic.
_ENDING = struct.pack("<BQI", DATA_END, 4, 0) + struct.pack("<BQQQI", FOOTER, 20, 0, 0, 0) + MAGIC
_COPIED_BYTES = 1 << 24


def is_cut_off(bag: Path) -> bool:
    """Whether a file, or the only one in a folder, begins as an MCAP file and does not end as one."""
    file = _mcap_file(bag)
    if file is None:
        return False
    with file.open("rb") as stream:
        begins = stream.read(len(MAGIC)) == MAGIC
        stream.seek(0, 2)
        stream.seek(max(0, stream.tell() - len(MAGIC)))
        return begins and stream.read() != MAGIC


@contextmanager
def whole_part(bag: Path) -> Iterator[Path]:
    """A bag that can be read: the same, or of one that is cut off a copy of its whole records.

    The last chunk of messages is lost where the cut is in it. Errors within the block name `bag`.
    """
    if not is_cut_off(bag):
        yield bag
        return
    file = _mcap_file(bag)
    assert file is not None
    with scratch_folder() as folder:
        copy = folder / file.name
        try:
            _copy_whole_records(file, copy)
            yield copy
        except LogError as error:
            raise LogError(f"{str(error).replace(str(copy), str(bag))} (the file is cut off)") from error


def _mcap_file(bag: Path) -> Path | None:
    """The file with the messages; None where there are several, or it is of another container."""
    if bag.is_dir():
        # A recorder that was killed has not written metadata.yaml.
        files = [] if (bag / "metadata.yaml").exists() else list(bag.glob("*.mcap"))
        return files[0] if len(files) == 1 else None
    return bag if bag.is_file() and bag.suffix == ".mcap" else None


def _copy_whole_records(source: Path, target: Path) -> None:
    end = len(MAGIC)
    with source.open("rb") as stream, target.open("xb") as copy:
        for opcode, start, length in records_of(stream, source.stat().st_size):
            if opcode == DATA_END:
                # The data are whole, only their summary is not.
                end = start - RECORD_PREFIX
                break
            end = start + length
        if end == len(MAGIC):
            raise LogError(f"{target}: cut off within its first record")
        stream.seek(0)
        while end > 0 and (part := stream.read(min(end, _COPIED_BYTES))):
            copy.write(part)
            end -= len(part)
        copy.write(_ENDING)
