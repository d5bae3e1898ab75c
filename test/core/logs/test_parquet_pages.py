# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What pages say that they unpack to: what the footer says of sound files, and of others more."""

import io
import struct

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest

from quadpi_core.errors import LogError
from quadpi_core.logs.parquet_pages import unpacked_bytes

# Type 0 (data), unpacked to 2 GiB - 1, packed in 10 bytes; the end of the header.
LYING = b"\x15\x00\x15\xfe\xff\xff\xff\x0f\x15\x14\x00"
ROWS = 5000


@pytest.mark.parametrize("compression", ["none", "snappy", "zstd", "gzip"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
@pytest.mark.parametrize("rich", [False, True])
def test_sound_files(compression, version, rich):
    table = pa.table(
        {
            "a": np.random.default_rng(1).normal(size=ROWS),
            "b": np.arange(ROWS) % 7,
            "c": pa.array([None if row % 3 else "x" for row in range(ROWS)]),
            "d": pa.array([[1, 2]] * ROWS),
        }
    )
    file = io.BytesIO()
    options = {"data_page_size": 2000, "row_group_size": 1500, "write_page_index": rich}
    pyarrow.parquet.write_table(
        table, file, compression=compression, data_page_version=version, use_dictionary=rich, **options
    )
    metadata = pyarrow.parquet.ParquetFile(file).metadata
    groups = [metadata.row_group(group) for group in range(metadata.num_row_groups)]
    # The footer counts the headers of the pages as well.
    footer = sum(group.total_byte_size for group in groups)
    numbers = 8 * ROWS * metadata.num_columns
    assert max(0.5 * footer, numbers) <= unpacked_bytes(memoryview(file.getvalue())) <= max(footer, numbers)


def number(value):
    """In zigzag, seven bits a byte."""
    value, out = value << 1 if value >= 0 else (-value << 1) - 1, bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def file_of(pages, start=4, rows=1):
    """A file of one column, whose pages begin at a byte; the footer says nothing more than it must."""
    column = b"\x76" + number(len(pages)) + b"\x26" + number(start) + b"\x00"
    chunk = b"\x3c" + column + b"\x00"
    group = b"\x19\x1c" + chunk + b"\x26" + number(rows) + b"\x00"
    footer = b"\x49\x1c" + group + b"\x00"
    return b"PAR1" + pages + footer + struct.pack("<I", len(footer)) + b"PAR1"


def test_a_page_that_unpacks_to_more_than_the_footer_says():
    assert unpacked_bytes(memoryview(file_of(LYING + bytes(10)))) == 2**31 - 1


def test_rows_count_as_numbers():
    assert unpacked_bytes(memoryview(file_of(b"", rows=10**12))) == 8 * 10**12


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (file_of(LYING[:5]), "at byte 4 is none"),
        (file_of(b"\x15\x00\x00"), "at byte 4 is none"),
        (file_of(b"\x15\x00\x15\x01\x15\x14\x00"), "names a negative size"),
        (file_of(b"\x1d\x00" * 10), "at byte 4 is none"),
        (file_of(b"\x1c" * 50), "at byte 4 is none"),
        (file_of(b"\x15\x00\x15\x00\x15\x00\x00" * 90), "its columns overlap"),
        (file_of(LYING, start=-5), "a column from byte -5"),
        (file_of(LYING, start=50), "a column from byte 50 to 61 of"),
        (file_of(LYING)[:-1], "has no footer"),
        (b"PAR1" + b"\xff" * 8 + b"PAR1", "is none"),
        (b"", "has no footer"),
    ],
)
def test_damaged_headers(data, message):
    with pytest.raises(LogError, match=message):
        unpacked_bytes(memoryview(data))
