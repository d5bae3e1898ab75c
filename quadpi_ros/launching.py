# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the launch files share: arguments, the live nodes, and what becomes of programs that end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from launch import LaunchContext
from launch.actions import DeclareLaunchArgument, RegisterEventHandler, TimerAction
from launch.event_handlers import OnProcessExit
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

from quadpi_core.messages.topics import LIVE_SENSORS as SENSORS
from quadpi_core.messages.topics import SENSOR_KINDS
from quadpi_core.paths import config_directory
from quadpi_core.view.view_server import ADDRESS, PORT

OUTPUTS = (
    *("odometry", "prediction", "extrapolation_alarm", "alarm_log"),
    *("wrench/predicted", "wrench/measured", "wrench/residual"),
)
SWITCH = ("true", "false", "True", "False")

# Arguments that are node parameters of the same name. Each live node gets them all and ignores those of the
# other.
PARAMETERS: dict[str, type] = {
    **dict.fromkeys(("vehicle", "model", "rotor_topic", "mocap_topic", "adapters"), str),
    **dict.fromkeys(("body_frame", "world_frame", "frames"), str),
    **dict.fromkeys(("imu_rate_hz", "tf_rate_hz"), float),
    **dict.fromkeys(("publish_wrenches", "autostart", "use_sim_time"), bool),
}
# Parameters that choose one of several topics, by the kind of stream.
_PARAMETERS_OF_KINDS = {"rotor_topic": "rotor_speeds", "mocap_topic": "mocap"}
# Exit status of a program after an error that the user must correct: starting it again would fail again.
_REFUSED = 2
_RESPAWN_DELAY_S = 1.0


class LaunchError(RuntimeError):
    """A launch file fails: `ros2 launch` logs the message, ends all its programs, and returns 1."""


def argument_of(topic: str) -> str:
    """Launch argument that renames a topic."""
    return f"{topic.replace('/', '_')}_topic"


def argument(name: str, description: str, default: str | None = None) -> DeclareLaunchArgument:
    """A launch argument: required without a default, left to the parameter file with an empty one."""
    switch = default in SWITCH or PARAMETERS.get(name) is bool
    choices = {"choices": tuple(dict.fromkeys((default, *SWITCH)))} if switch else {}
    return DeclareLaunchArgument(name, description=description, default_value=default, **choices)


def common_arguments(parameter_file: str, respawn: str) -> list[DeclareLaunchArgument]:
    """Arguments of every launch file.

    Args:
        parameter_file: name of the default one in config/nodes.
        respawn: whether programs that end are started again by default.
    """
    return [
        argument("vehicle", "vehicle file: a name in config/vehicles or a path"),
        argument("parameters", "parameter file", str(config_directory() / "nodes" / parameter_file)),
        argument("namespace", "namespace of nodes and topics", ""),
        argument("respawn", "start a program that ends again", respawn),
        argument("log_level", "least severe of what is logged, or LOGGER:=LEVEL", "info"),
    ]


def monitor_arguments(respawn: str) -> list[DeclareLaunchArgument]:
    """Arguments of a launch file that starts the live nodes."""
    of_the_file = "; default: that of the parameter file"
    return [
        *common_arguments("monitor.yaml", respawn),
        argument("model", "model folder, or several as [first, second]"),
        argument("separate", "one process per node", "false"),
        argument("autostart", "configure and activate", "true"),
        argument("use_sim_time", "clock from /clock; default: as the launch file around this one says", ""),
        argument("rotor_topic", f"rotor speeds to use, such as erpm{of_the_file}", ""),
        argument("mocap_topic", f"motion capture to use, such as mocap/odometry{of_the_file}", ""),
        argument("imu_rate_hz", f"rate of the topic imu{of_the_file}", ""),
        argument("adapters", f"how messages of other packages are read{of_the_file}", ""),
        argument("body_frame", f"frame_id of the body{of_the_file}", ""),
        argument("world_frame", f"frame_id of the world{of_the_file}", ""),
        argument("tf_rate_hz", f"rate of the estimate on /tf; 0: none{of_the_file}", ""),
        argument("publish_wrenches", f"predictions also as geometry_msgs/WrenchStamped{of_the_file}", ""),
        argument("markers", "arrows of the wrench and words of the alarm, for RViz and Foxglove", "false"),
        argument("view", "page in a browser: can the model be trusted now, and why not", "false"),
        argument("view_port", "port of the page", str(PORT)),
        argument("view_bind", "address of the page; another than loopback lets the network in", ADDRESS),
        argument("frames", f"strict: refuse an IMU in a frame that no transform places{of_the_file}", ""),
        *(argument(argument_of(topic), f"name of the topic {topic}", topic) for topic in SENSORS + OUTPUTS),
    ]


