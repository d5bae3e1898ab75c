# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Declare the parameters of a node, check what they are set to, and follow changes in flight."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, fields, replace
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from quadpi_core.errors import QuadpiError
from quadpi_core.messages.adapters import known_adapters
from quadpi_core.messages.adapters.packages.satellite_fixes import NAVSATFIX
from quadpi_core.messages.sensor_messages import BODY_FRAME, WORLD_FRAME
from quadpi_core.messages.topics import MOCAP_TOPICS
from quadpi_core.monitor import MonitorSettings
from quadpi_core.monitor.pairing import TIMEOUT_S
from quadpi_core.rotor_order import RPM
from quadpi_ros.callbacks import QOS_PREFIX

# No IMU of a quadrotor is faster.
FASTEST_IMU_HZ = 5000.0
# Time for nodes to become active, on a computer that does much else.
START_TIMEOUT_S = 120.0
# Rate of /clock unless it is given, as of `ros2 bag play`.
CLOCK_HZ = 40.0
# Values of the parameter `frames`.
WARN, STRICT = "warn", "strict"
# Values of the bridge's parameters `rotor_order` and `imu_source` that leave the choice to quadpi.
STANDARD_ORDER, AUTOMATIC = "standard", "auto"
# `quadpi_core.logs.mavlink_samples.SOURCES["imu"]`: live nodes do without the readers of logs.
MAVLINK_IMU_MESSAGES = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3")

_SETTINGS = MonitorSettings()
_VEHICLE = "vehicle file: a name in config/vehicles or a path"
_BODY_FRAME = "frame_id of the body, forward-left-up; empty: base_link behind the namespace"
_ASKED = "asked of the autopilot; 0: do not ask"


@dataclass(frozen=True)
class Declaration:
    """What a parameter may be and what its ROS descriptor says.

    Attributes:
        description: shown by `ros2 param describe`.
        limits: smallest and largest value of a number.
        choices: the strings allowed.
        adapters: kind of stream whose adapters are further choices.
        in_flight: whether it can be set while the node runs; else it is read-only.
        optional: whether it may be empty.
        empty_means: the value that an empty string stands for, on a node.
    """

    description: str
    limits: tuple[float, float] | None = None
    choices: tuple[str, ...] = ()
    adapters: str = ""
    in_flight: bool = False
    optional: bool = False
    empty_means: Callable[[Node], str] | None = None

    def allowed(self) -> tuple[str, ...]:
        """The strings allowed, adapters included; empty for any."""
        return self.choices + adapters_of(self.adapters)


def parameter(default: str | float | bool | tuple[str, ...], description: str, **rules: Any) -> Any:
    """A field of a parameter dataclass.

    Args:
        default: also fixes the type; the empty string or tuple makes the parameter required, unless it is
            optional. A tuple takes one string, or an array of them.
        description: see :class:`Declaration`.
        rules: see there.
    """
    return field(default=default, metadata={"declaration": Declaration(description, **rules)})


def namespaced_body_frame(node: Node) -> str:
    """The body's default frame: `base_link` behind the namespace of a node, as each vehicle has its own."""
    return f"{node.get_namespace()}/{BODY_FRAME}".lstrip("/")


def adapters_of(kind: str) -> tuple[str, ...]:
    """Names of the adapters that give a kind of stream."""
    return tuple(name for name, adapter in known_adapters().items() if adapter.kind == kind)


@dataclass(frozen=True)
class LiveParameters:
    """Parameters that estimator and monitor share."""

    vehicle: str = parameter("", _VEHICLE)
    imu_rate_hz: float = parameter(
        0.0,
        "nominal rate of the topic imu; 0: as its stamps tell in the first second",
        limits=(0.0, FASTEST_IMU_HZ),
    )
    adapters: str = parameter(
        "",
        "how messages of other packages are read: a name in config/adapters or a path",
        optional=True,
    )
    body_frame: str = parameter("", _BODY_FRAME, empty_means=namespaced_body_frame)
    frames: str = parameter(
        WARN,
        "an IMU in a frame without a static transform: `warn` takes it as the body's, `strict` refuses it",
        choices=(WARN, STRICT),
    )
    autostart: bool = parameter(True, "configure and activate at the start; else by lifecycle services")


@dataclass(frozen=True)
class EstimatorParameters(LiveParameters):
    """Parameters of the node `estimator`."""

    mocap_topic: str = parameter(
        "mocap/pose",
        "topic and type of the motion capture to use",
        choices=(*MOCAP_TOPICS, NAVSATFIX.name),
        adapters="mocap",
    )
    world_frame: str = parameter(WORLD_FRAME, "frame_id of odometry: the world, east-north-up")
    tf_rate_hz: float = parameter(
        0.0,
        "rate of the transform from world_frame to body_frame on /tf; 0: none",
        limits=(0.0, FASTEST_IMU_HZ),
    )


