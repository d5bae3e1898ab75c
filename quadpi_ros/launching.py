# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Shared parts of the launch files: arguments, live nodes, and the handling of programs that end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from quadpi_core.errors import QuadpiError
from quadpi_core.messages.topics import LIVE_SENSORS as SENSORS
from quadpi_core.messages.topics import SENSOR_KINDS
from quadpi_core.paths import config_directory
from quadpi_core.view.view_server import ADDRESS, PORT
from quadpi_ros.mavlink_link import is_replay
from quadpi_ros.player import CLOCK_HZ, START_TIMEOUT_S
from quadpi_ros.playlist import live_inputs

OUTPUTS = (
    *("odometry", "prediction", "extrapolation_alarm", "alarm_log"),
    *("wrench/predicted", "wrench/measured", "wrench/residual"),
)

# Arguments that are node parameters of the same name. Each live node gets them all and ignores those of the
# other.
PARAMETERS = (
    *("vehicle", "model", "rotor_topic", "mocap_topic", "imu_rate_hz", "adapters"),
    *("body_frame", "world_frame", "frames", "tf_rate_hz", "publish_wrenches", "autostart", "use_sim_time"),
)

# Parameters that choose one of several topics, by the kind of stream.
_PARAMETERS_OF_KINDS = MappingProxyType({"rotor_topic": "rotor_speeds", "mocap_topic": "mocap"})
# Arguments that `ros2 launch` adds for its own options.
_OF_ROS2_LAUNCH = {"launch-prefix", "launch-prefix-filter"}
# Exit status of a program after an error that the user must correct: starting it again would fail again.
_REFUSED = 2
_RESPAWN_DELAY_S = 1.0


class LaunchError(RuntimeError):
    """A launch file fails: `ros2 launch` logs the message, ends all its programs, and returns 1."""


@dataclass(frozen=True)
class Argument:
    """A launch argument: required without a default, left to the parameter file with an empty one."""

    name: str
    description: str
    default: str | None = None


def argument_of(topic: str) -> str:
    """Launch argument that renames a topic."""
    return f"{topic.replace('/', '_')}_topic"


def common_arguments(parameter_file: str, respawn: bool) -> tuple[Argument, ...]:
    """Arguments of every launch file.

    Args:
        parameter_file: name of the default one in config/nodes.
        respawn: whether programs that end are started again by default.
    """
    defaults = config_directory() / "nodes" / parameter_file
    return (
        Argument("vehicle", "vehicle file: a name in config/vehicles or a path"),
        Argument("parameters", "parameter file", str(defaults)),
        Argument("namespace", "namespace of nodes and topics", ""),
        Argument("respawn", "start a program that ends again", str(respawn).lower()),
    )


def monitor_arguments(respawn: bool) -> tuple[Argument, ...]:
    """Arguments of a launch file that starts the live nodes."""
    of_the_file = "; default: that of the parameter file"
    return (
        *common_arguments("monitor.yaml", respawn),
        Argument("model", "model folder, or several as [first, second]"),
        Argument("separate", "one process per node", "false"),
        Argument("autostart", "configure and activate", "true"),
        Argument("use_sim_time", "clock from /clock", "false"),
        Argument("rotor_topic", f"rotor speeds to use, such as erpm{of_the_file}", ""),
        Argument("mocap_topic", f"motion capture to use, such as mocap/odometry{of_the_file}", ""),
        Argument("imu_rate_hz", f"rate of the topic imu{of_the_file}", ""),
        Argument("adapters", f"how messages of other packages are read{of_the_file}", ""),
        Argument("body_frame", f"frame_id of the body{of_the_file}", ""),
        Argument("world_frame", f"frame_id of the world{of_the_file}", ""),
        Argument("tf_rate_hz", f"rate of the estimate on /tf; 0: none{of_the_file}", ""),
        Argument("publish_wrenches", f"predictions also as geometry_msgs/WrenchStamped{of_the_file}", ""),
        Argument("markers", "arrows of the wrench and words of the alarm, for RViz and Foxglove", "false"),
        Argument("view", "page in a browser: can the model be trusted now, and why not", "false"),
        Argument("view_port", "port of the page", str(PORT)),
        Argument("view_bind", "address of the page; another than loopback lets the network in", ADDRESS),
        Argument("frames", f"strict: refuse an IMU in a frame that no transform places{of_the_file}", ""),
        *(Argument(argument_of(topic), f"name of the topic {topic}", topic) for topic in SENSORS + OUTPUTS),
    )


