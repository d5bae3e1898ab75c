# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""How much may be unpacked, and that nothing unpacks to more than was announced."""

import struct

import numpy as np
import pytest
from backports import zstd
from lz4 import frame as lz4

from quadpi_core.bounded_files import LIMIT_VARIABLE
from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.logs.unpacking import unlz4, unpacked_limit, unzstd, zstd_size


@pytest.mark.parametrize("limit", ["", "0", "-1", "1e3", "²", "9" * 20])
def test_a_limit_that_is_none(monkeypatch, limit):
    monkeypatch.setenv(LIMIT_VARIABLE, limit)
    with pytest.raises(QuadpiError, match="must be a positive whole number of MiB"):
        unpacked_limit(0)


def test_a_large_file_may_unpack_to_more():
    assert unpacked_limit(10 * 2**20) == 1000 * 2**20


@pytest.mark.parametrize(("pack", "unpack"), [(zstd.compress, unzstd), (lz4.compress, unlz4)])
def test_no_more_is_unpacked_than_was_announced(pack, unpack):
    packed = pack(b"quadpi" * 1000)
    assert unpack(packed, 6000) == b"quadpi" * 1000
    for size in (0, 1, 5999, 6001, 2**40):
        with pytest.raises(LogError, match=f"announces {size} bytes"):
            unpack(packed, size)
    with pytest.raises((LogError, RuntimeError, zstd.ZstdError)):
        unpack(packed[: len(packed) // 2], 6000)


def test_frames_of_zstandard_follow_each_other():
    packed = zstd.compress(b"ab") + zstd.compress(b"") + zstd.compress(b"cde")
    assert unzstd(packed, 5) == b"abcde"
    assert zstd_size(packed, 2**20) == 5
    assert zstd_size(packed[:-2], 2**20) <= 5


@pytest.mark.parametrize("frame", [struct.pack("<II", 0x184D2A50, 0), zstd.compress(b"")])
def test_frames_of_nothing(frame):
    """Each takes far longer to begin than its few bytes to read, and left the rest to be copied."""
    with pytest.raises(LogError, match=r"more than \d+ frames of Zstandard in"):
        unzstd(frame * 2**16, 0)
    with pytest.raises(LogError, match=r"more than \d+ frames of Zstandard in"):
        zstd_size(frame * 2**16, 2**20)


def test_ten_frames_of_a_small_file_and_one_more_for_each_kilobyte_are_unpacked():
    nothing = zstd.compress(b"")
    assert unzstd(nothing * 10, 0) == b""
    with pytest.raises(LogError, match="more than 10 frames of Zstandard in"):
        unzstd(nothing * 11, 0)
    long = zstd.compress(np.random.default_rng(0).bytes(3000))
    assert len(unzstd(long + nothing * 12, 3000)) == 3000
    with pytest.raises(LogError, match="more than 13 frames of Zstandard in"):
        unzstd(long + nothing * 13, 3000)