@dataclass(frozen=True)
class MonitorParameters(LiveParameters):
    """Parameters of the node `monitor`."""

    model: tuple[str, ...] = parameter(
        (), "model folder, as `quadpi identify` writes it; of several, the first gives the alarm"
    )
    model_folder: str = parameter(
        "",
        "folder below which the service load_model takes models; empty: those that hold the models above",
        optional=True,
    )
    rotor_topic: str = parameter(
        "rotor_speeds",
        "topic and type of the rotor speeds to use",
        choices=("rotor_speeds", "erpm"),
        adapters="rotor_speeds",
    )
    command_topic: str = parameter(
        "",
        "motor commands, for models that were identified on them; empty: as the model was",
        choices=("",),
        adapters="motor_commands",
        optional=True,
    )
    air_topic: str = parameter(
        "fluid_pressure",
        "adapter of the pressure of the air; with a topic temperature, or its own, it tells the density",
        choices=("fluid_pressure",),
        adapters="pressure",
    )
    fallback_model: str = parameter(
        "",
        "model identified on motor commands, in the place of a single one while rotor speeds are silent",
        optional=True,
    )
    confidence: float = parameter(
        0.0, "nominal coverage of the intervals; 0 takes the model's own", limits=(0.0, 0.9999)
    )
    persistence_s: float = parameter(
        _SETTINGS.persistence_s,
        "evidence that raises an alarm, in seconds",
        limits=(0.001, 60.0),
        in_flight=True,
    )
    release_s: float = parameter(
        _SETTINGS.release_s,
        "absence of evidence that clears an alarm, in seconds",
        limits=(0.001, 60.0),
        in_flight=True,
    )
    alarm_rate_hz: float = parameter(
        _SETTINGS.alarm_rate_hz,
        "rate of extrapolation_alarm between changes",
        limits=(0.1, 1000.0),
        in_flight=True,
    )
    adaptive: bool = parameter(
        _SETTINGS.adaptive, "intervals that adapt to the measured wrench, instead of the model's own"
    )
    change: bool = parameter(_SETTINGS.change, "judge CHANGE: whether the vehicle has changed")
    pairing_timeout_s: float = parameter(
        TIMEOUT_S, "how long an IMU sample waits for its state and rotor speeds", limits=(0.005, 1.0)
    )
    publish_wrenches: bool = parameter(
        False, "publish wrench/predicted, wrench/measured and wrench/residual as geometry_msgs/WrenchStamped"
    )


@dataclass(frozen=True)
class BridgeParameters:
    """Parameters of the node `mavlink_bridge`."""

    connection: str = parameter(
        "", "udp:HOST:PORT (listens), udpout:…, tcp:…, serial:DEVICE:BAUD, or a .tlog file"
    )
    vehicle: str = parameter("", _VEHICLE)
    rotor_order: str = parameter(
        STANDARD_ORDER, "speed controllers, from 1 on, in the vehicle's rotor order, such as `4 1 2 3`"
    )
    rotor_unit: str = parameter(RPM, "what the rpm of the messages is", choices=("rpm", "erpm"))
    imu_source: str = parameter(AUTOMATIC, "IMU message to use", choices=(AUTOMATIC, *MAVLINK_IMU_MESSAGES))
    system: int = parameter(
        0, "system id of the autopilot; 0: the first that sends an autopilot's heartbeat", limits=(0, 255)
    )
    imu_rate_hz: float = parameter(250.0, _ASKED, limits=(0.0, 4000.0))
    rotor_rate_hz: float = parameter(250.0, _ASKED, limits=(0.0, 4000.0))
    state_rate_hz: float = parameter(100.0, _ASKED, limits=(0.0, 1000.0))
    passive: bool = parameter(False, "send nothing: no heartbeat, no requests, no clock exchange")
    key_file: str = parameter(
        "", "file with the passphrase of signed packets; with one, others are refused", optional=True
    )
    body_frame: str = parameter("", _BODY_FRAME, empty_means=namespaced_body_frame)
    world_frame: str = parameter(WORLD_FRAME, "frame_id of the world, east-north-up")


@dataclass(frozen=True)
class MarkerParameters:
    """Parameters of the node `markers`."""

    rate_hz: float = parameter(15.0, "rate of the markers", limits=(1.0, 20.0))
    m_per_n: float = parameter(0.05, "length of the arrows of forces [m/N]", limits=(1e-4, 100.0))
    m_per_nm: float = parameter(1.0, "length of the arrows of moments [m/Nm]", limits=(1e-3, 1000.0))


ALL_NAMES = {
    item.name
    for parameters in (EstimatorParameters, MonitorParameters, BridgeParameters, MarkerParameters)
    for item in fields(parameters)
}
"""Names of the parameters of all nodes: one file may hold them all, under `/**`."""


# Declared by rclpy.
_RCLPY_PARAMETERS = {"use_sim_time", "start_type_description_service"}
_ROS_NAMES = {str: "string", float: "double", int: "integer", bool: "bool"}
_ROS_NAMES[tuple] = "string or an array of strings"
Parameters = TypeVar("Parameters")


class ParameterError(QuadpiError):
    """A node parameter is unknown, missing, of the wrong type or out of range."""