@dataclass(frozen=True)
class Launch:
    """A launch file being executed.

    Attributes:
        values: of all its arguments.
        direct: whether the user launched this file, not one that includes it, so that it may end the launch.
    """

    values: Mapping[str, str]
    direct: bool

    def switch(self, name: str) -> bool:
        """Value of a boolean argument.

        Raises:
            LaunchError: if it is not true or false.
        """
        value = self.values[name]
        if value.lower() not in {"true", "false", "1", "0"}:
            raise LaunchError(f"launch argument `{name}` must be true or false, found `{value}`")
        return value.lower() in {"true", "1"}

    def given(self, names: Iterable[str]) -> dict[str, Any]:
        """Parameters from those of the named arguments that have a value."""
        return {name: self._parameter(name) for name in names if self.values[name]}

    def _parameter(self, name: str) -> Any:
        value = self.values[name]
        if name in {"autostart", "use_sim_time", "publish_wrenches"}:
            return self.switch(name)
        if name in {"imu_rate_hz", "tf_rate_hz"}:
            try:
                return float(value)
            except ValueError:
                raise LaunchError(f"launch argument `{name}` must be a number, found `{value}`") from None
        if name == "model" and value.startswith("["):
            return [str(folder) for folder in yaml.safe_load(value)]
        return ParameterValue(value, value_type=str)

    def program(
        self, executable: str, parameters: Mapping[str, Any], topics: Sequence[str] = ()
    ) -> list[Any]:
        """Actions that run a node of quadpi and, with the argument `respawn`, start it again.

        Args:
            executable: in lib/quadpi.
            parameters: in addition to those of the parameter file.
            topics: that arguments rename.

        Raises:
            LaunchError: if the parameter file is missing, which launch would ignore.
        """
        again = self.switch("respawn")
        if not Path(self.values["parameters"]).is_file():
            raise LaunchError(f"launch argument `parameters`: there is no file `{self.values['parameters']}`")
        node = Node(
            package="quadpi",
            executable=executable,
            namespace=self.values["namespace"],
            parameters=[self.values["parameters"], dict(parameters)],
            remappings=self.remappings(topics),
            output="screen",
            respawn=again,
            respawn_delay=_RESPAWN_DELAY_S,
        )
        return [node, self.when_ended(node, executable, again)]

    def remappings(self, topics: Iterable[str]) -> list[tuple[str, str]]:
        """New names of topics, from their arguments."""
        return [(topic, self.values[argument_of(topic)]) for topic in topics]

    def when_ended(
        self, node: Node, executable: str, again: bool, then: Callable[[], list[Any]] = list
    ) -> RegisterEventHandler:
        """Handler of a program's end: an error if it failed and is not started again, else actions of `then`.

        A program that ends for an error that the user must correct is an error in any case.
        """

        def ended(event: Any, context: LaunchContext) -> list[Any]:
            failed = event.returncode != 0 and not context.is_shutdown
            if failed and self.direct and (not again or event.returncode == _REFUSED):
                raise LaunchError(f"{executable} has ended with exit status {event.returncode}")
            return then()

        return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=ended))


def live_nodes(launch: Launch, chosen: Mapping[str, str] = MappingProxyType({})) -> list[Any]:
    """Actions that run estimator and monitor, in one process or each in its own.

    Args:
        launch: with :func:`monitor_arguments`.
        chosen: defaults for empty arguments.
    """
    instead = {name: value for name, value in chosen.items() if not launch.values[name]}
    whole = replace(launch, values=_with_sources({**launch.values, **instead}))
    programs = ("estimator_node", "monitor_node") if launch.switch("separate") else ("live",)
    actions = [
        action
        for program in programs
        for action in whole.program(program, whole.given(PARAMETERS), SENSORS + OUTPUTS)
    ]
    if launch.switch("markers"):
        actions += whole.program("markers", {}, OUTPUTS)
    return actions + (page(launch) if launch.switch("view") else [])


def _with_sources(values: Mapping[str, str]) -> dict[str, str]:
    """Values of arguments in which a topic that has been given a name is the one that is listened to.

    Raises:
        LaunchError: for a topic with a name of its own that is not listened to.
    """
    sources = dict(values)
    for parameter, kind in _PARAMETERS_OF_KINDS.items():
        words = [word for word in SENSORS if SENSOR_KINDS[word] == kind]
        named = [word for word in words if values[argument_of(word)] != word]
        used = sources[parameter] = values[parameter] or next(iter(named), "")
        if unused := next((word for word in named if word != used), None):
            raise LaunchError(
                f"launch argument `{argument_of(unused)}` is given but not used: {parameter} is {used}"
            )
    return sources


