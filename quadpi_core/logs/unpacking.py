# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Limit on the unpacked size of a log, and decompressors with bounded output.

Every size in a header is compared with the limit before memory is allocated: a few kilobytes can unpack to
gigabytes.
"""

from __future__ import annotations

import bz2
import os
import zlib
from collections.abc import Iterator

from backports import zstd
from lz4 import frame as lz4

from quadpi_core.bounded_files import LIMIT_DEFAULT_MIB, LIMIT_VARIABLE
from quadpi_core.errors import LogError, QuadpiError

# A file may unpack to this many times its size, if that is more: repeated values compress to a fiftieth.
LIMIT_RATIO = 100
# Memory per message beside its bytes: a tuple, its log time and the header of a bytes object.
MESSAGE_BYTES = 150


def unpacked_limit(packed_bytes: int) -> int:
    """Largest number of bytes that a file of `packed_bytes` may unpack to.

    Raises:
        QuadpiError: if $QUADPI_UNPACKED_MIB is not a positive whole number.
    """
    text = os.environ.get(LIMIT_VARIABLE, str(LIMIT_DEFAULT_MIB))
    if not (text.isascii() and text.isdecimal() and len(text) < 10 and int(text) > 0):
        raise QuadpiError(f"{LIMIT_VARIABLE} must be a positive whole number of MiB, found {text!r}")
    return max(int(text) * 2**20, LIMIT_RATIO * packed_bytes)


def require_unpackable(packed_bytes: int, unpacked_bytes: int) -> None:
    """Refuse a file of `packed_bytes` that unpacks to more than :func:`unpacked_limit`.

    Raises:
        LogError: saying how much, and what raises the limit.
    """
    limit = unpacked_limit(packed_bytes)
    if unpacked_bytes > limit:
        raise LogError(
            f"unpacks to {_in_mib(unpacked_bytes)} or more, beyond the limit of {_in_mib(limit)}; "
            f"{LIMIT_VARIABLE} or `quadpi --unpacked-mib` raises it for files that can be trusted"
        )


def _in_mib(count: int) -> str:
    return f"{-(-count // 2**20)} MiB"


def unzstd(data: bytes | memoryview, size: int) -> bytes:
    """The content of one Zstandard frame or several, which must be `size` bytes.

    Raises:
        LogError: if it is of another size (unpacking stops one byte beyond `size`), or of more frames than
            any program writes.
        zstd.ZstdError: if the bytes are damaged.
    """
    return _of_size(b"".join(unzstd_blocks(data, size)), size)


def unlz4(data: bytes, size: int) -> bytes:
    """The content of one LZ4 frame, which must be `size` bytes.

    Raises:
        LogError: if it is of another size; no more than one byte beyond it is unpacked.
        RuntimeError: if the bytes are damaged.
    """
    # The library allocates the requested size; this is the most that so few bytes can hold.
    most = min(size, _LZ4_RATIO * len(data))
    return _of_size(lz4.LZ4FrameDecompressor().decompress(data, max_length=most + 1), size)


def unbz2(data: bytes, size: int) -> bytes:
    """The content of one bzip2 stream, which must be `size` bytes.

    Raises:
        LogError: if it is of another size; no more than one byte beyond it is unpacked.
        OSError: if the bytes are damaged.
    """
    return _of_size(bz2.BZ2Decompressor().decompress(data, max_length=size + 1), size)


def unzlib(data: bytes | memoryview, most: int) -> bytes:
    """The content of a zlib stream, at most `most` bytes of it.

    Raises:
        zlib.error: if the bytes are damaged or cut off.
    """
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(data, most)
    if not unpacker.eof and len(content) < most:
        raise zlib.error("the compressed data are cut off")
    return content


def zstd_size(data: bytes | memoryview, most: int) -> int:
    """How many bytes Zstandard frames unpack to: counted, not kept, and at most one beyond `most`.

    Raises:
        LogError: if there are more frames than any program writes.
        zstd.ZstdError: if the bytes are damaged.
    """
    return sum(map(len, unzstd_blocks(data, most)))


def unzstd_blocks(data: bytes | memoryview, most: int) -> Iterator[bytes]:
    """The content of Zstandard frames in blocks, up to one byte beyond `most` or to where they are cut.

    Raises:
        LogError: if there are more frames than any program writes.
        zstd.ZstdError: if the bytes are damaged.
    """
    unread = memoryview(data)
    frames = _FRAMES_MAX + len(data) // _FRAME_BYTES
    for _ in range(frames):
        unpacker = zstd.ZstdDecompressor()
        while not unpacker.eof:
            # In blocks: the library copies all input that a frame leaves unread.
            given = unread[:_BLOCK] if unpacker.needs_input else unread[:0]
            if unpacker.needs_input and not given:
                return
            unread = unread[len(given) :]
            part = unpacker.decompress(given, max_length=min(_BLOCK, most + 1))
            most -= len(part)
            yield part
            if most < 0:
                return
        position = len(data) - len(unread) - len(unpacker.unused_data)
        unread = memoryview(data)[position:]
    if unread:
        raise LogError(f"damaged: more than {frames} frames of Zstandard in {len(data)} bytes")


_BLOCK = 2**20
# Largest number of Zstandard frames: starting one takes 50 µs, and programs write one per file or per MB.
_FRAMES_MAX, _FRAME_BYTES = 10, 1000
_LZ4_RATIO = 256


def _of_size(unpacked: bytes, size: int) -> bytes:
    if len(unpacked) != size:
        found = "more" if len(unpacked) > size else str(len(unpacked))
        raise LogError(f"damaged: announces {size} bytes unpacked, holds {found}")
    return unpacked
