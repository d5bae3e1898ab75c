# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bag is read by the content of its files, whatever their names and metadata.yaml say."""

import shutil

import pytest
from backports import zstd
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from ruamel.yaml import YAML

from quadpi_core.errors import LogError
from quadpi_core.logs import decode_recording, is_log_folder, read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.paths import LIMIT_VARIABLE
from quadpi_core.vehicle import Vehicle

from .bag_examples import write_folder

PLUGINS = [StoragePlugin.MCAP, StoragePlugin.SQLITE3]


@pytest.fixture(params=PLUGINS)
def bag(tmp_path, sensor_topics, request):
    """The folder of a bag, and its file."""
    folder = tmp_path / "recorded"
    write_folder(folder, sensor_topics, request.param, CompressionMode.NONE)
    (file,) = (file for file in folder.iterdir() if file.suffix != ".yaml")
    return folder, file


def pack(file):
    packed = file.with_name(f"{file.name}.zstd")
    packed.write_bytes(zstd.compress(file.read_bytes()))
    file.unlink()
    return packed


def with_metadata(folder, **changes):
    path, yaml = folder / "metadata.yaml", YAML(typ="safe")
    metadata = yaml.load(path.read_text())
    metadata["rosbag2_bagfile_information"] |= changes
    with path.open("w") as stream:
        yaml.dump(metadata, stream)


@pytest.mark.parametrize("identifier", ["", None, "mcap", "sqlite3", "of another program"])
def test_the_storage_is_told_by_the_file(bag, same_flight, identifier):
    with_metadata(bag[0], storage_identifier=identifier)
    same_flight(bag[0])


@pytest.mark.parametrize("content", ["", "rosbag2_bagfile_information: [", "\0" * 100])
def test_metadata_that_were_lost_when_the_power_went(bag, same_flight, content):
    folder, file = bag
    (folder / "metadata.yaml").write_text(content)
    same_flight(folder)
    shutil.copy(file, folder / f"second{file.suffix}")
    with pytest.raises(LogError, match=r"metadata.yaml cannot be read, and 2 files of messages: `ros2 bag"):
        Bag(folder)


@pytest.mark.parametrize("name", ["of_monday", "of_monday.zstd", "recorded.zstd"])
def test_a_file_that_was_renamed_or_compressed_by_hand(bag, same_flight, name):
    folder, file = bag
    renamed = file.rename(folder / f"{name.removesuffix('.zstd')}{file.suffix}")
    if name.endswith(".zstd"):
        pack(renamed)
    same_flight(folder)


def test_a_compressed_file_that_was_unpacked_by_hand(bag, same_flight):
    folder, file = bag
    names = [f"{file.name}.zstd"]
    with_metadata(folder, compression_mode="FILE", compression_format="zstd", relative_file_paths=names)
    same_flight(folder)


def test_a_compressed_file_by_itself_and_in_a_folder_without_metadata(bag, same_flight):
    folder, file = bag
    (folder / "metadata.yaml").unlink()
    packed = pack(file)
    assert is_log_folder(folder)
    same_flight(packed)
    same_flight(folder)
    assert decode_recording(packed, Vehicle.load("bebop2")).name == file.stem


def test_a_file_whose_name_says_another_container_or_none(bag, same_flight):
    folder, file = bag
    for name in (f"{file.name}.active", "flight", f"flight{'.db3' if file.suffix == '.mcap' else '.mcap'}"):
        shutil.copy(file, folder.parent / name)
        same_flight(folder.parent / name)


def test_files_that_are_not_there_are_named(bag):
    folder, file = bag
    with_metadata(folder, relative_file_paths=[file.name, "second", "third"])
    expected = "recorded: metadata.yaml names second, third, .* there are no other .* `ros2 bag reindex`"
    with pytest.raises(LogError, match=expected):
        Bag(folder)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (zstd.compress(b"\x89MCAP0\r\n" + bytes(10**7), 1), "unpacks to more than the limit"),
        (zstd.compress(b"time,ax,ay\n" * 20), "what it holds compressed is no bag; `zstd -d`"),
        (zstd.compress(b"\x89MCAP0\r\n" + bytes(500)), "flight.mcap.zstd: .*cut off"),
        (zstd.compress(b"\x89MCAP0\r\n" + bytes(500))[:20], "flight.mcap.zstd"),
        (b"time,ax,ay\n" * 20, "flight.mcap.zstd"),
    ],
    ids=["bomb", "table", "short", "cut", "text"],
)
def test_what_is_compressed_and_no_bag_is_refused(tmp_path, content, message, monkeypatch):
    monkeypatch.setenv(LIMIT_VARIABLE, "8")
    path = tmp_path / "flight.mcap.zstd"
    path.write_bytes(content)
    with pytest.raises(LogError, match=message) as refused:
        read_recording(path, None)
    assert "\n" not in str(refused.value)
    assert ".quadpi." not in str(refused.value)