def page(launch: Launch) -> list[Any]:
    """Actions that run the page of the live nodes. Its end ends nothing else: what flies does not need it."""
    model = launch.values["model"]
    folders = yaml.safe_load(model) if model.startswith("[") else [model]
    node = Node(
        package="quadpi",
        executable="view",
        namespace=launch.values["namespace"],
        arguments=[
            *("--port", launch.values["view_port"], "--bind", launch.values["view_bind"]),
            *("--vehicle", launch.values["vehicle"]),
            *(part for folder in folders for part in ("--model", str(folder))),
        ],
        remappings=[],
        output="screen",
    )

    def ended(event: Any, context: LaunchContext) -> list[Any]:
        """Start it again where a signal killed it; what it says itself before it ends, it would say again."""
        return page(launch) if event.returncode < 0 and not context.is_shutdown else []

    return [node, RegisterEventHandler(OnProcessExit(target_action=node, on_exit=ended))]


def description(
    file: str, arguments: Sequence[Argument], start: Callable[[Launch], list[Any]]
) -> LaunchDescription:
    """Description of a launch file that refuses unknown arguments.

    Args:
        file: path of the launch file.
        arguments: known ones.
        start: returns the actions; may raise :class:`LaunchError`.
    """

    def execute(context: LaunchContext) -> list[Any]:
        direct = _asked_for(Path(file))
        if direct:
            _refuse_unknown(Path(file).name, context.argv, [argument.name for argument in arguments])
        values = {argument.name: context.launch_configurations[argument.name] for argument in arguments}
        return start(Launch(values, direct))

    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(one.name, default_value=one.default, description=one.description)
                for one in arguments
            ),
            OpaqueFunction(function=execute),
        ]
    )


def _asked_for(file: Path) -> bool:
    """Whether the command line names this file, by package or path, and not one that includes it."""
    return any(
        Path(name).name == file.name
        and (package == "quadpi" or (Path(name).is_file() and Path(name).samefile(file)))
        for package, name in pairwise(("", *sys.argv))
    )


def _refuse_unknown(file: str, given: Sequence[str], known: Sequence[str]) -> None:
    """Refuse unknown `name:=value` of the command line, which launch would ignore.

    Raises:
        LaunchError: naming it.
    """
    names = [argument.partition(":=")[0] for argument in given]
    unknown = [name for name in names if name not in known and name not in _OF_ROS2_LAUNCH]
    if unknown:
        raise LaunchError(
            f"{file}: unknown launch argument `{unknown[0]}`; known: {', '.join(sorted(known))}"
        )


def bridge(launch: Launch) -> list[Any]:
    """Actions that run the MAVLink bridge; one that plays a log is not started again at its end."""
    replayed = is_replay(launch.values["connection"])
    respawn = launch.switch("respawn") and not replayed
    whole = replace(launch, values={**launch.values, "respawn": str(respawn)})
    return whole.program("mavlink_bridge", whole.given(("connection", "vehicle")))


def replay(launch: Launch) -> list[Any]:
    """Actions that run the live nodes and a player, and end all after the bag; topics follow from the bag.

    Raises:
        LaunchError: if the bag cannot be played.
    """
    bag = Path(launch.values["bag"])
    try:
        inputs = live_inputs(bag, launch.values["topics"].split())
    except QuadpiError as error:
        raise LaunchError(str(error)) from error
    clock_hz = launch.values["clock"] or (str(CLOCK_HZ) if launch.switch("use_sim_time") else "")
    player = Node(
        package="quadpi",
        executable="player",
        namespace=launch.values["namespace"],
        arguments=[
            *(str(bag), "--rate", launch.values["rate"], "--topics", *inputs.topics),
            *("--start-offset", launch.values["start_offset"]),
            *(f"--{name.replace('_', '-')}" for name in ("loop", "start_paused") if launch.switch(name)),
            *(("--clock", clock_hz) if clock_hz else ()),
            *("--nodes", "estimator", "monitor", "--wait", str(START_TIMEOUT_S)),
        ],
        remappings=launch.remappings(SENSORS),
        output="screen",
    )
    end = partial(list[Any], [EmitEvent(event=Shutdown(reason="bag played"))])
    chosen = {"rotor_topic": inputs.rotor_topic, "mocap_topic": inputs.mocap_topic}
    return [*live_nodes(launch, chosen), player, launch.when_ended(player, "player", again=False, then=end)]
