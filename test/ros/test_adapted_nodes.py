# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes and player with messages of other packages, over real DDS.

The packages are stood in for: Python classes that name their fields as generated ones do. Serialized messages
pass DDS as they are, so the type support of another message carries them.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from shutil import copytree
from typing import Any

import numpy as np
import pytest
from quadpi.srv import LoadModel
from rosbags.interfaces import Nodetype
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.flight import ImuStream, Recording
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import read_outputs, write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters import known_adapters
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.replay import replay
from quadpi_core.results import Predictions
from quadpi_core.vehicle import Motors, Vehicle
from quadpi_ros.input_sources import AdaptedSources, AdapterError
from quadpi_ros.live_session import Child, ChildError, Collector, isolated_domain, play
from quadpi_ros.playlist import Playlist

from ..core.messages.adapters.vendor_messages import (
    DEFINITIONS,
    Messages,
    frame,
    mavros_status,
    mavros_telemetry,
    motor_commands,
    px4_odometry,
    px4_status,
    voltage,
)
from .rig import known_client

VEHICLE = "neurobem"
RAD_S_TO_RPM = 60.0 / (2.0 * np.pi)
SETTINGS = {
    "rotor_speeds": "{rotors: [4, 3, 2, 1], unit: rpm}",
    "mocap": "{body: quad, frames: flu-enu}",
    "imu": "{}",
    "odometry": "{}",
}
# Slow and short, for machines that are busy: a sample that the network loses is a prediction that lacks.
FLIGHT_S, PLAYBACK_RATE = 2.0, 0.25
TOPICS = {name: f"/vehicle/{adapter.topic}" for name, adapter in known_adapters().items()}
KINDS = {"float32": "float", "float64": "double"}


@pytest.fixture(scope="module")
def vendor() -> Messages:
    return Messages(DEFINITIONS)


def kind_of(field: Any) -> str:
    """The type of a field, from rosbags' description of it to the words of generated message classes."""
    node, about = field
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        item, length = about
        return f"sequence<{kind_of(item)}>" if node == Nodetype.SEQUENCE else f"{kind_of(item)}[{length}]"
    return about.replace("/msg/", "/") if node == Nodetype.NAME else KINDS.get(about[0], about[0])


