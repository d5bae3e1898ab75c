# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions of the message types that quadpi reads and writes: ROS 2 Jazzy's and those in msg/.

Parsed here and not by rosbags, as live nodes need them and no ROS distribution has rosbags; what bags need
beside (hashes, definitions as text, all types of Jazzy) rosbags knows.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, TypeAlias

from quadpi_core.messages.cdr import ANY, Codec, Field
from quadpi_core.paths import message_directory

if TYPE_CHECKING:
    from rosbags.interfaces.typing import Typesdict
    from rosbags.typesys.store import Typestore

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
_LINE = re.compile(r"([\w/]+)(?:<=\d+)?(\[(?:<=)?\d*\])?\s+(\w+)\s*(.*)", re.ASCII)
# No vehicle has more speed controllers, and no flying arena more bodies or markers.
ITEMS_MAX = 1024
# Types of ROS 2 Jazzy that are read and written here.
_STANDARD = """
builtin_interfaces/Time: int32 sec, uint32 nanosec
std_msgs/Header: builtin_interfaces/Time stamp, string frame_id
std_msgs/String: string data
geometry_msgs/Vector3: float64 x, float64 y, float64 z
geometry_msgs/Vector3Stamped: std_msgs/Header header, Vector3 vector
geometry_msgs/Point: float64 x, float64 y, float64 z
geometry_msgs/Quaternion: float64 x, float64 y, float64 z, float64 w
geometry_msgs/Pose: Point position, Quaternion orientation
geometry_msgs/PoseStamped: std_msgs/Header header, Pose pose
geometry_msgs/PoseWithCovariance: Pose pose, float64[36] covariance
geometry_msgs/Transform: Vector3 translation, Quaternion rotation
geometry_msgs/TransformStamped: std_msgs/Header header, string child_frame_id, Transform transform
geometry_msgs/Twist: Vector3 linear, Vector3 angular
geometry_msgs/TwistStamped: std_msgs/Header header, Twist twist
geometry_msgs/TwistWithCovariance: Twist twist, float64[36] covariance
geometry_msgs/Accel: Vector3 linear, Vector3 angular
geometry_msgs/AccelStamped: std_msgs/Header header, Accel accel
geometry_msgs/Wrench: Vector3 force, Vector3 torque
geometry_msgs/WrenchStamped: std_msgs/Header header, Wrench wrench
nav_msgs/Odometry: std_msgs/Header header, string child_frame_id, geometry_msgs/PoseWithCovariance pose, \
geometry_msgs/TwistWithCovariance twist
sensor_msgs/Imu: std_msgs/Header header, geometry_msgs/Quaternion orientation, \
float64[9] orientation_covariance, geometry_msgs/Vector3 angular_velocity, \
float64[9] angular_velocity_covariance, geometry_msgs/Vector3 linear_acceleration, \
float64[9] linear_acceleration_covariance
sensor_msgs/FluidPressure: std_msgs/Header header, float64 fluid_pressure, float64 variance
sensor_msgs/Temperature: std_msgs/Header header, float64 temperature, float64 variance
sensor_msgs/BatteryState: std_msgs/Header header, float32 voltage, float32 temperature, float32 current, \
float32 charge, float32 capacity, float32 design_capacity, float32 percentage, uint8 power_supply_status, \
uint8 power_supply_health, uint8 power_supply_technology, bool present, float32[] cell_voltage, \
float32[] cell_temperature, string location, string serial_number
tf2_msgs/TFMessage: geometry_msgs/TransformStamped[] transforms
"""


@dataclass(frozen=True)
class Member:
    """A field as its definition declares it.

    Attributes:
        type_name: a primitive of :data:`FORMATS`, "string", or a message such as `std_msgs/msg/Header`.
        count: of an array; None for one, and :data:`.cdr.ANY` for a sequence.
    """

    name: str
    type_name: str
    count: int | None


Types: TypeAlias = Mapping[str, tuple[Member, ...]]


