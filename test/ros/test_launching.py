# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Launch files as users start them: every line of README and docs, and what becomes of programs that end."""

from __future__ import annotations

import importlib
import importlib.util
import os
import re
import shlex
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from urllib.request import urlopen

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from quadpi.msg import WrenchPrediction
from rosgraph_msgs.msg import Clock

from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.paths import bags_directory
from quadpi_core.vehicle import Vehicle
from quadpi_ros.live_session import Listener
from quadpi_ros.parameters import EstimatorParameters, MonitorParameters
from quadpi_ros.player import parse_arguments

from . import launch_child

ROOT = Path(__file__).parents[2]
GOLDEN_MODEL = ROOT / "test" / "golden" / "model"
START_S = 300.0
Launch = Callable[..., AbstractContextManager["Launched"]]
NOT_INSTALLED = re.compile(r"the package (\w+) that defines it is not installed")


def lines(command: str) -> list[str]:
    """What follows `ros2 launch quadpi` or another command in the documents."""
    found = set()
    for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))):
        text = page.read_text().replace("\\\n", " ")
        found |= set(re.findall(rf"^ *{command} (.+)$", text, flags=re.MULTILINE))
    return sorted(found)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the documents name."""
    folder = tmp_path_factory.mktemp("launch")
    shutil.copy(bags_directory() / "interpolation.mcap", folder / "flight.mcap")
    for page in (ROOT / "docs").glob("*.md"):
        for name, content in re.findall(r"^```yaml\n# (\S+\.yaml)\n(.*?)^```", page.read_text(), re.M | re.S):
            (folder / name).write_text(content)
    return folder


@pytest.fixture
def run(place: Path, ros_domain: int, tmp_path: Path) -> Launch:
    """run(command, …) → the process, in that folder; it ends with the block."""
    del ros_domain

    @contextmanager
    def started(*command: str) -> Iterator[Launched]:
        with (tmp_path / "said.txt").open("w") as output:
            process = subprocess.Popen(
                command, cwd=place, stdout=output, stderr=output, env={**os.environ, "PYTHONUNBUFFERED": "1"}
            )
            try:
                yield Launched(process, tmp_path / "said.txt")
            finally:
                if process.poll() is None:
                    process.send_signal(signal.SIGINT)
                process.wait(30.0)

    return started


@pytest.fixture
def launch(run: Launch) -> Launch:
    """launch("monitor.launch.py", "vehicle:=bebop2", …) → the process that does what `ros2 launch` does."""
    return partial(run, sys.executable, launch_child.__file__, "quadpi")


class Launched:
    """A process under way."""

    def __init__(self, process: subprocess.Popen[bytes], said: Path) -> None:
        self._process, self._said = process, said

    @property
    def said(self) -> str:
        return self._said.read_text()

    def pids(self) -> list[int]:
        """Of the programs it has started so far."""
        return [int(pid) for pid in re.findall(r"process started with pid \[(\d+)\]", self.said)]

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def wait(self) -> int:
        return self._process.wait(START_S)

    def wait_until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + START_S
        while not condition():
            assert self._process.poll() is None, self.said
            assert time.monotonic() < deadline, self.said
            time.sleep(0.05)

    def interrupt(self) -> int:
        self._process.send_signal(signal.SIGINT)
        return self.wait()


@pytest.mark.slow
@pytest.mark.parametrize("line", lines("ros2 launch quadpi"))
def test_lines_of_the_documents(line: str, place: Path, launch: Launch) -> None:
    file, *arguments = shlex.split(line)
    vehicle = Vehicle.load(str(place / "my-quad.yaml") if "vehicle:=my-quad.yaml" in arguments else "bebop2")
    model = AerodynamicModel.load(GOLDEN_MODEL)
    replace(model, vehicle=vehicle.name, vehicle_fingerprint=vehicle.fingerprint).save(place / "my-model")
    if file == "replay.launch.py":
        arguments.append("rate:=2")
    predicted: list[bytes] = []
    topics = [(WrenchPrediction, "prediction", predicted.append)]
    if file == "mavlink.launch.py":
        topics = [(DiagnosticArray, "/diagnostics", predicted.append)]
    with Listener("test_launch", topics) as listener, launch(file, *arguments) as launched:
        if any("field-nodes" in argument for argument in arguments):
            status = launched.wait()
            assert status == 1
            assert NOT_INSTALLED.search(launched.said), launched.said
        elif file == "replay.launch.py":
            listener.spin_until(lambda: launched.ended, START_S)
            assert launched.wait() == 0, launched.said
            # Not silence; how many it must be is for test_live_session.py, on whatever a busy machine leaves.
            assert len(predicted) > 100
        else:
            launched.wait_until(lambda: listener.connected)
            assert launched.interrupt() == 0, launched.said


@pytest.mark.parametrize("line", [line for line in lines("ros2 run quadpi") if "--enclave" not in line])
def test_programs_of_the_documents(line: str, run: Launch) -> None:
    program, *arguments = shlex.split(line)
    installed = Path(sys.prefix, "lib", "quadpi", program)
    heard: list[bytes] = []
    topics = [(DiagnosticArray, "/diagnostics", heard.append)]
    if program == "player":
        topics = [(Clock, "/clock", heard.append)]
        arguments += ("--wait", "0")
    with (
        Listener("test_launch", topics) as listener,
        run(str(installed), *arguments) as running,
    ):
        running.wait_until(lambda: listener.spin_until(lambda: bool(heard), 0.1))
        assert running.interrupt() == 0, running.said
        assert "Traceback" not in running.said


def test_lines_are_found() -> None:
    assert lines("ros2 run quadpi")
    assert {line.split()[0] for line in lines("ros2 launch quadpi")} == {
        file.name for file in (ROOT / "launch").glob("*.launch.py")
    }


BRIDGE = ("mavlink.launch.py", "connection:=udpout:127.0.0.1:14599", "vehicle:=bebop2")


def test_a_program_that_dies_is_started_again(launch: Launch) -> None:
    with launch(*BRIDGE) as launched:
        launched.wait_until(lambda: len(launched.pids()) == 1)
        os.kill(launched.pids()[0], signal.SIGKILL)
        launched.wait_until(lambda: len(launched.pids()) == 2)
        assert launched.interrupt() == 0, launched.said


@pytest.mark.parametrize("why", ["killed", "refused"])
def test_a_program_that_fails_for_good_is_an_exit_status(why: str, launch: Launch) -> None:
    file, connection, vehicle = BRIDGE
    wrong = ["vehicle:=nothing"] if why == "refused" else [vehicle, "respawn:=false"]
    with launch(file, connection, *wrong) as launched:
        launched.wait_until(lambda: len(launched.pids()) == 1)
        if why == "killed":
            os.kill(launched.pids()[0], signal.SIGKILL)
        assert launched.wait() == 1
        status = -signal.SIGKILL if why == "killed" else 2
        assert f"mavlink_bridge has ended with exit status {status}" in launched.said
        assert len(launched.pids()) == 1


MONITOR = ("monitor.launch.py", "vehicle:=bebop2", f"model:={GOLDEN_MODEL}", "view:=true")


def test_the_page_comes_with_the_nodes_and_again_when_it_is_killed(launch: Launch) -> None:
    with launch(*MONITOR, "view_port:=0") as launched:

        def pages() -> list[str]:
            return re.findall(r"Page at (http://127\.0\.0\.1:\d+/)", launched.said)

        launched.wait_until(lambda: len(pages()) == 1)
        with urlopen(pages()[0]) as answer:
            assert b"<title>quadpi</title>" in answer.read()
        os.kill(launched.pids()[-1], signal.SIGKILL)
        launched.wait_until(lambda: len(pages()) == 2)
        assert launched.interrupt() == 0, launched.said
        assert len(launched.pids()) == 3


def test_a_page_whose_port_is_taken_ends_nothing_else(launch: Launch) -> None:
    with (
        socket.socket() as taken,
        Listener("test_launch", [(WrenchPrediction, "prediction", len)]) as listener,
    ):
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with launch(*MONITOR, f"view_port:={port}") as launched:
            launched.wait_until(lambda: f"port {port} is in use by process" in launched.said)
            launched.wait_until(lambda: listener.connected)
            assert launched.interrupt() == 0, launched.said


def test_a_parameter_file_that_is_not_there_is_refused(launch: Launch) -> None:
    with launch(*BRIDGE, "parameters:=nothing.yaml") as launched:
        assert launched.wait() == 1
        assert "launch argument `parameters`: there is no file `nothing.yaml`" in launched.said
        assert not launched.pids()


@pytest.fixture
def launching(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module with stand-ins for launch and launch_ros."""
    for name, module in launch_child.stand_ins().items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.delitem(sys.modules, "quadpi_ros.launching", raising=False)
    yield importlib.import_module("quadpi_ros.launching")
    monkeypatch.delitem(sys.modules, "quadpi_ros.launching")


