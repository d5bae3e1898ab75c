# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink messages that quadpi decodes: pymavlink's ardupilotmega dialect and two that it lacks.

ESC_INFO (290) and ESC_STATUS (291) of common.xml are marked as work in progress there, so that pymavlink
leaves them out; PX4 sends them. docs/esc_messages.xml defines them.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np

from quadpi_core.errors import require_library

# "common" lacks ArduPilot's ESC telemetry, and "all" imports far more.
_DIALECT = "pymavlink.dialects.v20.ardupilotmega"


class _Definition(NamedTuple):
    """A message: `fields` are names in the order of the XML, each with its format for :mod:`struct`."""

    message_id: int
    name: str
    crc_extra: int
    fields: dict[str, str]


_ESC_INFO = _Definition(
    290,
    "ESC_INFO",
    251,
    {
        "index": "B",
        "time_usec": "Q",
        "counter": "H",
        "count": "B",
        "connection_type": "B",
        "info": "B",
        "failure_flags": "4H",
        "error_count": "4I",
        "temperature": "4h",
    },
)
_ESC_STATUS = _Definition(
    291, "ESC_STATUS", 10, {"index": "B", "time_usec": "Q", "rpm": "4i", "voltage": "4f", "current": "4f"}
)


def load_dialect() -> Any:
    """The module of pymavlink's message types, with ESC_INFO and ESC_STATUS added.

    Raises:
        LogError: if pymavlink is not installed.
    """
    dialect = require_library(_DIALECT, "mavlink")
    for definition in (_ESC_INFO, _ESC_STATUS):
        # A later pymavlink may bring its own.
        if definition.message_id not in dialect.mavlink_map:
            dialect.mavlink_map[definition.message_id] = _message_class(dialect, definition)
    return dialect


def _message_class(dialect: Any, definition: _Definition) -> Any:
    """What pymavlink's generator writes, as far as packing and parsing look at it."""
    message_id, name, crc_extra, fields = definition
    # On the wire, larger numbers come first.
    wire = sorted(fields, key=lambda field: -struct.calcsize(fields[field][-1]))

    def initialise(self: Any, *values: Any) -> None:
        dialect.MAVLink_message.__init__(self, message_id, name)
        self._fieldnames = list(fields)
        self.__dict__ |= dict(zip(fields, values, strict=True))

    def pack(self: Any, mav: Any, force_mavlink1: bool = False) -> Any:
        values = np.hstack([np.array(getattr(self, field), dtype=object) for field in wire])
        return self._pack(mav, crc_extra, self.unpacker.pack(*values), force_mavlink1=force_mavlink1)

    attributes = {
        "__init__": initialise,
        "pack": pack,
        "id": message_id,
        "msgname": name,
        "fieldnames": list(fields),
        "ordered_fieldnames": wire,
        "orders": [wire.index(field) for field in fields],
        "lengths": [int(fields[field][:-1] or 1) for field in wire],
        "crc_extra": crc_extra,
        "unpacker": struct.Struct("<" + "".join(fields[field] for field in wire)),
    }
    return type(f"MAVLink_{name.lower()}_message", (dialect.MAVLink_message,), attributes)
