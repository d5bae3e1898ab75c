# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`python launch_child.py quadpi FILE.launch.py NAME:=VALUE …`: what `ros2 launch` does, without ros2cli.

With the real launch and launch_ros where they are installed. There is no wheel of them, so that elsewhere
stand-ins load the launch file, give it its arguments and start what it describes.
"""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import yaml
from ament_index_python.packages import get_package_prefix, get_package_share_directory


def launched_file(package: str, name: str) -> Path:
    return Path(get_package_share_directory(package)) / "launch" / name


def with_launch(file: Path, arguments: list[str]) -> int:
    from launch import LaunchDescription, LaunchService
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    service = LaunchService(argv=arguments)
    given = [tuple(argument.split(":=", 1)) for argument in arguments]
    include = IncludeLaunchDescription(PythonLaunchDescriptionSource(str(file)), launch_arguments=given)
    service.include_launch_description(LaunchDescription([include]))
    return int(service.run())


class StandIn(SimpleNamespace):
    """An action or event that keeps what it was made with; a single positional argument as `value`."""

    def __init__(self, *value: Any, **options: Any) -> None:
        super().__init__(value=value[0] if value else None, **options)


CLASSES = {
    "launch": ("LaunchContext", "LaunchDescription"),
    "launch.actions": (
        *("DeclareLaunchArgument", "EmitEvent", "OpaqueFunction", "RegisterEventHandler", "TimerAction"),
    ),
    "launch.event_handlers": ("OnProcessExit",),
    "launch.events": ("Shutdown",),
    "launch_ros": (),
    "launch_ros.actions": ("Node",),
    "launch_ros.parameter_descriptions": ("ParameterValue",),
}


def stand_ins() -> dict[str, ModuleType]:
    """The modules of launch and launch_ros that the launch files import."""
    modules = {name: ModuleType(name) for name in CLASSES}
    for name, classes in CLASSES.items():
        modules[name].__dict__.update({one: type(one, (StandIn,), {}) for one in classes})
    return modules


class Pretender:
    """Does what a launch service does with the actions of quadpi's launch files."""

    def __init__(self, arguments: list[str], folder: Path) -> None:
        self._folder = folder
        self._running: dict[int, tuple[Any, subprocess.Popen[bytes]]] = {}
        self._on_exit: dict[int, Any] = {}
        self.context = SimpleNamespace(
            argv=arguments,
            is_shutdown=False,
            launch_configurations=dict(argument.split(":=", 1) for argument in arguments),
        )

    def interrupt(self, *_: object) -> None:
        self.context.is_shutdown = True

    def visit(self, action: Any) -> None:
        kind = type(action).__name__
        if kind == "LaunchDescription":
            for entity in action.value:
                self.visit(entity)
        elif kind == "DeclareLaunchArgument":
            if action.default_value is None and action.value not in self.context.launch_configurations:
                raise RuntimeError(f"missing required argument '{action.value}'")
            self.context.launch_configurations.setdefault(action.value, action.default_value)
        elif kind == "OpaqueFunction":
            for entity in action.function(self.context):
                self.visit(entity)
        elif kind == "Node":
            self._start(action)
        elif kind == "RegisterEventHandler":
            self._on_exit[id(action.value.target_action)] = action.value.on_exit
        elif kind == "TimerAction":
            time.sleep(action.period)
            for entity in action.actions:
                self.visit(entity)
        elif kind == "EmitEvent":
            self.context.is_shutdown = True
        else:
            raise TypeError(kind)

    def _start(self, node: Any) -> None:
        command = [Path(get_package_prefix(node.package)) / "lib" / node.package / node.executable]
        command += [*getattr(node, "arguments", ()), "--ros-args", "-r", f"__ns:=/{node.namespace}"]
        command += node.ros_arguments
        for number, parameters in enumerate(getattr(node, "parameters", ())):
            file = parameters
            if isinstance(parameters, dict):
                values = {name: getattr(value, "value", value) for name, value in parameters.items()}
                file = self._folder / f"{node.executable}{number}.yaml"
                file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
            command += ["--params-file", file]
        for topic, other in getattr(node, "remappings", ()):
            command += ["-r", f"{topic}:={other}"]
        process = subprocess.Popen([str(part) for part in command])
        print(f"[{node.executable}-1]: process started with pid [{process.pid}]", flush=True)
        self._running[id(node)] = (node, process)

    def serve(self) -> None:
        """Until everything has ended, or is to end."""
        while self._running and not self.context.is_shutdown:
            for node, process in list(self._running.values()):
                if process.poll() is not None:
                    self._ended(node, process.returncode)
            time.sleep(0.05)

    def _ended(self, node: Any, status: int) -> None:
        del self._running[id(node)]
        for action in self._on_exit[id(node)](SimpleNamespace(returncode=status), self.context):
            self.visit(action)

    def stop(self) -> None:
        for _, process in self._running.values():
            process.send_signal(signal.SIGINT)
        for _, process in self._running.values():
            process.wait(20.0)


def without_launch(file: Path, arguments: list[str]) -> int:
    sys.modules.update(stand_ins())
    specification = importlib.util.spec_from_file_location(file.stem, file)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    with tempfile.TemporaryDirectory() as folder:
        service = Pretender(arguments, Path(folder))
        signal.signal(signal.SIGINT, service.interrupt)
        try:
            service.visit(module.generate_launch_description())
            service.serve()
        except RuntimeError as error:
            print(f"[ERROR] [launch]: Caught exception in launch: {error}", file=sys.stderr)
            return 1
        finally:
            service.stop()
    return 0


def main() -> int:
    os.environ["AMENT_PREFIX_PATH"] = os.pathsep.join(
        filter(None, (os.environ.get("AMENT_PREFIX_PATH"), sys.prefix))
    )
    package, name, *arguments = sys.argv[1:]
    real = importlib.util.find_spec("launch_ros") is not None
    return (with_launch if real else without_launch)(launched_file(package, name), arguments)


if __name__ == "__main__":
    sys.exit(main())