def started(file: str, given: dict[str, Any]) -> dict[str, Any]:
    """Nodes that a launch file starts, by program."""
    specification = importlib.util.spec_from_file_location("launch_file", ROOT / "launch" / file)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    declared = module.generate_launch_description().value
    values = {one.value: one.default_value for one in declared if hasattr(one, "default_value")}
    values |= {"bag": str(bags_directory() / "interpolation.mcap"), "vehicle": "bebop2", "model": "m"} | given
    actions = module.start(SimpleNamespace(launch_configurations=values))
    return {one.executable: one for one in actions if hasattr(one, "executable")}


def test_arguments_are_parameters_of_the_nodes(launching: ModuleType) -> None:
    parameters = {item.name for kind in (EstimatorParameters, MonitorParameters) for item in fields(kind)}
    arguments = {argument.value for argument in launching.monitor_arguments(respawn="true")}
    assert set(launching.PARAMETERS) - {"use_sim_time"} == arguments & parameters


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({}, {"loop": False, "start_offset": 0.0, "clock": None, "rate": 1.0}),
        (
            {"loop": "true", "start_offset": "2.5", "rate": "3"},
            {"loop": True, "start_offset": 2.5, "rate": 3.0},
        ),
        ({"use_sim_time": "true"}, {"clock": 40.0}),
        ({"use_sim_time": "true", "clock": "10"}, {"clock": 10.0}),
    ],
)
@pytest.mark.usefixtures("launching")
def test_arguments_of_the_replay_are_options_of_the_player(
    given: dict[str, str], expected: dict[str, object]
) -> None:
    options = parse_arguments(started("replay.launch.py", given)["player"].arguments)
    assert {name: getattr(options, name) for name in expected} == expected


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        # Nothing said: the parameter is left to a SetParameter around, and to the parameter file.
        ({}, {}),
        ({"use_sim_time": "false"}, {"use_sim_time": False}),
        ({"global_params": [("use_sim_time", True), "file.yaml"]}, {"use_sim_time": True}),
        ({"global_params": [("use_sim_time", True)], "use_sim_time": "False"}, {"use_sim_time": False}),
    ],
)
@pytest.mark.usefixtures("launching")
def test_the_clock_is_that_of_the_launch_file_around(
    given: dict[str, Any], expected: dict[str, bool]
) -> None:
    nodes = started("replay.launch.py", given)
    found = {name: value for name, value in nodes["live"].parameters[1].items() if name == "use_sim_time"}
    assert found == expected
    assert ("--clock" in nodes["player"].arguments) == expected.get("use_sim_time", False)