class Programs:
    """Runs programs of quadpi as the arguments of a launch file say.

    Args:
        context: of the launch.
        file: the launch file. Where the user launched it, not one that includes it, a program that fails for
            good ends the launch.

    Attributes:
        values: of the arguments; functions may change them.
    """

    def __init__(self, context: LaunchContext, file: str) -> None:
        self.values: dict[str, str] = dict(context.launch_configurations)
        # What SetParameter of a launch file around this one says of all nodes.
        of_all: Any = self.values.pop("global_params", ())
        around: dict[str, object] = dict(one for one in of_all if isinstance(one, tuple))
        if "use_sim_time" in around and not self.values.get("use_sim_time"):
            self.values["use_sim_time"] = str(around["use_sim_time"])
        self._may_end_launch = _asked_for(Path(file))

    def is_on(self, name: str) -> bool:
        """Value of a switch."""
        return self.values[name].lower() == "true"

    def remappings(self, topics: Sequence[str]) -> list[tuple[str, str]]:
        """New names of topics, from their arguments."""
        return [(topic, self.values[argument_of(topic)]) for topic in topics]

    def node(self, executable: str, parameters: Sequence[str] = (), topics: Sequence[str] = ()) -> list[Any]:
        """Actions that run a node, again with the argument `respawn` unless it refuses what it was given.

        Args:
            executable: in lib/quadpi.
            parameters: names of arguments that take the place of values of the parameter file, where given.
            topics: that arguments rename.

        Raises:
            LaunchError: if the parameter file is missing, which launch would ignore.
        """
        file, respawn = self.values["parameters"], self.is_on("respawn")
        if not Path(file).is_file():
            raise LaunchError(f"launch argument `parameters`: there is no file `{file}`")
        return self.program(
            executable,
            restarts=lambda status: respawn and status != _REFUSED,
            parameters=[file, {name: self._parameter(name) for name in parameters if self.values[name]}],
            remappings=self.remappings(topics),
        )

    def _parameter(self, name: str) -> Any:
        value, kind = self.values[name], PARAMETERS.get(name, str)
        if name == "model":
            return model_folders(value)
        if kind is bool:
            return self.is_on(name)
        if kind is float:
            try:
                return float(value)
            except ValueError:
                raise LaunchError(f"launch argument `{name}` must be a number, found `{value}`") from None
        return ParameterValue(value, value_type=str)

    def program(
        self,
        executable: str,
        restarts: Callable[[int], bool] = lambda _: False,
        then: Callable[[], list[Any]] = list,
        essential: bool = True,
        **options: Any,
    ) -> list[Any]:
        """Actions that run a program.

        Args:
            executable: in lib/quadpi.
            restarts: whether it is started again after an exit status.
            then: gives the actions after its end.
            essential: whether its failure is that of the launch.
            options: of launch_ros' Node.
        """
        node = Node(
            package="quadpi",
            executable=executable,
            namespace=self.values["namespace"],
            output="screen",
            ros_arguments=["--log-level", self.values["log_level"]],
            **options,
        )

        def ended(event: Any, context: LaunchContext) -> list[Any]:
            if context.is_shutdown:
                return []
            if restarts(event.returncode):
                again = self.program(executable, restarts, then, essential, **options)
                return [TimerAction(period=_RESPAWN_DELAY_S, actions=again)]
            if event.returncode != 0 and essential and self._may_end_launch:
                raise LaunchError(f"{executable} has ended with exit status {event.returncode}")
            return then()

        return [node, RegisterEventHandler(OnProcessExit(target_action=node, on_exit=ended))]


def model_folders(value: str) -> list[str]:
    """Folders of the argument `model`: one, or several as in `[first, second]`."""
    return [str(folder) for folder in yaml.safe_load(value)] if value.startswith("[") else [value]


def _asked_for(file: Path) -> bool:
    """Whether the command line names this file, by package or path, and not one that includes it."""
    return any(
        Path(name).name == file.name
        and (package == "quadpi" or (Path(name).is_file() and Path(name).samefile(file)))
        for package, name in pairwise(("", *sys.argv))
    )


def live_nodes(programs: Programs) -> list[Any]:
    """Actions that run estimator and monitor, in one process or each in its own, and what goes with them."""
    values = programs.values
    values |= listened_to(values)
    separate = ("estimator_node", "monitor_node") if programs.is_on("separate") else ("live",)
    actions = []
    for executable in separate:
        actions += programs.node(executable, list(PARAMETERS), SENSORS + OUTPUTS)
    if programs.is_on("markers"):
        actions += programs.node("markers", topics=OUTPUTS)
    if programs.is_on("view"):
        # What it says itself before it ends, it would say again.
        page = ("--port", values["view_port"], "--bind", values["view_bind"], "--vehicle", values["vehicle"])
        models = (part for folder in model_folders(values["model"]) for part in ("--model", folder))
        actions += programs.program(
            "view", lambda status: status < 0, essential=False, arguments=[*page, *models]
        )
    return actions


def listened_to(values: Mapping[str, str]) -> dict[str, str]:
    """Parameters that choose topics: as given, else the topic that has been given a name.

    Raises:
        LaunchError: for a topic with a name of its own that is not listened to.
    """
    chosen = {}
    for parameter, kind in _PARAMETERS_OF_KINDS.items():
        words = [word for word in SENSORS if SENSOR_KINDS[word] == kind]
        named = [word for word in words if values[argument_of(word)] != word]
        used = chosen[parameter] = values[parameter] or next(iter(named), "")
        if unused := next((word for word in named if word != used), None):
            raise LaunchError(
                f"launch argument `{argument_of(unused)}` is given but not used: {parameter} is {used}"
            )
    return chosen
