# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Memory growth and lost predictions of the live process over half an hour, at up to four times real time.

The swings are played repeatedly with continuing stamps through three models. The baseline is the resident
memory after the first minute of flight. The player counts the predictions and waits for them if the machine
is too slow for the rate. So no queue overflows, and a missing prediction is a lost one.
"""

from __future__ import annotations

import struct
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks import Result, require_ros
from benchmarks.process_usage import resident_bytes
from benchmarks.swings import IMU_HZ, REPEATS_AFTER_S, VEHICLE, swings, three_models
from quadpi_core.logs.bags import write_bag
from quadpi_core.messages.sensor_messages import unpack_stamps
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    from quadpi_ros.live_session import Listener
    from quadpi_ros.playlist import Playlist

NAMES = ("soak_growth_mib", "soak_lost")

FLIGHT_MINUTES = 30.0
RATE = 4.0

# Stamp at the beginning of a serialized message, behind the four bytes of the encapsulation.
STAMP = struct.Struct("<iI")
_STAMP_AT = 4
_NANOSECONDS = 1_000_000_000
# The player is at most this far ahead of the predictions, and further at the start, where the estimator
# collects a second of samples.
_AHEAD_NS, _FIRST_NS = 200_000_000, 1_500_000_000
_POLL_S = 0.005
# Without a prediction for this time the run has failed.
_SILENT_S = 60.0
_START_S = 300.0


def run() -> list[Result]:
    require_ros()
    from quadpi_ros.live_session import Child, isolated_domain
    from quadpi_ros.playlist import Playlist

    vehicle = Vehicle.load(VEHICLE)
    resident: list[tuple[float, int]] = []
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
        playlist = Playlist.read(bag)
        heard = Heard(int(unpack_stamps(playlist.topics["imu"].payloads)[0]))
        with listening(heard) as listener, Child("quadpi_ros.live_process", arguments, scratch) as live:
            listener.spin_until(lambda: live.finished() or listener.connected, _START_S)

            def look() -> None:
                if live.finished():
                    raise RuntimeError("the live process ended in flight")
                resident.append((heard.flown_s, resident_bytes(live.pid)))

            sent_ns = play_over_and_over(playlist, heard, listener, look)
    settled = next(size for flown_s, size in resident if flown_s >= 60.0)
    growth = max(size for flown_s, size in resident if flown_s >= 60.0) - settled
    baseline = (
        f"{heard.flown_s / 60.0:.1f} minutes at {heard.flown_s / heard.heard_s:.1f} x real time, "
        f"{heard.predictions} predictions of each of three models; "
        f"resident after the first minute {settled / 2**20:.1f} MiB"
    )
    return [
        Result(NAMES[0], growth / 2**20, "MiB", baseline, goal=2.0, at_most=True),
        Result(NAMES[1], heard.lost(sent_ns), "samples", "of those after the first prediction", 0.0, True),
    ]


class Heard:
    """Count and stamps of the predictions of the live process.

    Args:
        begun_ns: first stamp played.
    """

    def __init__(self, begun_ns: int) -> None:
        self.predictions = 0
        self.newest_ns = self._first_ns = begun_ns
        self._first_s = self._newest_s = 0.0

    @property
    def flown_s(self) -> float:
        """Duration of the flight by the stamps of the predictions received."""
        return 1e-9 * (self.newest_ns - self._first_ns)

    @property
    def heard_s(self) -> float:
        """Time between the arrivals of the first and the last prediction."""
        return self._newest_s - self._first_s

    def lost(self, until_ns: int) -> int:
        """Predictions missing between the first one and the IMU sample of that stamp."""
        return round(1e-9 * (until_ns - self._first_ns) * IMU_HZ) + 1 - self.predictions

    def take(self, payload: bytes) -> None:
        """Count a prediction."""
        self.newest_ns = _stamp_ns(payload)
        self._newest_s = time.monotonic()
        if not self.predictions:
            self._first_ns, self._first_s = self.newest_ns, self._newest_s
        self.predictions += 1


def listening(heard: Heard) -> Listener:
    """A node that subscribes to every topic of the live process."""
    from nav_msgs.msg import Odometry
    from quadpi.msg import ExtrapolationAlarm, WrenchPrediction

    from quadpi_ros.live_session import Listener

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


def play_over_and_over(playlist: Playlist, heard: Heard, listener: Listener, look: Callable[[], None]) -> int:
    """Play a bag repeatedly with continuing stamps, waiting for predictions that fall behind.

    Args:
        playlist: the bag.
        heard: predictions received.
        listener: receives them.
        look: called every tenth of a second of flight.

    Returns:
        Stamp of the last IMU sample.
    """
    from rclpy.context import Context
    from rclpy.node import Node

    from quadpi_ros.callbacks import SENSOR_QOS, await_listeners
    from quadpi_ros.playlist import SENSOR_TYPES

    context = Context()
    context.init()
    node = Node("player", context=context, start_parameter_services=False)
    publishers = [node.create_publisher(SENSOR_TYPES[name], name, SENSOR_QOS) for name in playlist.topics]
    await_listeners(node, publishers, ("estimator", "monitor"), _START_S)
    topics = list(playlist.topics.values())
    messages = [
        (int(due), publishers[topic].publish, bytearray(topics[topic].payloads[index]))
        for due, topic, index in zip(playlist.due_ns, playlist.topic, playlist.message, strict=True)
    ]
    stamps = [_stamp_ns(payload) for _, _, payload in messages]
    sample_ns = round(_NANOSECONDS / IMU_HZ)
    period_ns = round(REPEATS_AFTER_S * IMU_HZ) * sample_ns
    turns = round(FLIGHT_MINUTES * 60.0 / REPEATS_AFTER_S)
    start_ns, listen_ns = time.monotonic_ns(), stamps[0]
    for turn in range(turns):
        for (due_ns, publish, payload), stamp_ns in zip(messages, stamps, strict=True):
            at_ns = stamp_ns + turn * period_ns
            STAMP.pack_into(payload, _STAMP_AT, *divmod(at_ns, _NANOSECONDS))
            wait_ns = start_ns + round((due_ns + turn * period_ns) / RATE) - time.monotonic_ns()
            if wait_ns > 0:
                time.sleep(1e-9 * wait_ns)
            publish(bytes(payload))
            if at_ns < listen_ns:
                continue
            listen_ns = at_ns + _AHEAD_NS // 2
            look()
            listener.spin(0.0)
            await_predictions(heard, listener, at_ns - (_AHEAD_NS if heard.predictions else _FIRST_NS))
    last_ns = stamps[0] + turns * period_ns - sample_ns
    listener.spin_until(lambda: heard.newest_ns >= last_ns, _SILENT_S)
    look()
    node.destroy_node()
    context.try_shutdown()
    return last_ns


def await_predictions(heard: Heard, listener: Listener, until_ns: int) -> None:
    """Receive messages until the predictions up to a stamp have arrived.

    Raises:
        RuntimeError: if they do not arrive.
    """
    deadline_s = time.monotonic() + _SILENT_S
    while heard.newest_ns < until_ns:
        listener.spin(_POLL_S)
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"no prediction came back for {_SILENT_S:g} s")


def _stamp_ns(payload: bytes | bytearray) -> int:
    seconds, nanoseconds = STAMP.unpack_from(payload, _STAMP_AT)
    return int(seconds) * _NANOSECONDS + int(nanoseconds)
