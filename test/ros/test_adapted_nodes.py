# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes and player with messages of other packages, over real DDS.

The packages are stood in for: Python classes that name their fields as generated ones do. Serialized messages
pass DDS as they are, so the type support of another message carries them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

pytest.importorskip("quadpi.msg", reason="the quadpi messages are not built")

from quadpi_core.flight import Recording
from quadpi_core.logs import messages, read_recording
from quadpi_core.logs.bags import read_outputs, write_bag
from quadpi_core.models import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.vehicle import Vehicle
from quadpi_ros.adapters import AdapterError
from quadpi_ros.collector import Collector
from quadpi_ros.player import playable
from quadpi_ros.processes import Child, isolated_domain
from quadpi_ros.session import await_start, play
from quadpi_ros.sources import AdaptedSources

from ..core.logs.adapters.conftest import DEFINITIONS, Messages
from ..core.logs.adapters.test_poses import frame
from ..core.logs.adapters.test_rotors import mavros_status

VEHICLE = "neurobem"
RAD_S_TO_RPM = 60.0 / (2.0 * np.pi)
FIELDS = {
    "mavros_msgs": {
        "ESCStatusItem": {
            "header": "std_msgs/Header",
            "rpm": "int32",
            "voltage": "float",
            "current": "float",
        },
        "ESCStatus": {"header": "std_msgs/Header", "esc_status": "sequence<mavros_msgs/ESCStatusItem>"},
    },
    "motion_capture_tracking_interfaces": {
        "NamedPose": {"name": "string", "pose": "geometry_msgs/Pose"},
        "NamedPoseArray": {
            "header": "std_msgs/Header",
            "poses": "sequence<motion_capture_tracking_interfaces/NamedPose>",
        },
    },
}
SETTINGS = """
rotor_speeds: {rotors: [4, 3, 2, 1], unit: rpm}
mocap: {body: quad, frames: flu-enu}
"""


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The packages, importable here and in child processes."""
    for package, kinds in FIELDS.items():
        folder = tmp_path / "packages" / package / "msg"
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").touch()
        lines = ["from std_msgs.msg import String"]
        for name, columns in kinds.items():
            lines += [
                f"class {name}(String):",
                "    @classmethod",
                "    def get_fields_and_field_types(cls):",
            ]
            lines += [f"        return {columns!r}"]
        (folder / "__init__.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path / "packages"))
    paths = (str(tmp_path / "packages"), os.environ.get("PYTHONPATH", ""))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] in FIELDS]:
        del sys.modules[name]


@pytest.fixture(scope="module")
def bag(hover: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The flight with speeds of ESCs in another order, and poses of two bodies; no standard topic but imu."""
    vendor = Messages(DEFINITIONS)
    rpm = np.rint(hover.rotor_speeds.speeds[:, ::-1] * RAD_S_TO_RPM)
    escs = [mavros_status(vendor, *row) for row in zip(hover.rotor_speeds.time_ns, rpm, strict=True)]
    poses = []
    for payload in messages.pack_pose(hover.pose):
        message = vendor.store.deserialize_cdr(payload, messages.POSE)
        p, q, stamp = message.pose.position, message.pose.orientation, message.header.stamp
        bodies = [("wand", [0, 0, 0], [0, 0, 0, 1]), ("quad", [p.x, p.y, p.z], [q.x, q.y, q.z, q.w])]
        poses.append(frame(vendor, "named_poses", 10**9 * stamp.sec + stamp.nanosec, bodies))
    topics = {
        "/imu": (messages.IMU, hover.imu.time_ns, list(messages.pack_imu(hover.imu))),
        "/mavros/esc_status/status": ("mavros_msgs/msg/ESCStatus", hover.rotor_speeds.time_ns, escs),
        "/poses": (
            "motion_capture_tracking_interfaces/msg/NamedPoseArray",
            hover.pose.time_ns,
            poses,
        ),
    }
    path = tmp_path_factory.mktemp("adapted") / "adapted"
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for name, (type_name, log_times, payloads) in topics.items():
            connection = writer.add_connection(name, type_name, typestore=vendor.store)
            for time_ns, payload in zip(log_times, payloads, strict=True):
                writer.write(connection, int(time_ns), payload)
    return path


@pytest.mark.usefixtures("packages")
def test_live_equals_the_replay_of_the_flight_that_the_adapters_read(
    bag: Path, folder: Path, tmp_path: Path
) -> None:
    settings = tmp_path / "field.yaml"
    settings.write_text(SETTINGS)
    vehicle = Vehicle.load(VEHICLE)
    recording = read_recording(bag, vehicle, settings)
    write_bag(tmp_path / "standard.mcap", recording)
    model = folder / "model"
    replay(AerodynamicModel.load(model), vehicle, tmp_path / "standard.mcap", tmp_path / "replayed.mcap")
    expected, _ = read_outputs(tmp_path / "replayed.mcap")

    given = {"vehicle": VEHICLE, "model": model, "adapters": settings}
    given |= {"rotor_topic": "mavros_status", "mocap_topic": "named_poses"}
    arguments = [part for name, value in given.items() for part in ("-p", f"{name}:={value}")]
    assert playable(bag) == ["imu", "mavros_status", "named_poses"]
    with isolated_domain() as scratch, Collector(int(recording.imu.time_ns[0])) as collector:
        with Child("quadpi_ros.live", ("--ros-args", *arguments), scratch) as live:
            await_start(live, collector)
            play(bag, playable(bag), 1.0, scratch, live, collector)
        predictions = collector.predictions()
    np.testing.assert_array_equal(predictions.time_ns, expected.time_ns)
    for name in ("predicted", "lower", "upper", "measured"):
        live_values, replayed = getattr(predictions, name), getattr(expected, name)
        np.testing.assert_allclose(live_values, replayed, rtol=1e-9, atol=1e-12)


def test_a_player_without_the_package_says_so(bag: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert playable(bag) == ["imu"]
    escs, poses = capfd.readouterr().err.splitlines()
    assert "mavros_msgs/msg/ESCStatus: the package mavros_msgs that defines it is not installed" in escs
    assert "NamedPoseArray: the package motion_capture_tracking_interfaces" in poses


@pytest.mark.usefixtures("packages")
def test_the_settings_name_the_topic_and_must_have_the_kind(tmp_path: Path) -> None:
    settings = tmp_path / "field.yaml"
    settings.write_text("mocap: {body: quad, frames: flu-enu, topic: /arena/poses}\n")
    sources = AdaptedSources("estimator", str(settings), Vehicle.load(VEHICLE))
    assert sources.named("named_poses").topic == "/arena/poses"
    with pytest.raises(AdapterError, match=r"field\.yaml: mavros_msgs/msg/ESCStatus needs .*`rotor_speeds`"):
        sources.named("mavros_status")
