# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Small files that unpack to gigabytes are refused in one line, before memory is taken for them."""

import sqlite3
import struct
from contextlib import closing

import numpy as np
import pyarrow as pa
import pyarrow.parquet
import pytest
import scipy.io
from backports import zstd
from lz4 import frame as lz4
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from quadpi_core.errors import LogError
from quadpi_core.logs import read_recording, sandbox
from quadpi_core.logs.bags import read_bag
from quadpi_core.logs.mcap_files import MAGIC
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.definitions import typestore
from quadpi_core.paths import LIMIT_VARIABLE

from .damage import refusing

BOMB_BYTES = 2**29
PACKERS = {"zstd": zstd.compress, "lz4": lz4.compress}


@pytest.fixture(scope="module")
def bombs():
    """Half a gigabyte of zeros in a few kB, and in 2 MB."""
    zeros = bytes(2**23)
    packed = {name: pack(zeros) for name, pack in PACKERS.items()}
    # Frames of Zstandard follow each other; one of LZ4 is long.
    packer = lz4.LZ4FrameCompressor()
    blocks = [
        packer.begin(),
        *(packer.compress(zeros) for _ in range(BOMB_BYTES // len(zeros))),
        packer.flush(),
    ]
    return {"zstd": packed["zstd"] * (BOMB_BYTES // len(zeros)), "lz4": b"".join(blocks)}


def record(opcode, content):
    return struct.pack("<BQ", opcode, len(content)) + content


def text(content):
    return struct.pack("<I", len(content)) + content


def bag_of(chunk, compression, announced):
    """An MCAP file of one chunk, without a summary."""
    header = struct.pack("<QQQI", 0, 1, announced, 0) + text(compression.encode())
    chunks = record(0x06, header + struct.pack("<Q", len(chunk)) + chunk)
    start = MAGIC + record(0x01, text(b"ros2") + text(b"quadpi"))
    return start + chunks + record(0x0F, bytes(4)) + record(0x02, bytes(20)) + MAGIC


@pytest.mark.parametrize("announced", [2**10, BOMB_BYTES, 2**63 - 1])
@pytest.mark.parametrize("compression", PACKERS)
def test_chunk_of_a_bag(bombs, tmp_path, compression, announced):
    path = tmp_path / "bomb.mcap"
    path.write_bytes(bag_of(bombs[compression], compression, announced))
    with refusing(path), pytest.raises(LogError, match=r"unpacks to|announces 1024 bytes|cannot be unpacked"):
        read_bag(path)
    with pytest.raises(LogError, match=r"unpacks to|announces 1024 bytes|cannot be unpacked"):
        read_recording(path, None)


def test_chunk_of_empty_records(tmp_path):
    """Each takes a few bytes of a chunk, and many times as much where it is looked at."""
    path = tmp_path / "bomb.mcap"
    chunk = record(0, b"") * 2**16
    path.write_bytes(bag_of(zstd.compress(chunk), "zstd", len(chunk)))
    with (
        refusing(path),
        pytest.raises(LogError, match="topic imu: missing"),
    ):
        read_bag(path)


@pytest.mark.parametrize("mode", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_bag_in_a_folder(monkeypatch, tmp_path, mode):
    monkeypatch.setenv(LIMIT_VARIABLE, "32")
    folder = tmp_path / "bag"
    store = typestore()
    bag = Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3)
    bag.set_compression(mode, CompressionFormat.ZSTD)
    with bag as writer:
        connection = writer.add_connection("/imu", sensor_messages.IMU, typestore=store)
        for time_ns in range(4):
            writer.write(connection, time_ns, bytes(2**24))
    assert sum(file.stat().st_size for file in folder.iterdir()) < 2**20
    with (
        refusing(folder),
        pytest.raises(LogError, match="unpacks to more than the limit of 32 MiB"),
    ):
        read_bag(folder)


@pytest.mark.parametrize("name", ["bag_0.mcap.zstd", "bag_0.bin"])
def test_bomb_in_a_compressed_file(bombs, tmp_path, name):
    """What the file itself unpacks to is small, and so is what its name says."""
    folder = tmp_path / "bag"
    bag = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
    bag.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with bag as writer:
        writer.write(writer.add_connection("/imu", sensor_messages.IMU, typestore=typestore()), 1, bytes(8))
    (file,) = folder.glob("*.zstd")
    file.unlink()
    (folder / name).write_bytes(zstd.compress(bag_of(bombs["zstd"], "zstd", BOMB_BYTES)))
    metadata = folder / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace(file.name, name))
    with refusing(folder), pytest.raises(LogError, match="unpacks to more than the limit"):
        read_bag(folder)


def test_matlab_file(monkeypatch, tmp_path):
    monkeypatch.setenv(LIMIT_VARIABLE, "16")
    path = tmp_path / "bomb.mat"
    scipy.io.savemat(path, {"m": np.zeros((1, 2**23))}, do_compression=True)
    assert path.stat().st_size < 2**20
    with refusing(path), pytest.raises(LogError, match="unpacks to more than the limit of 16 MiB"):
        read_recording(path, None)


def test_parquet_table_of_one_value(tmp_path):
    """Forty million rows of one value take a few kB, and a gigabyte as numbers."""
    path = tmp_path / "bomb.parquet"
    table = pa.table({"a": np.zeros(2**20), "b": np.zeros(2**20), "c": np.zeros(2**20)})
    with pyarrow.parquet.ParquetWriter(path, table.schema) as writer:
        for _ in range(40):
            writer.write_table(table, row_group_size=2**20)
    assert path.stat().st_size < 2**20
    with refusing(path), pytest.raises(LogError, match="unpacks to more than the limit of 256 MiB"):
        read_recording(path, None, "nanodrone")


@pytest.mark.parametrize(
    "content",
    [
        b"H " + b"a" * 1_200_000,
        b"H Product:Blackbox\n" * 6_000,
        b"H Field I name:" + b"a," * 600_000 + b"\n",
    ],
    ids=["line without an end", "many flights", "many fields"],
)
def test_headers_of_a_blackbox(tmp_path, content):
    path = tmp_path / "bomb.bbl"
    path.write_bytes(b"H Product:Blackbox flight data recorder by Nicholas Sherlock\n" + content)
    with refusing(path), pytest.raises(LogError, match="no frame of a flight can be read"):
        read_recording(path, None)


def test_messages_of_messages_in_a_ulog(monkeypatch, tmp_path):
    pytest.importorskip("pyulog", reason="pyulog is not installed")
    monkeypatch.setattr(sandbox, "_SECONDS", 1)
    path = tmp_path / "bomb.ulg"
    data = b"ULog\x01\x12\x35\x01" + bytes(8)
    for text in (b"esc_status:uint64_t timestamp;a[60000] a;", b"a:b[60000] b;", b"b:float[60000] c;"):
        data += struct.pack("<HB", len(text), ord("F")) + text
    data += struct.pack("<HB", 13, ord("A")) + bytes(3) + b"esc_status"
    path.write_bytes(data)
    with (
        refusing(path),
        pytest.raises(LogError, match=r"unpacks to more than the limit|does not end"),
    ):
        read_recording(path, None)


def test_a_file_that_leads_a_reader_back(monkeypatch, tmp_path):
    """pyulog goes back by the length of a message that is cut off, for ever."""
    pytest.importorskip("pyulog", reason="pyulog is not installed")
    path = tmp_path / "loop.ulg"
    path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8) + b"\xff\x00\xee" * 20)
    monkeypatch.setattr(sandbox, "_SECONDS", 1)
    with refusing(path), pytest.raises(LogError):
        read_recording(path, None)


def test_the_limit_can_be_raised(monkeypatch, tmp_path):
    path = tmp_path / "bomb.mcap"
    data = record(0x0F, bytes(2**20 - 8))
    path.write_bytes(bag_of(zstd.compress(data), "zstd", len(data)))
    monkeypatch.setenv(LIMIT_VARIABLE, "1")
    expected = "unpacks to more than the limit of 1 MiB, .*; QUADPI_UNPACKED_MIB or `quadpi --unpacked"
    with pytest.raises(LogError, match=expected):
        read_bag(path)
    monkeypatch.setenv(LIMIT_VARIABLE, "2")
    with pytest.raises(LogError, match="topic imu: missing"):
        read_bag(path)


@pytest.mark.parametrize("table", ["schema", "metadata", "topics", "message_definitions", "messages"])
def test_a_database_that_counts(tmp_path, table):
    """A view may have no end: rows that nobody stored are counted and grouped as the bag is opened."""
    folder = tmp_path / "bag"
    with Writer(folder, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        writer.write(writer.add_connection("/imu", sensor_messages.IMU, typestore=typestore()), 1, bytes(8))
    (path,) = folder.glob("*.db3")
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"ALTER TABLE {table} RENAME TO other")
        database.execute(f"CREATE VIEW {table.title()} AS SELECT * FROM other")
        database.commit()
    with refusing(path), pytest.raises(LogError, match=f"`{table}` computes what it holds"):
        read_bag(path)
