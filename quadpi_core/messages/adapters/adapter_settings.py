# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Settings for messages of other packages: units, frames, rotors and bodies, which the messages do not name.

docs/adapters.md explains the keys; config/adapters holds examples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

from quadpi_core.config_schema import OneOf, ReadBy, Section, Text, load_config, unknown_key
from quadpi_core.errors import LogError
from quadpi_core.messages.topics import SENSOR_KINDS
from quadpi_core.rotor_order import ERPM, LAYOUTS, RPM, RotorOrder, controller_numbers
from quadpi_core.vehicle import Vehicle

FLU_ENU, FRD_NED, FUR_EUS = "flu-enu", "frd-ned", "fur-eus"
# What to write into a mapping file, for errors; what is not here says all of itself.
EXAMPLES = MappingProxyType(
    {
        "rotor_speeds": "rotor_speeds: {rotors: [1, 2, 3, 4], unit: rpm}",
        "mocap": f"mocap: {{body: NAME, frames: {FLU_ENU}}}",
    }
)


def _read_rotors(data: Any) -> tuple[int, ...] | str:
    if isinstance(data, str) and data in LAYOUTS:
        return data
    if not isinstance(data, list):
        raise ValueError(f"must list numbers of ESCs or motors, or be {' or '.join(LAYOUTS)}, found {data!r}")
    return controller_numbers(data)


class _StreamSettings(Section):
    """Settings for one kind of stream; a topic alone may be of the standard type, which needs no more."""

    needed: ClassVar[tuple[str, ...]] = ()
    topic: str | None

    def __post_init__(self) -> None:
        if self.topic is None:
            self.require()

    def require(self) -> None:
        """Refuse settings that are not enough for messages of another package, naming the missing key."""
        for key in self.needed:
            if getattr(self, key) is None:
                raise ValueError(f"missing key `{key}`")


@dataclass(frozen=True)
class RotorSettings(_StreamSettings):
    """Conversion of ESC reports to rotor speeds.

    Attributes:
        rotors: for each rotor of the vehicle file, the number from 1 of the ESC (mavros) or motor (PX4); or
            the name of a layout (`rotor_order.LAYOUTS`), which the vehicle's rotors fit by their corners.
        unit: "rpm" of the rotor, or "erpm" of the electrical field: the vehicle's pole pairs are needed.
        topic: which, where a bag holds several that could be meant.
    """

    needed = ("rotors", "unit")

    rotors: Annotated[tuple[int, ...] | str | None, ReadBy(_read_rotors)] = None
    unit: Annotated[str, OneOf(RPM, ERPM)] | None = None
    topic: Text | None = None

    def order(self, vehicle: Vehicle | None) -> RotorOrder:
        """The order that the settings give.

        Raises:
            LogError: if they give none, one of another number of rotors, or not without a vehicle.
        """
        assert self.rotors is not None
        assert self.unit is not None
        if not isinstance(self.rotors, str):
            return RotorOrder(tuple(number - 1 for number in self.rotors), self.unit).of(vehicle)
        if vehicle is None:
            raise LogError(
                f"the layout {self.rotors} needs the vehicle, whose file says where its rotors are"
            )
        return RotorOrder.by_layout(vehicle, self.rotors, self.unit)


@dataclass(frozen=True)
class CommandSettings(_StreamSettings):
    """Which outputs are the motors'.

    Attributes:
        rotors: for each rotor of the vehicle file, the number from 1 of its motor, output or value; or the
            name of a layout (`rotor_order.LAYOUTS`).
        topic: see :class:`RotorSettings`.
    """

    rotors: Annotated[tuple[int, ...] | str | None, ReadBy(_read_rotors)] = None
    topic: Text | None = None

    def order(self, vehicle: Vehicle | None, layout: str = "") -> RotorOrder:
        """The order that the settings give, else that of a layout, or of the usual frame.

        Raises:
            LogError: for a vehicle that a layout does not fit, or that has not as many rotors.
        """
        if not isinstance(self.rotors, tuple):
            return RotorOrder.by_layout(vehicle, self.rotors or layout)
        return RotorOrder(tuple(number - 1 for number in self.rotors)).of(vehicle)


