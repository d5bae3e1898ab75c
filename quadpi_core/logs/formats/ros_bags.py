# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags of ROS 2 and ROS 1 as a log format; :mod:`quadpi_core.logs.bags` reads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from quadpi_core.logs.log_format import Container, LogFormat

_SUFFIXES = (".mcap", ".db3", ".bag", ".zstd")
_MAGICS = (b"\x89MCAP0\r\n", b"SQLite format 3\0", b"#ROSBAG V")


def _late(name: str) -> Callable[..., Any]:
    """A function that is imported when it is called, as logs of other formats need none of these rooms."""

    def call(*arguments: Any) -> Any:
        return resolve_name(f"quadpi_core.{name}")(*arguments)

    return call


def _is_bag_folder(folder: Path) -> bool:
    return (folder / "metadata.yaml").is_file() or any(
        file.is_file() and file.suffix.lower() in _SUFFIXES for file in folder.iterdir()
    )


FORMAT: LogFormat[Any] = LogFormat(
    description="bag (.mcap, .db3, .bag, also .zstd of them, rosbag2 folder)",
    read=_late("logs.bags:read_bag"),
    begins=lambda head: head.startswith(_MAGICS),
    suffixes=_SUFFIXES,
    is_folder=_is_bag_folder,
    load_mapping=_late("messages.adapters.adapter_settings:AdapterSettings.load"),
    choose_topics=_late("messages.adapters.adapter_settings:with_topics"),
    container=Container(
        _late("logs.bags:open_recording"),
        _late("logs.bag_topics:bag_vehicle"),
        _late("logs.bag_inputs:stamps_without_imu"),
    ),
    remedies=dict.fromkeys(
        ("imu", "rotor_speeds", "odometry", "mocap/pose", "mocap/twist"),
        "its publisher sets the rate (of mavros: the service set_message_interval; of PX4: dds_topics.yaml)",
    ),
)
