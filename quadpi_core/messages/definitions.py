# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Definitions of the message types that quadpi reads and writes: ROS 2 Jazzy's and those in msg/.

Parsed here and not by rosbags, as live nodes need them and no ROS distribution has rosbags; what bags need
beside (hashes, definitions as text, all types of Jazzy) rosbags knows.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core.errors import LogError, SampleError, one_line
from quadpi_core.messages.cdr import ANY, ORIGIN, Codec, Columns, Field
from quadpi_core.messages.payloads import Indices, Payloads
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
            if not lines:
                raise ValueError("a separator with no type behind it")
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


# They may hold arrays of messages, and their definition comes with the bag or from the package. Not by
# rosbags, which live nodes do without (see :mod:`quadpi_core.messages.definitions`), and which makes objects:
# four transforms take it 25 µs, and 14 µs here. :mod:`quadpi_core.messages.cdr` has the codec for our own
# messages.

_REASON_LENGTH = 80
# Of a message, flattened, with the items of its arrays once: types that contain others twice grow by powers.
_FIELDS_MAX = 10_000
_PADDING_MAX = 3
_LENGTH = struct.Struct("<I")
_ALIGNMENTS = 8
# Reads one field or several at a position behind the encapsulation, and appends what is wanted to the lists
# of values by path; gives the position behind it.
_Step: TypeAlias = Callable[[bytes, int, dict[str, list[Any]]], int]


@dataclass(frozen=True)
class Items:
    """The items of one array in N messages.

    Attributes:
        counts: (N,) number of items in each message.
        columns: (M, ...) one row per item, message after message.
    """

    counts: Indices
    columns: Columns

    @property
    def message(self) -> Indices:
        """(M,) the message that each item is of."""
        return np.repeat(np.arange(len(self.counts)), self.counts)


class ForeignCodec:
    """Decodes messages of one type, at most one array of messages deep."""

    def __init__(self, type_name: str, types: Types, wanted: Mapping[str, int]) -> None:
        self._type_name = type_name
        flat = list(flat_fields(types, type_name))
        self._top = {field.name: field for field in flat if isinstance(field, Field) and field.name in wanted}
        self._arrays = {}
        for array in (field for field in flat if isinstance(field, Repeated) and field.type_name in types):
            items = list(flat_fields(types, array.type_name, f"{array.name}."))
            columns = {one.name: one for one in items if isinstance(one, Field) and one.name in wanted}
            if columns:
                self._arrays[array.name] = columns
        known = {**self._top, **{path: field for one in self._arrays.values() for path, field in one.items()}}
        for path, width in wanted.items():
            if path not in known or width != _width(known[path]):
                raise LogError(f"this version of {type_name} has no field {path} of the kind known here")
        self._read = _in_order(list(_steps(types, flat, {*wanted, *self._arrays})))

    def decode(self, payloads: Payloads | bytes) -> tuple[Columns, dict[str, Items]]:
        """Decode N > 0 messages (or one): columns of what is in no array, and the items of each array.

        Raises:
            SampleError: naming the sample whose bytes are no message of this type.
        """
        arrays = self._arrays.items()
        values: dict[str, list[Any]] = {
            path: [] for fields_of in (self._top, *self._arrays.values()) for path in fields_of
        }
        values |= {array: [] for array in self._arrays}
        for sample, message in enumerate((payloads,) if isinstance(payloads, bytes) else payloads):
            try:
                end = ORIGIN + self._read(message, 0, values)
                if message[:2] != b"\x00\x01" or not 0 <= len(message) - end <= _PADDING_MAX:
                    raise ValueError("another encapsulation or length")
            except (struct.error, ValueError) as error:
                raise SampleError(sample, f"its {len(message)} bytes are no {self._type_name}") from error
        columns = {path: _column(field, values[path]) for path, field in self._top.items()}
        items = {}
        for array, own in arrays:
            members = {path.removeprefix(f"{array}."): _column(f, values[path]) for path, f in own.items()}
            items[array] = Items(np.array(values[array], dtype=np.int64), members)
        return columns, items


def _width(field: Field) -> int | None:
    """How many numbers a column has per row, ANY for a sequence, 0 for text; None for what is no column."""
    if field.format == "string":
        return 0
    if field.is_variable:
        return ANY if field.is_number else None
    return field.count or 1


def _column(field: Field, values: list[Any]) -> npt.NDArray[Any]:
    if not field.is_number:
        return np.array(values, dtype=np.bytes_)
    if field.is_variable:
        # Of messages with fewer numbers than others the rest is 0.
        width = max(map(len, values), default=0)
        values = [own + (0,) * (width - len(own)) for own in values]
        return np.array(values, dtype=field.dtype.base).reshape(len(values), width)
    return np.array(values, dtype=field.dtype.base).reshape(-1, *field.dtype.shape)


def _steps(types: Types, fields: Collection[Field | Repeated], wanted: Collection[str]) -> Iterator[_Step]:
    """How the fields of a message, or of an item, are read one after the other."""
    run: list[Field] = []
    for field in fields:
        if isinstance(field, Field) and not field.is_variable:
            run.append(field)
            continue
        if run:
            yield _numbers(run, wanted)
            run = []
        if isinstance(field, Repeated) and field.type_name in types:
            items = list(flat_fields(types, field.type_name, f"{field.name}."))
            yield _array(field.name, field.count, _in_order(list(_steps(types, items, wanted))), wanted)
        elif isinstance(field, Repeated) or field.format == "strings":
            yield _array(field.name, ANY if isinstance(field, Field) else field.count, _text("", ()), wanted)
        elif field.format == "string":
            yield _text(field.name, wanted)
        else:
            yield _sequence(field, wanted)
    if run:
        yield _numbers(run, wanted)


