# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""MAVLink messages that quadpi decodes: pymavlink's ardupilotmega dialect and two that it lacks.

ESC_INFO (290) and ESC_STATUS (291) of common.xml are marked as work in progress there, so that pymavlink
leaves them out; PX4 sends them. docs/mavlink.md shows them as XML.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

from quadpi_core.errors import require_library

# "common" lacks ArduPilot's ESC telemetry, and "all" imports far more.
_DIALECT = "pymavlink.dialects.v20.ardupilotmega"
_LETTERS = {
    "uint8_t": "B",
    "uint16_t": "H",
    "int16_t": "h",
    "int32_t": "i",
    "uint32_t": "I",
    "uint64_t": "Q",
    "float": "f",
}


class _Field(NamedTuple):
    name: str
    kind: str
    length: int = 0


class _Definition(NamedTuple):
    """A message with its fields in the order of the XML; on the wire they are sorted by size."""

    message_id: int
    name: str
    crc_extra: int
    fields: tuple[_Field, ...]


_ESC_INFO = _Definition(
    290,
    "ESC_INFO",
    251,
    (
        _Field("index", "uint8_t"),
        _Field("time_usec", "uint64_t"),
        _Field("counter", "uint16_t"),
        _Field("count", "uint8_t"),
        _Field("connection_type", "uint8_t"),
        _Field("info", "uint8_t"),
        _Field("failure_flags", "uint16_t", 4),
        _Field("error_count", "uint32_t", 4),
        _Field("temperature", "int16_t", 4),
    ),
)
_ESC_STATUS = _Definition(
    291,
    "ESC_STATUS",
    10,
    (
        _Field("index", "uint8_t"),
        _Field("time_usec", "uint64_t"),
        _Field("rpm", "int32_t", 4),
        _Field("voltage", "float", 4),
        _Field("current", "float", 4),
    ),
)


def load_dialect() -> Any:
    """The module of pymavlink's message types, with ESC_INFO and ESC_STATUS added.

    Raises:
        LogError: if pymavlink is not installed.
    """
    dialect = require_library(_DIALECT, "mavlink")
    for definition in (_ESC_INFO, _ESC_STATUS):
        # A later pymavlink may bring its own.
        dialect.mavlink_map.setdefault(definition.message_id, _message_class(dialect, definition))
    return dialect


def _message_class(dialect: Any, definition: _Definition) -> Any:
    """A message class such as pymavlink's generator writes."""
    fields = definition.fields
    wire = sorted(fields, key=lambda field: -struct.calcsize(_LETTERS[field.kind]))
    form = "<" + "".join(f"{field.length or ''}{_LETTERS[field.kind]}" for field in wire)
    names = [field.name for field in fields]

    def initialise(self: Any, *values: Any) -> None:
        dialect.MAVLink_message.__init__(self, definition.message_id, definition.name)
        self._fieldnames = names
        self._instance_field = "index"
        self._instance_offset = -1
        for name, value in zip(names, values, strict=True):
            setattr(self, name, value)

    def pack(self: Any, mav: Any, force_mavlink1: bool = False) -> bytes:
        values: list[Any] = []
        for field in wire:
            value = getattr(self, field.name)
            values += value if field.length else [value]
        packed: bytes = self._pack(
            mav, self.crc_extra, self.unpacker.pack(*values), force_mavlink1=force_mavlink1
        )
        return packed

    attributes = {
        "__init__": initialise,
        "pack": pack,
        "id": definition.message_id,
        "msgname": definition.name,
        "name": definition.name,
        "fieldnames": names,
        "ordered_fieldnames": [field.name for field in wire],
        "fieldtypes": [field.kind for field in fields],
        "fielddisplays_by_name": {},
        "fieldenums_by_name": {},
        "fieldunits_by_name": {},
        "native_format": bytearray(form.encode()),
        "orders": [wire.index(field) for field in fields],
        "lengths": [field.length or 1 for field in wire],
        "array_lengths": [field.length for field in wire],
        "crc_extra": definition.crc_extra,
        "unpacker": struct.Struct(form),
        "instance_field": "index",
        "instance_offset": -1,
    }
    return type(f"MAVLink_{definition.name.lower()}_message", (dialect.MAVLink_message,), attributes)