@dataclass(frozen=True)
class Repeated:
    """An array of messages, or of a fixed count of strings, in a flattened message."""

    name: str
    type_name: str
    count: int


@cache
def standard_types() -> Types:
    """Types of ROS 2 that are read and written here, and the project's own messages."""
    types: dict[str, tuple[Member, ...]] = {}
    for line in _STANDARD.strip().splitlines():
        name, _, members = line.partition(": ")
        types |= parse_definition(_whole_name(name, ""), members.replace(", ", "\n"))
    for path in sorted(message_directory().glob("*.msg")):
        types |= parse_definition(f"quadpi/msg/{path.stem}", path.read_text())
    return types


def parse_definition(type_name: str, text: str) -> dict[str, tuple[Member, ...]]:
    """The types of a definition in the format `ros2msg`: a type, then others that it contains.

    Raises:
        ValueError: for a line that declares nothing, and a name that is given twice.
    """
    types = {}
    for number, section in enumerate(re.split("^=+\n", text, flags=re.MULTILINE)):
        name, lines = type_name, section.splitlines()
        if number:
            name = _whole_name(lines.pop(0).removeprefix("MSG:").strip(), "")
        members = [member for line in lines if (member := _member(line, name.partition("/")[0]))]
        if len({member.name for member in members}) < len(members):
            raise ValueError(f"{name}: a field is declared twice")
        types[name] = tuple(members) or (Member("structure_needs_at_least_one_member", "uint8", None),)
    return types


def _member(line: str, package: str) -> Member | None:
    """The field that a line declares; None for a constant or a comment."""
    code = line.partition("#")[0].strip()
    if not code:
        return None
    match = _LINE.fullmatch(code)
    if match is None:
        raise ValueError(f"`{line[:80]}` declares no field")
    base, array, name, rest = match.groups()
    if rest.startswith("="):
        return None
    length = (array or "").strip("[]")
    count = None if array is None else int(length) if length.isdecimal() else ANY
    return Member(name, base if base in {*FORMATS, "string"} else _whole_name(base, package), count)


def _whole_name(name: str, package: str) -> str:
    """Name of a message with its package: `Header` and `std_msgs/Header` are `std_msgs/msg/Header`."""
    if name == "Header":
        package = "std_msgs"
    *given, stem = name.split("/")
    return f"{given[0] if given else package}/msg/{stem}"


@cache
def typestore() -> Typestore:
    """The rosbags type store of ROS 2 Jazzy with the project's own messages registered."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

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
    from rosbags.interfaces import Nodetype
    from rosbags.typesys import TypesysError, get_types_from_msg

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
    fields: list[Field] = []
    for field in flat_fields(standard_types(), type_name):
        if isinstance(field, Repeated):
            raise TypeError(f"{type_name}: {field.name}: there is no codec for this kind of field")
        fields.append(field)
    return Codec(type_name, tuple(fields))


def flat_fields(types: Types, type_name: str, prefix: str = "") -> Iterator[Field | Repeated]:
    """The fields of a type in their order, those of contained messages in place of these.

    A contained message whose members are all numbers of one type, as a vector is, makes one field.

    Raises:
        KeyError: for a type that is contained and not among `types`.
    """
    for member in types[type_name]:
        path, contained, count = f"{prefix}{member.name}", member.type_name, member.count
        if contained in FORMATS:
            yield Field(path, FORMATS[contained], count)
        elif contained == "string" and count in {None, ANY}:
            yield Field(path, "string" if count is None else "strings")
        elif count is not None:
            yield Repeated(path, contained, count)
        else:
            members = list(flat_fields(types, contained, f"{path}."))
            scalars = {member.format for member in members if isinstance(member, Field) and member.is_scalar}
            if (
                len(members) > 1
                and len(scalars) == 1
                and all(isinstance(one, Field) and one.is_scalar for one in members)
            ):
                yield Field(path, scalars.pop(), len(members))
            else:
                yield from members
