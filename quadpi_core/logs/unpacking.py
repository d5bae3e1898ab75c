# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How much a log may unpack to, and decompressors that never give more than they are asked for.

Whatever a header announces is held against one limit before memory is taken for it: a few kilobytes can
unpack to gigabytes.
"""

from __future__ import annotations

import os
import zlib

from backports import zstd
from lz4 import frame as lz4

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.reading import LIMIT_DEFAULT_MIB, LIMIT_VARIABLE

# A larger file may unpack to this many times its size: values that repeat pack 50 times smaller.
LIMIT_RATIO = 100


def unpacked_limit(packed_bytes: int) -> int:
    """How many bytes a file of `packed_bytes` may unpack to.

    Raises:
        QuadpiError: if $QUADPI_UNPACKED_MIB is no positive whole number.
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
        LogError: if it is of another size; no more than one byte beyond it is unpacked.
        zstd.ZstdError: if the bytes are damaged.
    """
    parts, room = [], size
    while data and room >= 0:
        unpacker = zstd.ZstdDecompressor()
        parts.append(unpacker.decompress(data, max_length=room + 1))
        room -= len(parts[-1])
        if not unpacker.eof:
            break
        data = unpacker.unused_data
    return _of_size(b"".join(parts), size)


def unlz4(data: bytes, size: int) -> bytes:
    """The content of one LZ4 frame, which must be `size` bytes.

    Raises:
        LogError: if it is of another size; no more than one byte beyond it is unpacked.
        RuntimeError: if the bytes are damaged.
    """
    # The library takes memory for as much as it is asked for; this is the most that such bytes can hold.
    most = min(size, _LZ4_RATIO * len(data))
    return _of_size(lz4.LZ4FrameDecompressor().decompress(data, max_length=most + 1), size)


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
    """How many bytes Zstandard frames unpack to: counted, not kept, and not much beyond `most`.

    Raises:
        zstd.ZstdError: if the bytes are damaged.
    """
    size = 0
    while data and size <= most:
        unpacker = zstd.ZstdDecompressor()
        while not unpacker.eof and size <= most:
            count = len(unpacker.decompress(data, max_length=_BLOCK))
            data = b""
            if not count and unpacker.needs_input:
                return size
            size += count
        data = unpacker.unused_data if unpacker.eof else b""
    return size


_BLOCK = 2**20
_LZ4_RATIO = 256


def _of_size(unpacked: bytes, size: int) -> bytes:
    if len(unpacked) != size:
        found = "more" if len(unpacked) > size else str(len(unpacked))
        raise LogError(f"damaged: announces {size} bytes unpacked, holds {found}")
    return unpacked