class ParameterServer(Generic[Parameters]):
    """Declares every field of a dataclass as a parameter of a node, and holds the current values.

    An integer is accepted for a double, at the start and in flight. Parameters of quadpi's other nodes are
    ignored, as one file may hold the parameters of all nodes under `/**`.

    Args:
        node: created with `automatically_declare_parameters_from_overrides`.
        parameters: dataclass made of :func:`quadpi_ros.parameters.parameter` fields.
        changed: called after a change in flight.

    Raises:
        ParameterError: for an unknown name, a missing, mistyped or out-of-range value.
    """

    def __init__(
        self,
        node: Node,
        parameters: type[Parameters],
        changed: Callable[[], None] = lambda: None,
    ) -> None:
        self._fields: dict[str, Field[Any]] = {item.name: item for item in fields(parameters)}  # type: ignore[arg-type]
        self._where = f"node {node.get_name()}"
        self._changed = changed
        # rclpy annotates values, but returns parameters.
        overrides: Mapping[str, Any] = node.get_parameters_by_prefix("")
        given = {name: override.value for name, override in overrides.items()}
        for name in _RCLPY_PARAMETERS & given.keys():
            # rclpy would ignore a value of the wrong type.
            _coerced(f"{self._where}: parameter `{name}`", bool, given[name])
        self._pass_over(node, given.keys() - self._fields.keys() - _RCLPY_PARAMETERS)
        self.values = parameters(**{name: self._declare(node, name, given) for name in self._fields})
        node.add_pre_set_parameters_callback(self._coerce)
        node.add_post_set_parameters_callback(self._take)

    def _pass_over(self, node: Node, names: set[str]) -> None:
        """Refuse parameters that no node has, and undeclare those that only other nodes have."""
        for name in sorted(names):
            if name.startswith(QOS_PREFIX):
                kind = node.get_parameter(name).type_.value
                node.set_descriptor(name, ParameterDescriptor(type=kind, read_only=True))
            elif name in ALL_NAMES:
                node.undeclare_parameter(name)
            else:
                raise ParameterError(
                    f"{self._where}: unknown parameter `{name}`; known: {', '.join(sorted(self._fields))}"
                )

    def _declare(self, node: Node, name: str, given: dict[str, Any]) -> Any:
        declaration: Declaration = self._fields[name].metadata["declaration"]
        value = self._fields[name].default
        if name in given:
            value = self._checked(name, given[name])
            node.undeclare_parameter(name)
        if value == "" and declaration.empty_means is not None:
            value = declaration.empty_means(node)
        if value in ("", ()) and not declaration.optional:
            raise ParameterError(f"{self._where}: parameter `{name}` is required: {declaration.description}")
        ros_value = list(value) if isinstance(value, tuple) else value
        node.declare_parameter(name, ros_value, _descriptor(declaration, type(value)), ignore_override=True)
        return value

    def _checked(self, name: str, value: Any) -> Any:
        """The value in the type of the dataclass field.

        Raises:
            ParameterError: if it is of the wrong type or out of range.
        """
        declaration: Declaration = self._fields[name].metadata["declaration"]
        where = f"{self._where}: parameter `{name}`"
        value = _coerced(where, type(self._fields[name].default), value)
        if (allowed := declaration.allowed()) and value not in allowed:
            raise ParameterError(f"{where} must be one of {', '.join(allowed)}, found `{value}`")
        if declaration.limits is not None:
            low, high = declaration.limits
            if not low <= value <= high:
                raise ParameterError(f"{where} must lie between {low:g} and {high:g}, found {value:g}")
        return value

    def _coerce(self, given: list[Parameter]) -> list[Parameter]:
        doubles = {name for name, item in self._fields.items() if isinstance(item.default, float)}
        return [
            Parameter(item.name, value=float(item.value))
            if item.name in doubles and type(item.value) is int
            else item
            for item in given
        ]

    def _take(self, given: list[Parameter]) -> None:
        changes = {item.name: item.value for item in given if item.name in self._fields}
        if changes:
            self.values = replace(self.values, **changes)  # type: ignore[type-var]
            self._changed()


def read_parameters(node: Node, parameters: type[Parameters]) -> Parameters:
    """Declare the parameters of a node that cannot change in flight, and return their values.

    See :class:`ParameterServer`.
    """
    return ParameterServer(node, parameters).values


def _coerced(where: str, kind: type, value: Any) -> Any:
    if kind is float and type(value) is int:
        return float(value)
    if kind is int and type(value) is float and value.is_integer():
        return int(value)
    if kind is tuple and isinstance(value, str):
        return (value,) if value else ()
    if kind is tuple and isinstance(value, list | tuple) and all(isinstance(item, str) for item in value):
        return tuple(value)
    if kind is tuple or type(value) is not kind:
        raise ParameterError(f"{where} must be a {_ROS_NAMES[kind]}, found {value!r}")
    return value


def _descriptor(declaration: Declaration, kind: type) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(description=declaration.description, read_only=not declaration.in_flight)
    if allowed := declaration.allowed():
        descriptor.additional_constraints = f"one of {', '.join(allowed)}"
    if declaration.limits is not None:
        low, high = declaration.limits
        if kind is int:
            descriptor.integer_range = [IntegerRange(from_value=int(low), to_value=int(high), step=1)]
        else:
            descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    return descriptor