def _read_body(data: Any) -> str:
    if isinstance(data, bool) or not isinstance(data, str | int) or data == "":
        raise ValueError(f"must be the name of a body, found {data!r}")
    return str(data)


@dataclass(frozen=True)
class BodySettings(_StreamSettings):
    """The body of a motion capture system to use, and its axes.

    Attributes:
        body: its name.
        frames: body and world axes: "flu-enu" (z up), "frd-ned" (z down) or "fur-eus" (y up in both).
        topic: see :class:`RotorSettings`.
    """

    needed = ("body", "frames")

    body: Annotated[str | None, ReadBy(_read_body)] = None
    frames: Annotated[str, OneOf(FLU_ENU, FRD_NED, FUR_EUS)] | None = None
    topic: Text | None = None


@dataclass(frozen=True)
class StateSettings(_StreamSettings):
    """For messages that name their frames and units themselves."""

    topic: Text | None = None


def _read_topics(data: Any) -> dict[str, str]:
    if not isinstance(data, Mapping):
        raise ValueError(f"must name topics, as in {{imu: /uav1/imu}}, found {data!r}")
    for name, topic in data.items():
        if name not in SENSOR_KINDS:
            raise ValueError(unknown_key(name, SENSOR_KINDS))
        if not isinstance(topic, str) or not topic.strip("/"):
            raise ValueError(f"{name}: must be the name of a topic, found {topic!r}")
    return dict(data)


def _present(data: Any) -> Any:
    """Refuse a key without a value, which may be meant as a stream with no settings or as none."""
    if data is None:
        raise ValueError("expected keys and values, such as {}, found nothing")
    return data


@dataclass(frozen=True)
class AdapterSettings(Section):
    """Which topics of a bag are read, and how.

    Attributes:
        rotor_speeds, mocap, odometry, imu: settings for messages of other packages; None: not used for it.
        motor_commands, battery, pressure, temperature: the same; None: what is there is used, without being
            named.
        topics: the topics to read, by standard names; the child frame to follow stands behind a topic of
            tf2_msgs/TFMessage, as in `/tf:quad`.
        namespace: only topics with these levels in their names are looked for.
    """

    blank_is_absent: ClassVar[bool] = False

    rotor_speeds: Annotated[RotorSettings | None, ReadBy(_present, first=True)] = None
    mocap: Annotated[BodySettings | None, ReadBy(_present, first=True)] = None
    odometry: Annotated[StateSettings | None, ReadBy(_present, first=True)] = None
    imu: Annotated[StateSettings | None, ReadBy(_present, first=True)] = None
    motor_commands: Annotated[CommandSettings | None, ReadBy(_present, first=True)] = None
    battery: Annotated[StateSettings | None, ReadBy(_present, first=True)] = None
    pressure: Annotated[StateSettings | None, ReadBy(_present, first=True)] = None
    temperature: Annotated[StateSettings | None, ReadBy(_present, first=True)] = None
    topics: Annotated[Mapping[str, str], ReadBy(_read_topics)] = field(default_factory=dict)
    namespace: str = ""

    @classmethod
    def load(cls, name_or_path: str | Path) -> AdapterSettings:
        """Read settings by the name of a file in config/adapters, or by path.

        Raises:
            LogError: naming the file and the key that is missing, unknown or has a value that is not known.
        """
        return load_config("adapter", name_or_path, cls, LogError)[1]


def with_topics(
    settings: AdapterSettings | None, topics: Mapping[str, str], namespace: str
) -> AdapterSettings:
    """The settings with topics in place of those of the same kind, and another namespace if given."""
    settings = settings or AdapterSettings()
    kinds = {SENSOR_KINDS[name] for name in topics}
    named = {name: topic for name, topic in settings.topics.items() if SENSOR_KINDS[name] not in kinds}
    return replace(settings, topics={**named, **topics}, namespace=namespace or settings.namespace)
