# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What pages say that they unpack to: what the footer says of sound files, and of others more."""

import io
from types import SimpleNamespace

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
    assert 0.5 * footer < unpacked_bytes(memoryview(file.getvalue()), metadata) < footer


def metadata_of(start, size):
    column = SimpleNamespace(
        data_page_offset=start,
        dictionary_page_offset=None,
        has_dictionary_page=False,
        total_compressed_size=size,
    )
    group = SimpleNamespace(column=lambda _: column)
    return SimpleNamespace(num_row_groups=1, num_columns=1, row_group=lambda _: group)


def test_a_page_that_unpacks_to_more_than_the_footer_says():
    data = LYING + bytes(10)
    assert unpacked_bytes(memoryview(data), metadata_of(0, len(data))) == 2**31 - 1


@pytest.mark.parametrize(
    ("data", "start", "message"),
    [
        (LYING[:5], 0, "the page header at byte 0 is none"),
        (b"\x15\x00\x00", 0, "the page header at byte 0 is none"),
        (b"\x15\x00\x15\x01\x15\x14\x00", 0, "names a negative size"),
        (b"\x1d\x00" * 10, 0, "the page header at byte 0 is none"),
        (b"\x1c" * 50, 0, "the page header at byte 0 is none"),
        (b"\x15\x00\x15\x00\x15\x00\x00" * 9, 0, "its columns overlap"),
        (LYING, -5, "a column from byte -5"),
        (LYING, 5, "a column from byte 5 to 16 of 11"),
    ],
)
def test_damaged_headers(data, start, message):
    with pytest.raises(LogError, match=message):
        unpacked_bytes(memoryview(data), metadata_of(start, len(data)))
