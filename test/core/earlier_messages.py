# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Messages as versions of quadpi before defined them, written by rosbags."""

from __future__ import annotations

from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.sensor_messages import ERPM, PREDICTION, ROTOR_SPEEDS

FIELDS = {ROTOR_SPEEDS: "rotor_speeds", ERPM: "erpm"}
AXES = ("fx", "fy", "fz", "mx", "my", "mz")
WRENCHES = ("predicted", "lower", "upper", "measured", "relative_width")


def earlier_definition(type_name: str) -> str:
    """A definition as it stood before."""
    if type_name == PREDICTION:
        scalars = "".join(f"float64 {wrench}_{axis}\n" for wrench in WRENCHES for axis in AXES)
        return f"std_msgs/Header header\nstring model\nfloat64 confidence\nuint8 axes\n{scalars}"
    return f"# speeds of float64[] once\nstd_msgs/Header header\nfloat64[4] {FIELDS[type_name]}  # [rad/s]\n"


def earlier_store(type_name: str) -> Typestore:
    """Types of ROS 2 and one of quadpi's as it stood before."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(earlier_definition(type_name), type_name))
    return store


def earlier_messages(type_name: str, frames: list[str], *values: Any) -> Payloads:
    """Messages stamped 7 ns after each second from 0 on, of a column of values per field."""
    store = earlier_store(type_name)
    header, time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    return Payloads.join(
        [
            bytes(
                store.serialize_cdr(
                    store.types[type_name](header(time(sec, 7), frame), *(column[sec] for column in values)),
                    type_name,
                )
            )
            for sec, frame in enumerate(frames)
        ]
    )
