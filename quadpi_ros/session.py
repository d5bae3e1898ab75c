# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A live session from Python: play a bag through the live nodes over real DDS, collect what they publish."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import yaml

from quadpi_core.errors import QuadpiError
from quadpi_core.flight import OdometryStream, Stamps
from quadpi_core.frames import Array
from quadpi_core.logs.messages import ReportedAlarms, unpack_stamps
from quadpi_core.monitor.alarm import LEVEL_ALARM
from quadpi_core.monitor.output import Predictions
from quadpi_core.signals.fusion import nominal_rate
from quadpi_ros.collector import AlarmChange, Collector
from quadpi_ros.player import Playlist

# The first start on a machine compiles the kernels.
_START_TIMEOUT_S = 300.0
_SILENCE_S = 0.5
_STOP_TIMEOUT_S = 5.0
# Above, the ports of a domain meet the ephemeral ports of Linux.
_DOMAIN_MAX = 101


class SessionError(QuadpiError):
    """A process of the session failed, or nothing came out of it."""


@dataclass(frozen=True)
class SessionResult:
    """What went in and came out.

    Attributes:
        imu_stamps_ns: (N,) stamps of the IMU samples played.
        rotor_stamps_ns: stamps of the rotor speeds played.
        latency_ms: (P,) from publication of an IMU sample to arrival of its prediction.
        odometry, predictions, alarms: as published.
    """

    imu_stamps_ns: Stamps
    rotor_stamps_ns: Stamps
    latency_ms: Array
    odometry: OdometryStream
    predictions: Predictions
    alarms: ReportedAlarms

    @property
    def dropped(self) -> int:
        """IMU samples without a prediction, from the first prediction to the last rotor speed."""
        first, last = self.predictions.time_ns[0], self.rotor_stamps_ns[-1]
        expected = np.sum((self.imu_stamps_ns >= first) & (self.imu_stamps_ns <= last))
        return int(expected) - len(self.predictions.time_ns)

    def summary(self) -> dict[str, float | int | None]:
        """The numbers of the session, ready for JSON; seconds count from the first IMU sample."""
        raised = self.alarms.level == LEVEL_ALARM
        end_ns = max(self.predictions.time_ns[-1], self.alarms.time_ns[-1])
        durations_ns = np.diff(self.alarms.time_ns, append=end_ns)
        since_start_s = 1e-9 * (self.alarms.time_ns - self.imu_stamps_ns[0])
        return {
            "samples_in": len(self.imu_stamps_ns),
            "predictions_out": len(self.predictions.time_ns),
            "dropped": self.dropped,
            "alarm_fraction": float(durations_ns[raised].sum() / max(durations_ns.sum(), 1)),
            "alarm_first_s": float(since_start_s[raised][0]) if raised.any() else None,
            "latency_ms_p50": float(np.percentile(self.latency_ms, 50)),
            "latency_ms_p99": float(np.percentile(self.latency_ms, 99)),
        }


