# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Memory of the live process over half an hour of flight, played at up to four times real time.

The swings are played over and over, with stamps that go on, through three models; what the process holds
resident after the first minute of flight is the baseline. Where the machine is too slow for the rate, the
player waits for the predictions: this is about memory, and nothing may be lost.
"""

from __future__ import annotations

import argparse
import struct
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks import Result, UnavailableError
from benchmarks.swings import IMU_HZ, REPEATS_AFTER_S, VEHICLE, swings, three_models
from quadpi_core.logs.bags import write_bag
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_ros.collector import Listener

NAMES = ("soak_growth_mib", "soak_lost")

FLIGHT_MINUTES = 30.0
RATE = 4.0

_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
_NANOSECONDS = 1_000_000_000
_SETTLE_S = 2.0
# How far the player may be ahead of the predictions, and how long it waits at a time.
_AHEAD_NS, _POLL_S = 200_000_000, 0.005


def run() -> list[Result]:
    try:
        import quadpi.msg  # noqa: F401
        import rclpy  # noqa: F401
    except ImportError as error:
        raise UnavailableError(f"ROS 2 with the quadpi messages is needed: {error}") from error
    from quadpi_ros.processes import Child, isolated_domain

    vehicle = Vehicle.load(VEHICLE)
    with tempfile.TemporaryDirectory() as name, isolated_domain() as scratch:
        folder = Path(name)
        models = three_models(folder, vehicle)
        bag = folder / "swings.mcap"
        write_bag(bag, swings(vehicle, REPEATS_AFTER_S))
        parameters = (
            f"vehicle:={VEHICLE}",
            f"model:=[{', '.join(str(folder / model.name) for model in models.values())}]",
            f"imu_rate_hz:={IMU_HZ}",
        )
        arguments = ("--ros-args", *(part for parameter in parameters for part in ("-p", parameter)))
        heard = Heard()
        with listening(heard) as listener, Child("quadpi_ros.live", arguments, scratch) as live:
            played = (str(bag), "--minutes", str(FLIGHT_MINUTES), "--rate", str(RATE))
            with Child("benchmarks.soak", played, scratch) as player:
                resident = []
                while not (player.finished() or live.finished()):
                    if heard.predictions:
                        resident.append((heard.flown_s, live.resident_bytes()))
                    listener.spin(1.0)
            listener.spin(_SETTLE_S)
            resident.append((heard.flown_s, live.resident_bytes()))
    settled = next(size for flown_s, size in resident if flown_s >= 60.0)
    growth = max(size for flown_s, size in resident if flown_s >= 60.0) - settled
    lost = round(heard.flown_s * IMU_HZ) + 1 - heard.predictions
    told = (
        f"{heard.flown_s / 60.0:.1f} minutes at {heard.flown_s / heard.heard_s:.1f} x real time, "
        f"{heard.predictions} predictions of each of three models; "
        f"resident after the first minute {settled / 2**20:.1f} MiB"
    )
    return [
        Result(NAMES[0], growth / 2**20, "MiB", told, goal=2.0, at_most=True),
        Result(NAMES[1], lost, "samples", "of those after the first prediction", goal=0.0, at_most=True),
    ]


class Heard:
    """What is kept of what the live process publishes: counts and stamps of its predictions."""

    def __init__(self) -> None:
        self.predictions = 0
        self.newest_ns = self._first_ns = 0
        self._first_s = self._newest_s = 0.0

    @property
    def flown_s(self) -> float:
        """Stamps of predictions heard so far, from the first to the last."""
        return 1e-9 * (self.newest_ns - self._first_ns)

    @property
    def heard_s(self) -> float:
        """Time between hearing these two."""
        return self._newest_s - self._first_s

    def take(self, payload: bytes) -> None:
        """Take a prediction."""
        seconds, nanoseconds = _STAMP.unpack_from(payload, _STAMP_AT)
        self.newest_ns = seconds * _NANOSECONDS + nanoseconds
        self._newest_s = time.monotonic()
        if not self.predictions:
            self._first_ns, self._first_s = self.newest_ns, self._newest_s
        self.predictions += 1


def listening(heard: Heard) -> Listener:
    """A node that hears every topic of the live process."""
    from nav_msgs.msg import Odometry
    from quadpi.msg import ExtrapolationAlarm, WrenchPrediction

    from quadpi_ros.collector import Listener

    return Listener(
        "listener",
        (
            (WrenchPrediction, "prediction", heard.take),
            (WrenchPrediction, "prediction/bootstrap", _ignore),
            (WrenchPrediction, "prediction/quality_driven", _ignore),
            (Odometry, "odometry", _ignore),
            (ExtrapolationAlarm, "extrapolation_alarm", _ignore),
        ),
    )


def _ignore(_: bytes) -> None:
    pass


def play_over_and_over(bag: Path, minutes: float, rate: float) -> None:
    """Play a bag again and again, with stamps that go on."""
    import rclpy
    from rclpy.node import Node

    from quadpi_ros.discovery import await_listeners
    from quadpi_ros.player import SENSOR_TYPES, Playlist
    from quadpi_ros.runtime import SENSOR_QOS

    playlist = Playlist.read(bag)
    node = Node("player", start_parameter_services=False)
    publishers = [node.create_publisher(SENSOR_TYPES[name], name, SENSOR_QOS) for name in playlist.names]
    await_listeners(node, publishers, ("estimator", "monitor"), 300.0)
    messages = [
        (int(due), publishers[topic].publish, bytearray(playlist.topics[topic].payloads[index]))
        for due, topic, index in zip(playlist.due_ns, playlist.topic, playlist.message, strict=True)
    ]
    stamps = [_STAMP.unpack_from(payload, _STAMP_AT) for _, _, payload in messages]
    period_ns = round(REPEATS_AFTER_S * IMU_HZ) * round(_NANOSECONDS / IMU_HZ)
    start_ns = time.monotonic_ns()
    heard, look_ns = Heard(), 0
    listener = listening(heard)
    for turn in range(round(minutes * 60.0 / REPEATS_AFTER_S)):
        for (due_ns, publish, payload), (seconds, nanoseconds) in zip(messages, stamps, strict=True):
            at_ns = seconds * _NANOSECONDS + nanoseconds + turn * period_ns
            _STAMP.pack_into(payload, _STAMP_AT, *divmod(at_ns, _NANOSECONDS))
            wait_ns = start_ns + round((due_ns + turn * period_ns) / rate) - time.monotonic_ns()
            if wait_ns > 0:
                time.sleep(1e-9 * wait_ns)
            publish(bytes(payload))
            while heard.predictions and at_ns > heard.newest_ns + _AHEAD_NS:
                listener.spin(_POLL_S)
                if not rclpy.ok():
                    return
            if at_ns >= look_ns:
                listener.spin(0.0)
                look_ns = at_ns + _AHEAD_NS // 2
    time.sleep(_SETTLE_S)


def main() -> int:
    """Play; a process of its own beside the live one."""
    from quadpi_ros.runtime import run as run_ros

    parser = argparse.ArgumentParser(description=play_over_and_over.__doc__)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--minutes", type=float, required=True)
    parser.add_argument("--rate", type=float, required=True)
    options = parser.parse_args()
    return run_ros(lambda: play_over_and_over(options.bag, options.minutes, options.rate))


if __name__ == "__main__":
    raise SystemExit(main())
