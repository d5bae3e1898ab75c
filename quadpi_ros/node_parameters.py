# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The parameters of every node, as frozen dataclasses: name, default, description and limits of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Any

from rclpy.node import Node

from quadpi_core.messages.adapters import known_adapters
from quadpi_core.messages.sensor_messages import BODY_FRAME, WORLD_FRAME
from quadpi_core.messages.topics import MOCAP_TOPICS
from quadpi_core.monitor import MonitorSettings
from quadpi_core.monitor.pairing import TIMEOUT_S
from quadpi_core.rotor_order import RPM

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
        choices=MOCAP_TOPICS,
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
