# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What the nodes do with what sensors send, without ROS: the same messages, objects and calls, in order."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from quadpi_core.errors import LogError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import with_gyro_faults
from quadpi_core.estimator.filter_state import WITHOUT_ESTIMATE, EstimatorStatus, Outcome
from quadpi_core.flight import MAX_JUMP_BACK_NS, Recording, Stamps
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.one_by_one import IncomingMessage
from quadpi_core.messages.payloads import Payloads
from quadpi_core.messages.sensor_messages import SampleKind
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor import Monitor
from quadpi_core.monitor.alarm_log import WORDS, reasons
from quadpi_core.monitor.health import TopicHealth, TopicReport
from quadpi_core.monitor.monitor import Monitors
from quadpi_core.monitor.pairing import PairedSamples, Pairing
from quadpi_core.results import CAUSES, LEVEL_OK, AlarmEvent, Alarms, Predictions
from quadpi_core.simulation.sensors import Fault, Sent, apply_faults
from quadpi_core.vehicle import Vehicle

RATE_HZ = 500.0
Spoil = Callable[[str, Payloads], Payloads]
_NEVER = -(2**63)
_MESSAGES: dict[str, tuple[Callable[..., Any], SampleKind[Any]]] = {
    "imu": (sensor_messages.pack_imu, sensor_messages.IMU_SAMPLES),
    "mocap/pose": (sensor_messages.pack_pose, sensor_messages.POSE_SAMPLES),
    "rotor_speeds": (sensor_messages.pack_rotor_speeds, sensor_messages.rotor_speed_samples(4)),
    "wind": (sensor_messages.pack_wind, sensor_messages.WIND_SAMPLES),
}


def sent_by(recording: Recording, seconds: float) -> dict[str, Sent]:
    """What the sensors sent in the first seconds of a flight, by topic."""
    sent = {}
    for stream in (recording.imu, recording.pose, recording.rotor_speeds):
        assert stream is not None
        kept = stream.time_ns < recording.imu.time_ns[0] + round(1e9 * seconds)
        part = type(stream)(**{name: column[kept] for name, column in vars(stream).items()})
        arrival_ns = part.time_ns
        if stream is not recording.imu:
            newest = np.maximum(recording.arrivals_of(stream)[kept], 1) - 1
            arrival_ns = recording.imu.time_ns[newest]
        sent[stream.topic] = Sent(part, part.time_ns, arrival_ns)
    return sent


def spoilt(sent: Mapping[str, Sent], *faults: Fault) -> dict[str, Sent]:
    """The same with faults of sensors."""
    taken_ns = sent["imu"].taken_ns
    return apply_faults(faults, sent, int(taken_ns[0]), int(taken_ns[-1]))


@dataclass(frozen=True)
class Flown:
    """What came of a flight; seconds count from its first IMU sample.

    Attributes:
        start_ns: stamp that they count from.
        imu_ns, arrived_ns: (N,) stamps of the IMU samples, and when they arrived.
        status: of the estimator after each of them.
        odometry_ns: stamps of what the estimator publishes.
        health: of each topic, over the whole flight.
        poses: how many met which outcome.
        predictions, alarms, events: of the monitor.
    """

    start_ns: int
    imu_ns: Stamps
    arrived_ns: Stamps
    status: list[EstimatorStatus]
    odometry_ns: Stamps
    health: dict[str, TopicReport]
    poses: dict[Outcome, int]
    predictions: Predictions
    alarms: Alarms
    events: list[AlarmEvent]

    def seconds(self, time_ns: Any) -> Any:
        return 1e-9 * (np.asarray(time_ns) - self.start_ns)

    def words(self, cause: int) -> set[str]:
        """All that the alarm says of a cause, but that it is over."""
        said = {text for row in range(len(self.alarms)) for text in reasons(self.alarms, row, cause)}
        return said - {ends for _, ends in WORDS.values()}

    def not_ok(self, cause: int) -> tuple[float, float]:
        """When a cause was first, and last, said not to be ok; two NaN where it never was."""
        rows = np.flatnonzero(self.alarms.cause_level[:, CAUSES.index(cause)] != LEVEL_OK)
        if len(rows) == 0:
            return np.nan, np.nan
        first, last = self.seconds(self.alarms.time_ns[rows[[0, -1]]])
        return float(first), float(last)

    def raised(self, cause: int) -> list[float]:
        """When a cause came to alarm level."""
        return [
            float(self.seconds(event.start_ns))
            for event in self.events
            if event.cause == cause and event.end_ns == 0
        ]

    def standing(self) -> set[int]:
        """Causes that are at alarm level at the end."""
        ended = {event.number for event in self.events if event.end_ns}
        return {event.cause for event in self.events if event.number not in ended}

    def states(self, begin_s: float, end_s: float) -> set[EstimatorStatus]:
        """What the estimator said of itself in that time."""
        arrived_s = self.seconds(self.arrived_ns)
        rows = np.flatnonzero((arrived_s >= begin_s) & (arrived_s < end_s))
        return {self.status[k] for k in rows}