@pytest.mark.usefixtures("launching")
def test_the_level_of_the_log_is_that_of_every_program() -> None:
    nodes = started("replay.launch.py", {"log_level": "warn", "markers": "true", "view": "true"})
    assert len(nodes) == 4
    assert all(node.ros_arguments == ["--log-level", "warn"] for node in nodes.values())


@pytest.mark.parametrize(
    ("given", "expected", "refusal"),
    [
        ({"mocap_pose_topic": "/vrpn/quad/pose", "erpm_topic": "/motors"}, {"mocap_topic": "mocap/pose"}, ""),
        ({"mocap_transform_topic": "/vicon/quad/quad"}, {"mocap_topic": "mocap/transform"}, ""),
        (
            {"mocap_pose_topic": "/vrpn/quad/pose", "mocap_topic": "mocap/odometry"},
            {},
            "`mocap_pose_topic` is given but not used: mocap_topic is mocap/odometry",
        ),
        (
            {"rotor_speeds_topic": "/motors", "erpm_topic": "/motors"},
            {},
            "`erpm_topic` is given but not used: rotor_topic is rotor_speeds",
        ),
    ],
)
def test_a_topic_that_is_given_a_name_is_listened_to(
    launching: ModuleType, given: dict[str, str], expected: dict[str, str], refusal: str
) -> None:
    refused = pytest.raises(launching.LaunchError, match=refusal) if refusal else nullcontext()
    with refused:
        live = started("monitor.launch.py", given)["live"]
        chosen = {name: getattr(value, "value", value) for name, value in live.parameters[1].items()}
        assert chosen.items() >= expected.items()


@pytest.mark.usefixtures("launching")
def test_markers_are_published_where_asked() -> None:
    assert "markers" not in started("monitor.launch.py", {})
    given = {"markers": "true", "prediction_topic": "wrench"}
    node = started("monitor.launch.py", given)["markers"]
    assert ("prediction", "wrench") in node.remappings
