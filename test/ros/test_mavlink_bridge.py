# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The bridge over real MAVLink on loopback and real DDS: values, clock, reconnection, noise, signatures."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
import rclpy
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm
from rclpy.experimental import EventsExecutor
from rclpy.task import Future
from sensor_msgs.msg import Imu

from quadpi_core.logs.mavlink_frames import load_dialect
from quadpi_core.messages import sensor_messages
from quadpi_ros import mavlink_link
from quadpi_ros.callbacks import OUTPUT_QOS, SENSOR_QOS
from quadpi_ros.mavlink_bridge import MavlinkBridge
from quadpi_ros.parameters import BridgeParameters, ParameterError

from .aggregation import groups_of
from .mavlink_rig import LONG_QUEUE, TOPICS, Sender, await_link, flying, free_port, listening
from .rig import spinning, wait_until

ROOT = Path(__file__).parents[2]
# Rear right, front right, rear left, front left of neurobem are motors 4, 1, 2, 3 of PX4.
SPEEDS = np.array([4000, 1000, 2000, 3000]) * 2 * np.pi / 60


@pytest.fixture(scope="module", autouse=True)
def _domain(ros_domain: int) -> Iterator[None]:
    rclpy.init(domain_id=ros_domain)
    yield
    rclpy.try_shutdown()


def test_nothing_is_lost_at_500_hz_and_values_and_clock_are_right() -> None:
    with (
        listening() as heard,
        flying(heard.port, "--seconds", "4") as (vehicle, epoch_ns),
    ):
        heard.until(lambda: vehicle.poll() is not None)
        expected = {"imu": 2000, "rotor_speeds": 2000, "mocap/odometry": 400, "mocap/pose": 0}
        heard.until(lambda: {topic: heard.count(topic) for topic in TOPICS} == expected)
        told = vehicle.stdout.read() if vehicle.stdout else ""
        heard.until(lambda: int(heard.statuses[-1]["frames"]) > 4000)
        assert (heard.samples() == np.arange(2000)).all()
        imu = [sensor_messages.unpack_imu(payload) for payload in heard.payloads["imu"]]
        rotors = sensor_messages.unpack_rotor_speeds(heard.payloads["rotor_speeds"][-1])
        state = sensor_messages.unpack_odometry(heard.payloads["mocap/odometry"][-1])
        statuses, status = heard.statuses, heard.statuses[-1]
    assert imu[-1].specific_force[0] == pytest.approx([0.25, -0.5, -9.75])
    assert imu[-1].angular_velocity[0, 1:] == pytest.approx([0.0, -0.5])
    assert rotors.speeds[0] == pytest.approx(SPEEDS)
    assert state.position[0] == pytest.approx([1.0, 2.0, -3.0])
    assert state.attitude[0] == pytest.approx([0.5, 0.5, -0.5, 0.5])
    assert state.velocity[0] == pytest.approx([4.0, 5.0, 6.0])
    assert status["lost"] == status["checksum_errors"] == status["noise_bytes"] == "0"
    assert groups_of(status["name"]) == groups_of(f"uav1/{status['name']}") == ["Link"]
    exchanged = [one for one in statuses if one.get("clock_offset_from") == "TIMESYNC"]
    errors_ms = [abs(float(one["clock_offset_ms"]) - epoch_ns * 1e-6) for one in exchanged]
    assert min(errors_ms) < 2.0
    for error_ms, one in zip(errors_ms, exchanged, strict=True):
        assert error_ms <= float(one["clock_uncertainty_ms"]) + 0.01
    # Stamps are the vehicle's, moved: steady where arrivals are not.
    steps_ms = np.diff([one.time_ns[0] for one in imu[1000:]]) * 1e-6
    assert np.all(steps_ms > 0)
    # The vehicle was asked for what it can send: HIGHRES_IMU 105, ODOMETRY 331, ESC_STATUS 291.
    assert "asked for 105 every 4000 us" in told
    assert "asked for 331 every 10000 us" in told
    assert "asked for 291 every 4000 us" in told