def _in_order(steps: list[_Step]) -> _Step:
    def read(message: bytes, position: int, found: dict[str, list[Any]]) -> int:
        for step in steps:
            position = step(message, position, found)
        return position

    return read if len(steps) != 1 else steps[0]


def _numbers(fields: list[Field], wanted: Collection[str]) -> _Step:
    taken: list[tuple[str, int | slice]] = []
    place = 0
    for field in fields:
        count = field.count or 1
        if field.name in wanted:
            taken.append((field.name, place if field.count is None else slice(place, place + count)))
        place += count
    # CDR aligns a number to its own size, so that gaps depend on where the first one lies.
    packed = [_struct(fields, start) for start in range(_ALIGNMENTS)]

    def read(message: bytes, position: int, found: dict[str, list[Any]]) -> int:
        here = packed[position % _ALIGNMENTS]
        values = here.unpack_from(message, ORIGIN + position)
        for name, part in taken:
            found[name].append(values[part])
        return position + here.size

    return read


def _struct(fields: list[Field], start: int) -> struct.Struct:
    """Numbers with the gaps between them, the first at a position modulo eight."""
    code, position = "<", start
    for field in fields:
        size, count = field.alignment, field.count or 1
        gap = -position % size
        code += "x" * gap + f"{count}{_CODES.get(field.dtype.base.char, field.dtype.base.char)}"
        position += gap + size * count
    return struct.Struct(code)


# Where those of `struct` in standard sizes are not numpy's.
_CODES = {"l": "q", "L": "Q"}


def _length(message: bytes, position: int) -> tuple[int, int]:
    """A length, and the position behind it."""
    position += -position % _LENGTH.size
    return _LENGTH.unpack_from(message, ORIGIN + position)[0], position + _LENGTH.size


def _text(name: str, wanted: Collection[str]) -> _Step:
    def read(message: bytes, position: int, found: dict[str, list[Any]]) -> int:
        length, position = _length(message, position)
        text = message[ORIGIN + position : ORIGIN + position + length]
        if len(text) < length:
            raise ValueError("a text that is cut off")
        if name in wanted:
            found[name].append(text[:-1].decode().encode())
        return position + length

    return read


def _sequence(field: Field, wanted: Collection[str]) -> _Step:
    """Numbers of any count."""
    size, code = field.alignment, _CODES.get(field.dtype.base.char, field.dtype.base.char)

    def read(message: bytes, position: int, found: dict[str, list[Any]]) -> int:
        count, position = _length(message, position)
        if count > ITEMS_MAX:
            raise ValueError("more items than any sender has")
        position += -position % size if count else 0
        if field.name in wanted:
            found[field.name].append(struct.unpack_from(f"<{count}{code}", message, ORIGIN + position))
        return position + count * size

    return read


def _array(name: str, fixed: int, item: _Step, wanted: Collection[str]) -> _Step:
    def read(message: bytes, position: int, found: dict[str, list[Any]]) -> int:
        count = fixed
        if fixed == ANY:
            count, position = _length(message, position)
        if count > ITEMS_MAX:
            raise ValueError("more items than any sender has")
        if name in wanted:
            found[name].append(count)
        for _ in range(count):
            position = item(message, position, found)
        return position

    return read


@cache
def foreign_codec(type_name: str, definition: str, wanted: tuple[tuple[str, int], ...]) -> ForeignCodec:
    """The codec of a type that others define.

    Args:
        type_name: such as `px4_msgs/msg/EscStatus`.
        definition: of that type and all that it contains, as a bag embeds it (`ros2msg`).
        wanted: columns to decode, by path (`timestamp`, `esc.esc_rpm` for the items of `esc`), and how many
            numbers each has; 0 for text, and ANY for a sequence of numbers.

    Raises:
        LogError: for a definition that cannot be used, or lacks a wanted column.
    """
    try:
        types = {**standard_types(), **parse_definition(type_name, definition)}
        if (count := _count(types, type_name, {})) > _FIELDS_MAX:
            raise ValueError(f"it has {count} fields")
        return ForeignCodec(type_name, types, dict(wanted))
    except (ValueError, KeyError, RecursionError, struct.error) as error:
        reason = one_line(error)[:_REASON_LENGTH]
        raise LogError(f"the definition of {type_name} cannot be used: {reason}") from error


def _count(types: Types, type_name: str, known: dict[str, int]) -> int:
    """Fields of a type and of all that it contains; refused are arrays that no sender fills."""
    if type_name not in known:
        total = 0
        for member in types[type_name]:
            if member.type_name not in FORMATS and (member.count or 0) > ITEMS_MAX:
                raise ValueError(f"the array {member.name} has {member.count} items")
            is_message = member.type_name not in {*FORMATS, "string"}
            total += _count(types, member.type_name, known) if is_message else 1
        known[type_name] = total
    return known[type_name]
