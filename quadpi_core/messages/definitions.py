# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions of the message types that quadpi reads and writes: ROS 2 Jazzy's and those in msg/."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Typesdict
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from quadpi_core.messages.cdr import ANY, Codec, Field
from quadpi_core.paths import message_directory

FORMATS = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
_SEPARATOR = "=" * 80
_TYPE_NAME = re.compile(r"\w+(/\w+)+", re.ASCII)
# No vehicle has more speed controllers, and no flying arena more bodies or markers.
ITEMS_MAX = 1024


@cache
def typestore() -> Typestore:
    """The rosbags type store of ROS 2 Jazzy with the project's own messages registered."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in sorted(message_directory().glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(), f"quadpi/msg/{path.stem}"))
    return store


def parsed_definition(type_name: str, text: str) -> Typesdict:
    """The types of a definition that a bag embeds, safe to give to rosbags.

    rosbags executes code that it makes of names, and repeats it for each item of a fixed array.

    Raises:
        TypesysError: for an invalid definition or name, and for an array of more than ITEMS_MAX messages.
    """
    if not _TYPE_NAME.fullmatch(type_name):
        raise TypesysError(f"{type_name!r} names no type")
    types = get_types_from_msg(text, type_name)
    for _, fields in types.values():
        for name, description in fields:
            match description:
                case (Nodetype.ARRAY, ((Nodetype.NAME, _) | (Nodetype.BASE, ("string", _)), int(count))):
                    if count > ITEMS_MAX:
                        raise TypesysError(f"the array {name} has {count} items")
    return types


@cache
def definition_text(type_name: str) -> str:
    """The definition of a type and all that it contains, as a bag embeds it (`ros2msg`).

    The project's own messages keep their comments: units and frames travel with the bag.
    """
    generated = typestore().generate_msgdef(type_name, ros_version=2)[0]
    package, _, stem = type_name.split("/")
    if package != "quadpi":
        return generated
    own_text = (message_directory() / f"{stem}.msg").read_text()
    _, *contained = generated.split(f"{_SEPARATOR}\n")
    return f"{_SEPARATOR}\n".join([own_text, *contained])


@cache
def codec(type_name: str) -> Codec:
    """The codec of a type; fields are named by their path, such as `pose.pose.position`.

    A contained message whose members are all of one primitive type (a vector, a quaternion) is one
    array field.
    """
    return Codec(type_name, tuple(_flat_fields(typestore().fielddefs, type_name, "")))


def _flat_fields(fielddefs: Mapping[str, Any], type_name: str, prefix: str) -> Iterator[Field]:
    for name, description in fielddefs[type_name][1]:
        path = f"{prefix}{name}"
        match description:
            case (Nodetype.BASE, ("string", _)):
                yield Field(path, "string")
            case (Nodetype.BASE, (str(base), _)):
                yield Field(path, FORMATS[base])
            case (Nodetype.ARRAY, ((Nodetype.BASE, (str(base), _)), int(count))):
                yield Field(path, FORMATS[base], count)
            case (Nodetype.SEQUENCE, ((Nodetype.BASE, ("string", _)), _)):
                yield Field(path, "strings")
            case (Nodetype.SEQUENCE, ((Nodetype.BASE, (str(base), _)), _)):
                yield Field(path, FORMATS[base], ANY)
            case (Nodetype.NAME, str(contained)):
                members = list(_flat_fields(fielddefs, contained, f"{path}."))
                formats = {member.format for member in members}
                if len(formats) == 1 and all(member.is_scalar for member in members):
                    yield Field(path, formats.pop(), len(members))
                else:
                    yield from members
            case _:
                raise TypeError(f"{type_name}: {path}: there is no codec for this kind of field")
