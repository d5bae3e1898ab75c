# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 2 and ROS 1 as a log format; :mod:`quadpi_core.logs.bags` reads them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from quadpi_core.flight import Recording, Stamps
from quadpi_core.logs.log_format import Container, LogFormat
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_core.logs.bags import BagRecording
    from quadpi_core.messages.adapters import AdapterSettings

_FASTER = "its publisher sets the rate (of mavros: the service set_message_interval; of PX4: dds_topics.yaml)"
_SUFFIXES = (".mcap", ".db3", ".bag", ".zstd")
_MAGICS = (b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V")


def _is_bag_folder(folder: Path) -> bool:
    return (folder / "metadata.yaml").is_file() or any(
        file.is_file() and file.suffix.lower() in _SUFFIXES for file in folder.iterdir()
    )


def _load_adapters(name_or_path: str | Path) -> AdapterSettings:
    from quadpi_core.messages.adapters import AdapterSettings

    return AdapterSettings.load(name_or_path)


def _choose_topics(
    adapters: AdapterSettings | None, topics: Mapping[str, str], namespace: str
) -> AdapterSettings:
    from quadpi_core.messages.adapters import AdapterSettings

    return (adapters or AdapterSettings()).with_topics(topics, namespace)


def _read(path: Path, vehicle: Vehicle | None, adapters: AdapterSettings | None) -> Recording:
    from quadpi_core.logs.bags import read_bag

    return read_bag(path, vehicle, adapters)


def _open(
    path: Path, vehicle: Vehicle | None, adapters: AdapterSettings | None
) -> AbstractContextManager[BagRecording]:
    from quadpi_core.logs.bags import open_recording

    return open_recording(path, vehicle, adapters)


def _vehicle_name(path: Path) -> str:
    from quadpi_core.logs.bag_topics import bag_vehicle

    return bag_vehicle(path)


def _topic_stamps(path: Path) -> dict[str, Stamps] | None:
    from quadpi_core.logs.bag_inputs import holds_imu
    from quadpi_core.logs.bag_topics import bag_topics

    return None if holds_imu(path) else {topic.name: topic.stamps_ns for topic in bag_topics(path)}


FORMAT = LogFormat(
    description="bag (.mcap, .db3, .bag, also .zstd of them, rosbag2 folder)",
    read=_read,
    begins=lambda head: head.startswith(_MAGICS),
    suffixes=_SUFFIXES,
    is_folder=_is_bag_folder,
    load_mapping=_load_adapters,
    choose_topics=_choose_topics,
    container=Container(_open, _vehicle_name, _topic_stamps),
    remedies=dict.fromkeys(("imu", "rotor_speeds", "odometry", "mocap/pose", "mocap/twist"), _FASTER),
)