def test_without_timesync_the_diagnostics_say_what_the_stamps_are() -> None:
    with (
        listening() as heard,
        flying(heard.port, "--deaf") as (_, epoch_ns),
    ):
        heard.until(lambda: any("imu_from" in status for status in heard.statuses[-1:]))
        heard.until(lambda: "answers no TIMESYNC" in heard.message())
        status = heard.statuses[-1]
        assert status["clock_offset_from"] == "earliest arrivals"
        assert status["clock_uncertainty_ms"] == "unknown"
        heard.until(lambda: abs(float(heard.statuses[-1]["clock_offset_ms"]) - epoch_ns * 1e-6) < 2.0)


def test_an_autopilot_is_told_what_has_changed() -> None:
    told: list[Any] = []
    with listening() as heard:
        sender = Sender(heard.port, 1)
        sender.socket.settimeout(0.0)
        parser = load_dialect().MAVLink(None)
        alarms = heard.node.create_publisher(ExtrapolationAlarm, "extrapolation_alarm", OUTPUT_QOS)
        weak = ExtrapolationAlarm(reasons=["rotor 3 gives 3.10 ± 0.40 % less thrust"], change_size=0.031)
        weak.cause_level[3] = weak.level = ExtrapolationAlarm.LEVEL_ALARM
        weak.changed, weak.changed_rotor = ExtrapolationAlarm.CHANGED_ROTOR, 3

        def is_told() -> bool:
            sender.send("heartbeat", 2, 12, 0, 0, 4, 3)
            alarms.publish(weak)
            with suppress(BlockingIOError):
                told.extend(parser.parse_buffer(sender.socket.recv(4096)) or [])
            return {"STATUSTEXT", "NAMED_VALUE_FLOAT"} <= {one.get_type() for one in told}

        heard.until(is_told)
    (text,) = (one for one in told if one.get_type() == "STATUSTEXT")
    assert text.text == "ALARM: rotor 3 gives 3.10 +- 0.40 % less thrust"
    number = next(one for one in told if one.get_type() == "NAMED_VALUE_FLOAT")
    assert (number.name, round(number.value, 3)) == ("rotor3_pc", 3.1)


def test_noise_and_cut_packets_cost_nothing_but_are_counted() -> None:
    with (
        listening() as heard,
        flying(heard.port, "--seconds", "2", "--rate", "100", "--noise") as (vehicle, _),
    ):
        heard.until(lambda: vehicle.poll() is not None)
        heard.until(lambda: heard.count() == 200)
        heard.until(lambda: bool(heard.statuses) and int(heard.statuses[-1]["noise_bytes"]) > 5_000)
        assert (heard.samples() == np.arange(200)).all()
        assert heard.statuses[-1]["lost"] == "0"


def test_a_vehicle_that_starts_again_is_followed() -> None:
    with listening() as heard:
        with flying(heard.port, "--rate", "100"):
            heard.until(lambda: heard.count() > 50)
        heard.until(lambda: "nothing heard of system 1" in heard.message())
        before = heard.count()
        # Its clock begins anew with it.
        with flying(heard.port, "--rate", "100", ago_s=1.0):
            heard.until(lambda: heard.count() > before + 50)
        stamps = [sensor_messages.unpack_imu(payload).time_ns[0] for payload in heard.payloads["imu"]]
    assert np.all(np.diff(stamps) > 0)
    assert abs(time.time_ns() - stamps[-1]) < 30e9


def test_a_broken_tcp_connection_is_made_again() -> None:
    port = free_port(socket.SOCK_STREAM)
    with listening(connection=f"tcp:127.0.0.1:{port}") as heard:
        heard.until(lambda: any("refused" in status["message"] for status in heard.statuses))
        for attempt in range(1, 3):
            before = heard.count()
            with flying(port, "--tcp", "--rate", "100"):
                heard.until(lambda before=before: heard.count() > before + 50)  # type: ignore[misc]
            broken = {"level": "2", "connections": str(attempt)}
            heard.until(lambda broken=broken: broken.items() <= heard.statuses[-1].items())  # type: ignore[misc]