def run_session(
    bag: Path,
    model: Path,
    *,
    vehicle: str,
    rate: float = 1.0,
    on_alarm: Callable[[AlarmChange], None] | None = None,
) -> SessionResult:
    """Start the live nodes, play the bag through them and collect until they fall silent.

    Nodes and player run in processes of their own, in a ROS domain of their own on this machine only. They
    end with the call, however it ends.

    Args:
        bag: with imu, mocap/pose and rotor_speeds or erpm.
        model: folder of a model of the vehicle.
        vehicle: name of its vehicle file, or a path.
        rate: speed of the replay; 1 is real time.
        on_alarm: called at every change of the alarm as it comes.

    Raises:
        SessionError: if a process fails, or no prediction comes.
        LogError: if the bag cannot be read.
    """
    playlist = Playlist.read(bag)
    rotor_topic = "rotor_speeds" if "rotor_speeds" in playlist.names else "erpm"
    stamps = {name: unpack_stamps(topic.payloads) for name, topic in playlist.by_name().items()}
    for topic in ("imu", rotor_topic, "mocap/pose"):
        if len(stamps.get(topic, ())) < 2:
            raise SessionError(f"{bag}: topic {topic}: the live nodes need it, the bag does not hold it")
    parameters = {
        "vehicle": vehicle,
        "model": str(model),
        "imu_rate_hz": nominal_rate(stamps["imu"]),
        "rotor_topic": rotor_topic,
    }
    played = [name for name in playlist.names if name in ("imu", rotor_topic, "mocap/pose", "wind")]
    with _stopping_on_sigterm(), _isolated() as folder:
        parameter_file, sent_file = folder / "parameters.yaml", folder / "sent.npz"
        parameter_file.write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}))
        live_arguments = ("--ros-args", "--params-file", str(parameter_file))
        player_arguments = (str(bag), "--rate", str(rate), "--sent", str(sent_file), "--topics", *played)
        with Collector(int(stamps["imu"][0]), on_alarm) as collector:
            with _Child("live", live_arguments, folder) as live:
                if not collector.spin_until(lambda: live.finished() or collector.connected, _START_TIMEOUT_S):
                    raise SessionError(f"the live nodes did not start within {_START_TIMEOUT_S:g} s")
                with _Child("player", player_arguments, folder) as player:
                    collector.spin_until(lambda: live.finished() or player.finished())
                collector.spin_until(lambda: live.finished() or collector.silent_for(_SILENCE_S))
                if live.finished():
                    raise SessionError("the live nodes ended before the flight did")
            return _result(bag, collector, sent_file, stamps[rotor_topic])


def _result(bag: Path, collector: Collector, sent_file: Path, rotor_stamps_ns: Stamps) -> SessionResult:
    with np.load(sent_file) as sent:
        stamps_ns, sent_ns = sent["imu"].T
    predictions = collector.predictions()
    if len(predictions.time_ns) == 0:
        raise SessionError(f"{bag}: no prediction came; the estimator needs a second of imu and mocap/pose")
    published_ns = sent_ns[np.searchsorted(stamps_ns, predictions.time_ns)]
    return SessionResult(
        imu_stamps_ns=stamps_ns,
        rotor_stamps_ns=rotor_stamps_ns,
        latency_ms=1e-6 * (collector.arrived_ns - published_ns),
        odometry=collector.odometry(),
        predictions=predictions,
        alarms=collector.alarms(),
    )


class _Child:
    """A module of quadpi_ros in a process of its own, which ends with the block."""

    def __init__(self, module: str, arguments: Sequence[str], folder: Path) -> None:
        self._module = module
        self._errors = folder / f"{module}.err"
        command = [sys.executable, "-m", f"quadpi_ros.{module}", *arguments]
        with self._errors.open("wb") as errors:
            self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors)

    def __enter__(self) -> _Child:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        try:
            self._process.wait(_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def finished(self) -> bool:
        """Whether it has ended well.

        Raises:
            SessionError: with what it said, if it has failed.
        """
        status = self._process.poll()
        if status:
            lines = self._errors.read_text(errors="replace").splitlines() or [f"exit status {status}"]
            raise SessionError(f"{self._module}: {lines[-1].removeprefix('error: ')}")
        return status is not None


@contextmanager
def _isolated() -> Iterator[Path]:
    """A scratch folder, and a ROS domain of its own on this machine for this process and its children."""
    before = dict(os.environ)
    with tempfile.TemporaryDirectory(prefix="quadpi_session.") as folder:
        os.environ |= {
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": str(1 + secrets.randbelow(_DOMAIN_MAX)),
            "ROS_LOG_DIR": folder,
            # A second thread of a linear-algebra library costs more than it brings for one sample.
            "OMP_NUM_THREADS": "1",
        }
        try:
            yield Path(folder)
        finally:
            os.environ.clear()
            os.environ.update(before)


@contextmanager
def _stopping_on_sigterm() -> Iterator[None]:
    """Let SIGTERM unwind the stack as Ctrl-C does, so that no child stays behind."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(number: int, _: FrameType | None) -> None:
        raise SystemExit(128 + number)

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