@pytest.fixture
def packages(vendor: Messages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The packages, importable here and in child processes."""
    names = {name.partition("/")[0] for name in DEFINITIONS} - {"quadpi"}
    for package in names:
        folder = tmp_path / "packages" / package / "msg"
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").touch()
        lines = ["from std_msgs.msg import String"]
        for type_name in filter(lambda one: one.startswith(f"{package}/"), DEFINITIONS):
            columns = {name: kind_of(field) for name, field in vendor.store.fielddefs[type_name][1]}
            lines += [
                f"class {type_name.rpartition('/')[2]}(String):",
                "    @classmethod",
                "    def get_fields_and_field_types(cls):",
                f"        return {columns!r}",
            ]
        (folder / "__init__.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(str(tmp_path / "packages"))
    paths = (str(tmp_path / "packages"), os.environ.get("PYTHONPATH", ""))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] in names]:
        del sys.modules[name]


def rotor_messages(vendor: Messages, name: str, hover: Recording) -> list[bytes]:
    """Speeds of ESCs in another order than the vehicle's rotors."""
    rpm = np.rint(hover.rotor_speeds.speeds[:, ::-1] * RAD_S_TO_RPM)
    rows = enumerate(zip(hover.rotor_speeds.time_ns.tolist(), rpm, strict=True))
    if name == "mavros_telemetry":
        return [mavros_telemetry(vendor, time_ns, row, [count % 2**16] * 4) for count, (time_ns, row) in rows]
    make = mavros_status if name == "mavros_status" else px4_status
    return [make(vendor, time_ns, row) for _, (time_ns, row) in rows]


def pose_messages(vendor: Messages, name: str, hover: Recording) -> list[bytes]:
    """Poses of two bodies."""
    found = []
    for payload in sensor_messages.pack_pose(hover.pose):
        message = vendor.store.deserialize_cdr(payload, sensor_messages.POSE)
        p, q, stamp = message.pose.position, message.pose.orientation, message.header.stamp
        bodies = [("wand", [0, 0, 0], [0, 0, 0, 1]), ("quad", [p.x, p.y, p.z], [q.x, q.y, q.z, q.w])]
        found.append(frame(vendor, name, 10**9 * stamp.sec + stamp.nanosec, bodies))
    return found


def imu_messages(vendor: Messages, hover: Recording) -> list[bytes]:
    imu = hover.imu
    return [
        vendor.bytes(
            vendor.make(
                "px4_msgs/msg/SensorCombined",
                timestamp=int(time_ns) // 1000,
                gyro_rad=rates.astype(np.float32),
                accelerometer_m_s2=force.astype(np.float32),
            )
        )
        for time_ns, rates, force in zip(imu.time_ns, imu.angular_velocity, imu.specific_force, strict=True)
    ]


def state_messages(vendor: Messages, imu: ImuStream) -> list[bytes]:
    """An autopilot's estimate of a vehicle that hovers."""
    rng = np.random.default_rng(4)
    return [
        px4_odometry(
            vendor,
            timestamp_sample=int(time_ns) // 1000,
            q=[1.0, 0.0, 0.0, 0.0],
            velocity=0.05 * rng.standard_normal(3),
            angular_velocity=rates,
        )
        for time_ns, rates in zip(imu.time_ns, imu.angular_velocity, strict=True)
    ]


MOTORS = Motors(
    source="px4_motors", coefficients=((100.0, 1000.0, 0.0, 10.0, 0.0),) * 4, lag_s=0.02, volts=15.0
)
COMMANDED = ("px4_motors", "px4_battery", "px4_imu", "px4_odometry")


def command_messages(vendor: Messages, hover: Recording) -> list[bytes]:
    """Commands by motor, in the order of a quad X, that make about the speeds of a flight."""
    corners = [tuple(np.sign(position[:2])) for position in Vehicle.load(VEHICLE).rotor_positions]
    by_motor = hover.rotor_speeds.speeds[
        :, [corners.index(one) for one in [(1, 1), (-1, -1), (1, -1), (-1, 1)]]
    ]
    shares = (by_motor - 250.0) / 1000.0
    rows = zip(hover.rotor_speeds.time_ns.tolist(), shares, strict=True)
    return [motor_commands(vendor, "px4_motors", time_ns, row) for time_ns, row in rows]


def battery_messages(vendor: Messages, hover: Recording) -> list[bytes]:
    """A voltage that falls."""
    stamps = hover.rotor_speeds.time_ns[::200].tolist()
    return [
        voltage(vendor, "px4_battery", time_ns, 15.0 - 0.1 * place) for place, time_ns in enumerate(stamps)
    ]


def with_motors(folder: Path, to: Path) -> AerodynamicModel:
    """The model as if it had been identified on commands."""
    model = AerodynamicModel.load(folder / "model")
    return replace(model, flown=replace(model.flown or Vehicle.load(VEHICLE), motors=MOTORS)).save(to)


def beginning(hover: Recording, seconds: float) -> Recording:
    """The first seconds of a flight."""
    end_ns = hover.imu.time_ns[0] + round(1e9 * seconds)
    cut = {}
    for name in ("imu", "rotor_speeds", "pose"):
        stream = getattr(hover, name)
        kept = stream.time_ns < end_ns
        cut[name] = replace(
            stream, **{field.name: getattr(stream, field.name)[kept] for field in fields(stream)}
        )
    return replace(hover, **cut)


def write_vendor_bag(
    vendor: Messages, path: Path, names: Sequence[str], hover: Recording, measured: Recording | None = None
) -> Path:
    """The flight in messages of those adapters; the standard topic imu where none gives it.

    Rotor speeds are those of `measured`, if given.
    """
    turned = measured or hover
    # At 100 Hz, the most that PX4 exports.
    imu = hover.imu
    sampled = ImuStream(imu.time_ns[::5], imu.angular_velocity[::5], imu.specific_force[::5])
    made = {"imu": ("/imu", sensor_messages.IMU, imu.time_ns, list(sensor_messages.pack_imu(imu)))}
    for name in names:
        kind = known_adapters()[name].kind
        made.pop(kind, None)
        stream, payloads = {
            "rotor_speeds": lambda name=name: (turned.rotor_speeds, rotor_messages(vendor, name, turned)),
            "mocap": lambda name=name: (hover.pose, pose_messages(vendor, name, hover)),
            "imu": lambda: (imu, imu_messages(vendor, hover)),
            "odometry": lambda: (sampled, state_messages(vendor, sampled)),
            "motor_commands": lambda: (hover.rotor_speeds, command_messages(vendor, hover)),
            "battery": lambda: (
                hover.rotor_speeds.take(slice(None, None, 200)),
                battery_messages(vendor, hover),
            ),
        }[kind]()
        made[kind] = (TOPICS[name], known_adapters()[name].type_name, stream.time_ns, payloads)
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, type_name, log_times, payloads in made.values():
            connection = writer.add_connection(topic, type_name, typestore=vendor.store)
            for time_ns, payload in zip(log_times, payloads, strict=True):
                writer.write(connection, int(time_ns), payload)
    return path


@pytest.fixture(scope="module")
def bag(vendor: Messages, hover: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """No standard topic but imu."""
    folder = tmp_path_factory.mktemp("adapted")
    return write_vendor_bag(vendor, folder / "adapted", ("mavros_status", "named_poses"), hover)


@contextmanager
def flown(
    bag: Path, given: dict[str, Any], scratch: Path, start_ns: int
) -> Iterator[tuple[Collector, Child]]:
    """The live nodes that parameters ask for, after a bag was played through them."""
    nodes, managed = ("monitor_node", ("monitor",))
    if "mocap_topic" in given:
        nodes, managed = "live_process", ("estimator", "monitor")
    arguments = [part for name, value in given.items() for part in ("-p", f"{name}:={value}")]
    with (
        Collector(start_ns) as collector,
        Child(f"quadpi_ros.{nodes}", ("--ros-args", *arguments), scratch) as live,
    ):
        collector.spin_until(lambda: live.finished() or collector.hears("prediction"), 300.0)
        play(bag, tuple(Playlist.read(bag).topics), PLAYBACK_RATE, scratch, live, collector, managed)
        yield collector, live


def assert_replayed(bag: Path, given: dict[str, Any], expected: Predictions) -> None:
    """Live predictions are those of the replay of the same bag."""
    with isolated_domain() as scratch, flown(bag, given, scratch, int(expected.time_ns[0])) as (collector, _):
        # A busy machine may hold the nodes up for longer than a flight falls silent.
        collector.spin_until(lambda: len(collector.arrived_ns) >= len(expected.time_ns), 20.0)
        live = collector.predictions()
    assert len(live.time_ns) > 450
    np.testing.assert_array_equal(live.time_ns, expected.time_ns)
    for name in ("predicted", "lower", "upper", "measured"):
        np.testing.assert_allclose(getattr(live, name), getattr(expected, name), rtol=1e-9, atol=1e-12)


@pytest.mark.usefixtures("packages")
@pytest.mark.parametrize(
    "names",
    [
        ("mavros_status", "named_poses"),
        ("mavros_telemetry", "mocap4r2", "px4_imu"),
        ("px4_status", "px4_imu", "px4_odometry"),
    ],
    ids=" ".join,
)
def test_live_equals_the_replay_of_the_flight_that_the_adapters_read(
    names: tuple[str, ...], vendor: Messages, hover: Recording, folder: Path, tmp_path: Path
) -> None:
    """Each adapter feeds the nodes; with a state from the autopilot that is the monitor alone."""
    settings = tmp_path / "field.yaml"
    kinds = {known_adapters()[name].kind for name in names}
    settings.write_text("".join(f"{kind}: {SETTINGS[kind]}\n" for kind in sorted(kinds)))
    bag = write_vendor_bag(vendor, tmp_path / "adapted", names, beginning(hover, FLIGHT_S))
    vehicle = Vehicle.load(VEHICLE)
    recording = read_recording(bag, vehicle, settings)
    write_bag(tmp_path / "standard.mcap", recording)
    model = folder / "model"
    replay(AerodynamicModel.load(model), vehicle, tmp_path / "standard.mcap", tmp_path / "replayed.mcap")
    expected, _ = read_outputs(tmp_path / "replayed.mcap")

    by_kind = {known_adapters()[name].kind: name for name in names}
    given = {"vehicle": VEHICLE, "model": model, "adapters": settings, "rotor_topic": by_kind["rotor_speeds"]}
    given["pairing_timeout_s"] = 1.0
    if "mocap" in by_kind:
        given["mocap_topic"] = by_kind["mocap"]
    assert set(Playlist.read(bag).topics) == set(names) | ({"imu"} - kinds)
    assert_replayed(bag, given, expected)


@pytest.mark.usefixtures("packages")
def test_live_by_motor_commands_equals_the_replay(
    vendor: Messages, hover: Recording, folder: Path, tmp_path: Path
) -> None:
    """Commands and battery of a model identified on commands are read by type: no file says how."""
    model = with_motors(folder, tmp_path / "commanded")
    bag = write_vendor_bag(vendor, tmp_path / "bag", COMMANDED, beginning(hover, FLIGHT_S))
    replay(model, model.load_vehicle(VEHICLE), bag, tmp_path / "replayed.mcap")
    expected, _ = read_outputs(tmp_path / "replayed.mcap")
    settings = tmp_path / "field.yaml"
    settings.write_text("imu: {}\nodometry: {}\n")
    given = {"vehicle": VEHICLE, "model": tmp_path / "commanded", "adapters": settings}
    assert_replayed(bag, given | {"pairing_timeout_s": 1.0}, expected)


@pytest.mark.usefixtures("packages")
def test_commands_stand_in_while_rotor_speeds_are_silent(
    vendor: Messages, hover: Recording, folder: Path, tmp_path: Path
) -> None:
    """Telemetry ends in the middle of a flight: another model goes on, by commands, and the log says so."""
    with_motors(folder, tmp_path / "commanded")
    flight = beginning(hover, FLIGHT_S)
    bag = write_vendor_bag(
        vendor, tmp_path / "bag", (*COMMANDED, "px4_status"), flight, beginning(hover, 0.5 * FLIGHT_S)
    )
    settings = tmp_path / "field.yaml"
    settings.write_text(
        "".join(f"{kind}: {SETTINGS[kind]}\n" for kind in ("imu", "odometry", "rotor_speeds"))
    )
    given = {"vehicle": VEHICLE, "model": folder / "model", "fallback_model": tmp_path / "commanded"}
    given |= {"adapters": settings, "rotor_topic": "px4_status", "pairing_timeout_s": 1.0}
    start_ns = int(hover.imu.time_ns[0])
    with isolated_domain() as scratch, flown(bag, given, scratch, start_ns) as (collector, live):
        collector.spin_until(lambda: "made of motor commands" in live.errors.read_text(), 20.0)
        assert "made of motor commands from now on, judged by commanded" in live.errors.read_text()
        # A model by measured speeds waits for them.
        until = partial(collector.spin_until, timeout_s=20.0)
        client = known_client(collector._node, LoadModel, "monitor/load_model", until)
        answer = client.call_async(LoadModel.Request(path=str(folder / "model")))
        until(answer.done)
        assert answer.result().message.endswith(" flies once rotor speeds come again")
        predictions = collector.predictions()
    last_s = 1e-9 * float(predictions.time_ns[-1] - hover.imu.time_ns[0])
    assert last_s > FLIGHT_S - 0.1


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"model": "[MODEL, COMMANDED]"}, "not those of the first model"),
        ({"model": "MODEL", "fallback_model": "MODEL"}, "was not identified on motor commands"),
        ({"model": "COMMANDED", "fallback_model": "COMMANDED"}, "needs no fallback"),
        ({"model": "[MODEL, SECOND]", "fallback_model": "COMMANDED"}, "takes the place of one model"),
    ],
)
def test_models_by_other_rotor_speeds_do_not_fly_together(
    given: dict[str, str], said: str, folder: Path, tmp_path: Path
) -> None:
    with_motors(folder, tmp_path / "commanded")
    copytree(folder / "model", tmp_path / "second")
    folders = {"MODEL": folder / "model", "COMMANDED": tmp_path / "commanded", "SECOND": tmp_path / "second"}
    arguments = ["-p", f"vehicle:={VEHICLE}"]
    for name, value in given.items():
        for word, path in folders.items():
            value = value.replace(word, str(path))  # noqa: PLW2901
        arguments += ["-p", f"{name}:={value}"]
    with (
        isolated_domain() as scratch,
        Collector(0) as collector,
        pytest.raises(ChildError, match=said),
        Child("quadpi_ros.monitor_node", ("--ros-args", *arguments), scratch) as live,
    ):
        collector.spin_until(live.finished, 120.0)


def test_a_player_without_the_package_says_so(bag: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert list(Playlist.read(bag).topics) == ["imu"]
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