def test_nobody_takes_the_place_of_the_vehicle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither another system, nor a sender that calls itself the same from another port."""
    with (
        listening() as heard,
        flying(heard.port, "--rate", "100") as (_, epoch_ns),
    ):
        heard.until(lambda: heard.count() > 100)
        logged: list[str] = []
        logger = SimpleNamespace(warning=logged.append, info=logged.append)
        monkeypatch.setattr(heard.bridge, "get_logger", lambda: logger)
        forgers = [Sender(heard.port, system) for system in (1, 7)]
        for forger in forgers:
            for _ in range(50):
                forger.send("HIGHRES_IMU", 10**9, *[9.0] * 13, 63, 0)
                forger.send("ATT_POS_MOCAP", 10**9, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0)
                forger.send("TIMESYNC", 0, 5)
        sent = 150

        def noticed() -> bool:
            nonlocal sent
            sent += 1
            for forger in forgers:
                forger.send("HEARTBEAT", 2, 12, 0, 0, 4, 3)
            return "sends heartbeats of an autopilot too" in heard.message()

        heard.until(noticed)
        assert "system 1 at another address, system 7" in heard.message()
        said = [line.partition(" sends")[0] for line in logged if "heartbeats of an autopilot too" in line]
        assert said == ["system 1 at another address", "system 7"]
        before = heard.count()
        heard.until(lambda: heard.count() > before + 100)
        ignored = ("not used: system 7", "not used: system 1 at another address")
        heard.until(lambda: [heard.statuses[-1].get(name) for name in ignored] == [str(sent)] * 2)
        status = heard.statuses[-1]
        assert status["system"] == "1"
        assert heard.count("mocap/pose") == 0
        assert (np.diff(heard.samples()) == 1).all()
        error_ms = abs(float(status["clock_offset_ms"]) - epoch_ns * 1e-6)
        assert error_ms <= float(status["clock_uncertainty_ms"]) + 0.01
        for forger in forgers:
            forger.socket.setblocking(False)
            with pytest.raises(BlockingIOError):
                forger.socket.recv(1)


def test_what_keeps_the_sensors_from_coming_is_logged_from_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    logged: list[str] = []
    diagnosed: list[int] = []

    def note(line: str) -> None:
        diagnosed.append(sum(line == status["message"] for status in heard.statuses))
        logged.append(line)

    with listening() as heard:
        logger = SimpleNamespace(warning=note, info=note)
        monkeypatch.setattr(heard.bridge, "get_logger", lambda: logger)
        heard.until(lambda: any("no heartbeat of an autopilot" in line for line in logged))
        vehicle = Sender(heard.port, 1)

        def told() -> bool:
            vehicle.send("HEARTBEAT", 2, 12, 0, 0, 4, 3)
            return any("the autopilot sends no imu, no rotor_speeds" in line for line in logged)

        heard.until(told)
        with flying(heard.port, "--rate", "100"):
            heard.until(lambda: logged[-1].startswith("active: "))
        heard.until(lambda: logged[-1].startswith("nothing heard of system 1 for "))
        seen = len(heard.statuses)
        heard.until(lambda: len(heard.statuses) > seen + 2)
    said = [line.split()[0] for line in logged if "heartbeats of an autopilot too" not in line]
    assert said == ["connected,", "the", "active:", "nothing"]
    # At the second diagnostics that say the same.
    assert max(diagnosed) == 1


def test_numbers_that_are_none_do_not_break_the_link() -> None:
    with listening() as heard:
        vehicle, infinite = Sender(heard.port, 1), float("inf")
        vehicle.send("HEARTBEAT", 2, 12, 0, 0, 4, 3)
        for number in range(1, 100):
            vehicle.send("ATTITUDE", number, 0.0, 0.0, infinite, infinite, -infinite, float("nan"))
            vehicle.send("ATTITUDE_QUATERNION", number, 1.0, 0.0, 0.0, 0.0, infinite, 0.0, 0.0)
            vehicle.send("LOCAL_POSITION_NED", number, 1.0, 2.0, 3.0, infinite, 0.0, 0.0)
        refused = "refused: ATTITUDE: values that are not finite"
        heard.until(lambda: bool(heard.statuses) and refused in heard.statuses[-1])
        vehicle.send("ATTITUDE", 1000, *[0.1] * 6)
        vehicle.send("LOCAL_POSITION_NED", 1000, *[1.0] * 6)
        heard.until(lambda: heard.count("mocap/odometry") == 1)
        assert heard.statuses[-1]["connections"] == "1"
        assert not heard.bridge.exceptions.counts


def test_an_error_in_the_program_costs_a_packet_and_not_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    with listening() as heard:
        bridge = heard.bridge

        def fail(*_: Any) -> bytes:
            raise ValueError("of the test")

        with monkeypatch.context() as patch, flying(heard.port, "--rate", "100"):
            patch.setattr(sensor_messages, "pack_imu", fail)
            heard.until(lambda: bridge.exceptions.counts["link"] > 50)
            patch.undo()
            heard.until(lambda: heard.count() > 50)
            heard.until(lambda: bool(heard.callbacks))
        assert heard.statuses[-1]["connections"] == "1"
        assert "ValueError: of the test" in heard.callbacks[0]


def test_an_error_in_reading_costs_the_link(monkeypatch: pytest.MonkeyPatch) -> None:
    with listening() as heard:
        with monkeypatch.context() as patch:
            patch.setattr(mavlink_link.SocketLink, "read", lambda *_: 1 / 0)
            heard.until(lambda: heard.bridge.connections > 1)
        assert heard.bridge.exceptions.counts["link"] <= heard.bridge.connections
        heard.until(lambda: heard.statuses[-1:] != [] and "no heartbeat" in heard.statuses[-1]["message"])


def test_signatures(tmp_path: Path) -> None:
    (tmp_path / "key.txt").write_text("open sesame\n")
    with listening(key_file=str(tmp_path / "key.txt")) as heard:
        with flying(heard.port, "--rate", "100", "--passphrase", "wrong"):
            heard.until(lambda: bool(heard.statuses) and int(heard.statuses[-1]["refused_signatures"]) > 50)
        with flying(heard.port, "--rate", "100"):
            before = int(heard.statuses[-1]["refused_signatures"])
            heard.until(lambda: int(heard.statuses[-1]["refused_signatures"]) > before + 50)
        assert heard.count() == 0
        with flying(heard.port, "--rate", "100", "--passphrase", "open sesame"):
            heard.until(lambda: heard.count() > 50)


def test_serial_port() -> None:
    """A pseudo-terminal stands for the port."""
    pytest.importorskip("serial", reason="pyserial is not installed")
    here, there = os.openpty()
    dialect = load_dialect()
    mav = dialect.MAVLink(None, 1, 1)
    with listening(connection=f"serial:{os.ttyname(there)}:921600", passive=True) as heard:
        os.write(here, bytes(dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3).pack(mav)))
        for number in range(20):
            imu = dialect.MAVLink_highres_imu_message(1000 * number, *[0.0] * 13, 0x3F, 0)
            packet = bytes(imu.pack(mav))
            for start in range(0, len(packet), 7):
                os.write(here, packet[start : start + 7])
        heard.until(lambda: heard.count() == 20)
    os.close(here)
    os.close(there)


def test_a_telemetry_log_is_played_with_the_stamps_of_the_flight(shared_data: Path, tmp_path: Path) -> None:
    """In a process of its own: it ends with the log."""
    from quadpi_core.logs.formats.mavlink_tlog import read_records

    records = list(read_records(shared_data / "logs" / "ardupilot_vtol.tlog"))
    part = [r for r in records if r.arrival_ns - records[0].arrival_ns < 5e9]
    content = b"".join((r.arrival_ns // 1000).to_bytes(8, "big") + r.message.get_msgbuf() for r in part)
    (tmp_path / "part.tlog").write_bytes(content)
    node = rclpy.create_node("listener")
    stamps: list[int] = []
    node.create_subscription(
        Imu,
        "imu",
        lambda p: stamps.append(int(sensor_messages.unpack_imu(p).time_ns[0])),
        SENSOR_QOS,
        raw=True,
    )
    executor = EventsExecutor()
    executor.add_node(node)
    given = [f"connection:={tmp_path / 'part.tlog'}", "vehicle:=neurobem"]
    arguments = [word for one in given for word in ("-p", one)]
    process = subprocess.Popen(
        [sys.executable, "-m", "quadpi_ros.mavlink_bridge", "--ros-args", *arguments], stderr=subprocess.PIPE
    )
    wait_until(lambda: process.poll() is not None, spinning(executor))
    executor.shutdown()
    node.destroy_node()
    assert process.returncode == 0
    assert len(stamps) >= 10
    assert all(records[0].arrival_ns - 1e9 < stamp <= part[-1].arrival_ns for stamp in stamps)


def test_two_vehicles_in_their_namespaces(tmp_path: Path) -> None:
    """Each gets its parameters from the file, listens to its own vehicle, and has frames of its own."""
    content = yaml.safe_load((ROOT / "config" / "nodes" / "mavlink.yaml").read_text())
    content["/**/mavlink_bridge"]["ros__parameters"] |= {"vehicle": "neurobem", "imu_source": "HIGHRES_IMU"}
    (tmp_path / "mavlink.yaml").write_text(yaml.safe_dump(content))
    executor, listener = EventsExecutor(), rclpy.create_node("listener")
    executor.add_node(listener)
    frames: dict[str, set[str]] = {}
    senders, bridges = [], []
    for namespace, system in (("uav1", 1), ("uav2", 2)):
        port = free_port()
        bridges.append(
            MavlinkBridge(
                namespace=namespace,
                cli_args=["--ros-args", "--params-file", str(tmp_path / "mavlink.yaml")],
                parameter_overrides=[rclpy.parameter.Parameter("connection", value=f"udp:127.0.0.1:{port}")],
            )
        )
        assert bridges[-1].get_parameter("imu_source").value == "HIGHRES_IMU"
        frames[namespace] = set()
        note = frames[namespace].add
        for topic, kind in (("imu", Imu), ("mocap/odometry", Odometry)):
            listener.create_subscription(
                kind,
                f"/{namespace}/{topic}",
                lambda message, note=note: note(getattr(message, "child_frame_id", message.header.frame_id)),
                LONG_QUEUE,
            )
        senders.append(Sender(port, system))
        executor.add_node(bridges[-1])
        await_link(bridges[-1])
    numbers = itertools.count(1)

    def send() -> None:
        number = next(numbers)
        for sender in senders:
            sender.send("HEARTBEAT", 2, 12, 0, 0, 4, 3)
            sender.send("HIGHRES_IMU", 10_000 * number, *[0.0] * 13, 63, 0)
            sender.send("ATTITUDE", 10 * number, *[0.0] * 6)
            sender.send("LOCAL_POSITION_NED", 10 * number, *[0.0] * 6)
        executor.spin_until_future_complete(Future(), timeout_sec=0.05)

    wait_until(lambda: all(frames.values()), send, lambda: frames)
    assert frames == {"uav1": {"uav1/base_link"}, "uav2": {"uav2/base_link"}}
    executor.shutdown()
    for node in (*bridges, listener):
        node.destroy_node()


def test_parameter_file_and_node_agree() -> None:
    file = yaml.safe_load((ROOT / "config" / "nodes" / "mavlink.yaml").read_text())
    defaults = {item.name: item.default for item in fields(BridgeParameters)}
    assert file["/**/mavlink_bridge"]["ros__parameters"] == {
        name: value for name, value in defaults.items() if name not in {"connection", "vehicle"}
    }


@pytest.mark.parametrize("content", [None, "  \n"])
def test_a_key_that_cannot_be_read_is_refused(content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "key.txt").write_text(content)
    with (
        pytest.raises(ParameterError, match=r"key\.txt: the passphrase"),
        listening(connection="udp:127.0.0.1:14550", key_file=str(tmp_path / "key.txt")),
    ):
        pass