class Onboard:
    """The nodes `estimator` and `monitor` of one process, with `rate_hz` as their parameter imu_rate_hz."""

    def __init__(self, vehicle: Vehicle, model: AerodynamicModel, rate_hz: float = 0.0) -> None:
        self.ekf = Ekf(vehicle, rate_hz or None)
        self.pairing = Pairing(rate_hz=rate_hz)
        self.monitors = Monitors({"model": Monitor(model, vehicle, None)})
        self._rate = self.pairing.rate
        self._newest_ns = _NEVER
        self._paired: list[PairedSamples] = []
        self._out: list[tuple[Predictions, Alarms, list[AlarmEvent]]] = []
        self._odometry_ns: list[int] = []
        self._read = {topic: IncomingMessage(kind) for topic, (_, kind) in _MESSAGES.items()}
        self._health = {topic: TopicHealth(RATE_HZ if topic == "imu" else None) for topic in _MESSAGES}

    def fly(self, sent: Mapping[str, Sent], spoil: Spoil = lambda _, payloads: payloads) -> Flown:
        """Take everything in the order in which it arrives; `spoil` alters the messages of a topic."""
        imu_ns, arrived_ns, status = [], [], []
        for at_ns, topic, payload in _arriving(sent, spoil):
            try:
                sample = self._read[topic](payload)
            except LogError as error:
                self._health[topic].refuse(str(error))
                continue
            time_ns = int(sample.time_ns[0])
            self._health[topic].take(time_ns)
            if topic == "imu":
                self._take_imu(sample)
                imu_ns.append(time_ns)
                arrived_ns.append(at_ns)
                status.append(self.ekf.status)
            elif topic == "mocap/pose":
                self.ekf.update_pose(time_ns, sample.position[0], sample.attitude[0])
            elif topic == "wind":
                self.pairing.add_wind(time_ns, sample.velocity[0])
            else:
                self.pairing.add_rotor_speeds(time_ns, sample.speeds[0])
                self._advance()
        self._judge()
        predictions, alarms, events = zip(*self._out, strict=True)
        flown = Flown(
            start_ns=int(sent["imu"].taken_ns[0]),
            imu_ns=np.array(imu_ns),
            arrived_ns=np.array(arrived_ns),
            status=status,
            odometry_ns=np.array(self._odometry_ns),
            health={topic: health.report(1.0) for topic, health in self._health.items()},
            poses=self.ekf.pose_counts,
            predictions=_joined(predictions),
            alarms=_joined(alarms),
            events=[event for block in events for event in block],
        )
        for part in (flown.predictions, flown.alarms):
            for item in fields(part):
                assert np.isfinite(getattr(part, item.name)).all(), item.name
        return flown

    def _take_imu(self, imu: Any) -> None:
        outcome, status, fused = self.ekf.step(
            int(imu.time_ns[0]), imu.angular_velocity[0], imu.specific_force[0]
        )
        if outcome not in (Outcome.USED, Outcome.COLLECTED):
            self._health["imu"].refuse(outcome.name)
        if fused is None:
            if outcome in WITHOUT_ESTIMATE:
                self._hand_over(with_gyro_faults(imu))
            return
        if status == EstimatorStatus.LOST:
            self._hand_over(fused.imu)
            return
        time_ns = int(fused.time_ns[0])
        self._odometry_ns.append(time_ns)
        self._note(time_ns)
        self.pairing.add_estimate(time_ns, fused.motion[0])
        self._advance()

    def _hand_over(self, imu: Any) -> None:
        time_ns = int(imu.time_ns[0])
        self._note(time_ns)
        self.pairing.add_imu(time_ns, imu.specific_force[0])
        self._advance()

    def _note(self, time_ns: int) -> None:
        if time_ns < self._newest_ns - MAX_JUMP_BACK_NS:
            self._judge()
            self.monitors.reset()
        self._newest_ns = time_ns

    def _advance(self) -> None:
        samples = self.pairing.take()
        if self.pairing.rate is not self._rate:
            self._judge()
            self._rate = self.pairing.rate
            assert not self.monitors.retune(self._rate)
        if samples is not None and not self._rate.begins:
            self._paired.append(samples)

    def _judge(self) -> None:
        """Blocks of any length give the same rows, so all that has come is one block."""
        if self._paired:
            self._out.append(self.monitors.step(_joined_samples(self._paired))[0])
            self._paired = []


def _arriving(sent: Mapping[str, Sent], spoil: Spoil) -> Iterator[tuple[int, str, bytes]]:
    """Messages in order of arrival; of the same instant the IMU first."""
    order = []
    for rank, topic in enumerate(_MESSAGES):
        if topic in sent:
            payloads = spoil(topic, _MESSAGES[topic][0](sent[topic].stream))
            order += [(int(ns), rank, k, topic, payloads) for k, ns in enumerate(sent[topic].arrival_ns)]
    for at_ns, _, index, topic, payloads in sorted(order, key=lambda item: item[:3]):
        yield at_ns, topic, payloads[index]


def _joined_samples(parts: list[PairedSamples]) -> PairedSamples:
    return PairedSamples(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _joined(parts: Any) -> Any:
    kind = type(parts[0])
    return kind(**{f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(kind)})


def deviation(flown: Flown, calm: Flown, from_s: float) -> float:
    """How far predictions from then on are off those of the calm flight, in half widths of its intervals."""
    expected, found = calm.predictions, flown.predictions
    wanted = calm.seconds(expected.time_ns) >= from_s
    assert set(expected.time_ns[wanted]) <= set(found.time_ns), "samples are lost"
    rows = np.searchsorted(found.time_ns, expected.time_ns[wanted])
    assert (found.time_ns[rows] == expected.time_ns[wanted]).all()
    off = np.abs(found.predicted[rows] - expected.predicted[wanted])
    return float((off / (0.5 * (expected.upper - expected.lower)[wanted])).max())
