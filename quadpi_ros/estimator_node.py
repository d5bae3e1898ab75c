# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Estimator node: imu and motion capture in, odometry out."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, TransformStamped, TwistStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu

from quadpi_core.core import compiled
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.estimator.filter_run import FusedSamples, with_gyro_faults
from quadpi_core.estimator.filter_state import WITHOUT_ESTIMATE, EstimatorStatus, Outcome
from quadpi_core.estimator.slow_states import VelocityRate, usual_noise
from quadpi_core.flight import (
    NO_STAMP,
    NOT_MEASURED,
    ImuStream,
    OdometryStream,
    PoseStream,
    TwistStream,
)
from quadpi_core.frames import Array
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters.packages.satellite_fixes import NAVSATFIX
from quadpi_core.messages.definitions import codec
from quadpi_core.messages.frame_ids import TF_TYPE, BodyFrames, FrameRefusedError, names_of
from quadpi_core.messages.one_by_one import IncomingMessage, OutgoingMessage
from quadpi_core.messages.payloads import POSE
from quadpi_core.messages.result_messages import transform_message
from quadpi_core.vehicle import Vehicle
from quadpi_ros import callbacks
from quadpi_ros.input_sources import AdaptedSources, AdapterError, Source, message_class
from quadpi_ros.parameters import EstimatorParameters, ParameterError
from quadpi_ros.runtime import run, serve
from quadpi_ros.sensor_node import DIAGNOSTICS_PERIOD_S, ConsistencyWatch, SensorNode

IMU_TOPIC = "imu"

# Time in which the filter should have initialised.
_INITIALISING_S = 3.0
# Newest stamps of two topics that are further apart come from different clocks.
_APART_S = 1.0
# IMU messages that a late position finds the orientation of its stamp in: half a second at 1 kHz.
_REMEMBERED = 512
_FUSED = {f"{kind} {outcome}" for kind in ("poses", "velocities") for outcome in ("used", "collected")}
_LEVELS = {
    EstimatorStatus.INITIALISING: callbacks.WARN,
    EstimatorStatus.OK: callbacks.OK,
    EstimatorStatus.DEGRADED: callbacks.WARN,
    EstimatorStatus.LOST: callbacks.ERROR,
}


class StateListener(NamedTuple):
    """Receives each estimate in the same process, without serialization, and raises nothing.

    Attributes:
        take_imu: takes an IMU sample, corrected by the estimated biases.
        take_estimate: takes an IMU sample, corrected, and the state at its stamp.
    """

    take_imu: Callable[[ImuStream], None]
    take_estimate: Callable[[FusedSamples], None]


class EstimatorNode(SensorNode[EstimatorParameters]):
    """The EKF of `quadpi_core.estimator.ekf` as a node.

    Attributes:
        listener: receives each estimate directly, before it is published.
    """

    def __init__(self) -> None:
        super().__init__("estimator", EstimatorParameters)
        self.listener: StateListener | None = None

    def configure(self) -> None:
        """Load the vehicle."""
        parameters = self.parameters
        vehicle = Vehicle.load(parameters.vehicle)
        self._odometry = OutgoingMessage(
            codec(sensor_messages.ODOMETRY),
            sensor_messages.odometry_constants(parameters.world_frame, parameters.body_frame),
        )
        adapted = AdaptedSources(self.get_name(), parameters.adapters, vehicle)
        self._body = self.frames_of(parameters.body_frame, parameters.frames)
        self._oriented: deque[tuple[int, bytes]] = deque(maxlen=_REMEMBERED)
        self._imu = adapted.instead_of(framed_imu(self._body), "imu")
        self._mocap, self._take_mocap = self._motion_capture(adapted)
        self._noise, self._usual = vehicle.noise, usual_noise(vehicle)
        self._ekf = Ekf(vehicle, parameters.imu_rate_hz or None)
        self._publish = self.announce(Odometry, "odometry")
        self._tf = TransformPublisher(self) if parameters.tf_rate_hz else None

    def activate(self) -> None:
        """Reset the filter and subscribe to its inputs."""
        self._ekf.reset()
        self._velocities = VelocityRate()
        self._consistency = ConsistencyWatch(self, None)
        self.hear_transforms(self._body)
        self._imu_health = self.listen(
            *self._imu, self._take_imu, rate_hz=self.parameters.imu_rate_hz or None
        )
        self._mocap_health = self.listen(*self._mocap, self._take_mocap)
        self._counted = self._mocap_outcomes()
        self._without_state = 0

    def _motion_capture(self, adapted: AdaptedSources) -> tuple[Source, Callable[[Any], None]]:
        """The motion capture of the parameter `mocap_topic`, and the method that takes its samples."""
        topic, body_frame = self.parameters.mocap_topic, self.parameters.body_frame
        standard: dict[str, tuple[type, sensor_messages.SampleKind[Any], Callable[[Any], None]]] = {
            "mocap/pose": (PoseStamped, sensor_messages.POSE_SAMPLES, self._take_pose),
            "mocap/transform": (TransformStamped, sensor_messages.TRANSFORM_SAMPLES, self._take_pose),
            "mocap/odometry": (Odometry, sensor_messages.ODOMETRY_SAMPLES, self._take_odometry),
            "mocap/twist": (TwistStamped, sensor_messages.twist_samples(body_frame), self._take_twist),
        }
        if topic == NAVSATFIX.name:
            self._imu = self._imu._replace(unpack=self._noting(self._imu.unpack))
            return adapted.self_described(topic), self._take_fix
        if topic not in standard:
            return adapted.named(topic), self._take_pose
        message_type, kind, take = standard[topic]
        return Source(message_type, topic, IncomingMessage(kind, self._body.world, self._body)), take

    def _noting(self, unpack: Callable[[bytes], ImuStream]) -> Callable[[bytes], ImuStream]:
        """An unpacker that notes the messages, for their orientation."""

        def noted(payload: bytes) -> ImuStream:
            imu = unpack(payload)
            self._oriented.extend((int(time_ns), payload) for time_ns in imu.time_ns)
            return imu

        return noted

    @property
    def mocap_ns(self) -> int:
        """Newest stamp of the motion capture; NO_STAMP before the first."""
        newest_ns = self._mocap_health.newest_ns
        return NO_STAMP if newest_ns is None else newest_ns

    @property
    def slow_since_ns(self) -> int | None:
        """Since when velocities are known to come as seldom as by GPS; None where they do not."""
        return self._velocities.slow_since_ns

    def _note_velocities(self, time_ns: list[int], poses: int = 0) -> None:
        imu_ns = self._imu_health.newest_ns
        self._velocities.take(time_ns, [NO_STAMP if imu_ns is None else imu_ns] * len(time_ns), poses)

    def problem(self) -> str | None:
        """As the base class, and why samples arrive but give no state."""
        lack = super().problem()
        self._without_state = 0 if lack or self._ekf.initialised else self._without_state + 1
        if lack:
            return lack
        imu, mocap = self._imu.topic, self._mocap.topic
        apart_s = 1e-9 * abs((self._imu_health.newest_ns or 0) - (self._mocap_health.newest_ns or 0))
        # Of poses that are ahead there is a state as soon as the IMU comes to them: a wrong one.
        if apart_s > _APART_S:
            return f"{imu} and {mocap} are stamped {apart_s:.3g} s apart: by different clocks?"
        if self._without_state * DIAGNOSTICS_PERIOD_S <= _INITIALISING_S:
            return None
        return (
            f"{imu} and {mocap} arrive but give no state: a second of both is needed, "
            f"{mocap} at 1 Hz or more and at most 0.4 s late"
        )

    def count_refused(self) -> None:
        """Count rejected poses and velocities; the filter decides on them after a delay."""
        outcomes = self._mocap_outcomes()
        for what, count in (outcomes - self._counted).items():
            if what not in _FUSED:
                self._mocap_health.refuse(what, count)
        self._counted = outcomes

    def statuses(self) -> list[DiagnosticStatus]:
        """Status of the filter with the outcomes of the motion capture, and of the consistency check."""
        ekf = self._ekf
        told = ("delay_s", "delay_std_s", "since_correction_s") if ekf.initialised else ()
        values: dict[str, float | int] = {name: getattr(ekf, name) for name in told}
        values |= self._mocap_outcomes()
        level, message = _LEVELS[ekf.status], ekf.status.name.lower()
        if stale := self.lack(self._imu.topic):
            level, message = callbacks.STALE, stale
        return [self.status("filter", level, message, values), self._consistency.status()]

    def _mocap_outcomes(self) -> Counter[str]:
        """Number of poses and velocities by outcome."""
        ekf = self._ekf
        return Counter(
            {
                f"{kind} {_reason(outcome)}": count
                for kind, counts in (("poses", ekf.pose_counts), ("velocities", ekf.velocity_counts))
                for outcome, count in counts.items()
                if count
            }
        )

    def _take_imu(self, imu: ImuStream) -> None:
        if not self._consistency.complete:
            self._consistency.take_copy(imu)
        time_ns = int(imu.time_ns[0])
        outcome, status, sample = self._ekf.step(time_ns, imu.angular_velocity[0], imu.specific_force[0])
        if outcome not in (Outcome.USED, Outcome.COLLECTED):
            reason = _reason(outcome)
            self._imu_health.refuse(reason)
            self.warn(f"topic {self._imu.topic}", f"sample not used: {reason}")
        if sample is None:
            if self.listener and outcome in WITHOUT_ESTIMATE:
                self.listener.take_imu(with_gyro_faults(imu))
            return
        if status is EstimatorStatus.LOST:
            if self.listener:
                self.listener.take_imu(sample.imu)
            return
        if self.listener:
            self.listener.take_estimate(sample)
        compiled.fill_odometry(sample.rows, self._odometry.values)
        time_ns = int(sample.time_ns[0])
        self._publish(self._odometry.stamped(time_ns))
        if self._tf is not None:
            self._tf.publish(time_ns, self._odometry.values[:, POSE])

    def _take_pose(self, pose: PoseStream) -> None:
        self._consistency.take_copy(pose)
        self._ekf.update_pose(int(pose.time_ns[0]), pose.position[0], pose.attitude[0])

    def _take_odometry(self, odometry: OdometryStream) -> None:
        self._consistency.take_copy(odometry)
        time_ns = int(odometry.time_ns[0])
        stated = self._noise.of_odometry(odometry.deviation[0])
        self._ekf.update_pose(time_ns, odometry.position[0], odometry.attitude[0], stated[:2])
        is_moving = stated[2] != NOT_MEASURED
        self._note_velocities([time_ns] if is_moving else [], poses=not is_moving)
        if is_moving:
            self._ekf.update_velocity(time_ns, odometry.velocity[0], True, stated[2])

    def _take_fix(self, fix: OdometryStream) -> None:
        """Take a position by satellites, with the attitude that the IMU's last message before it says."""
        turned: tuple[Any, Any, Any] = ((), (), ())
        stamp_ns = int(fix.time_ns[0])
        message = next((one for time_ns, one in reversed(self._oriented) if time_ns <= stamp_ns), b"")
        with suppress(FrameRefusedError):
            if message and self._body.imu(names_of(message, 1)[0]) is None:
                turned = sensor_messages.unpack_orientation(message)
        if len(turned[0]) == 0:
            self._mocap_health.refuse(f"no orientation of the body in {self._imu.topic}")
            return
        fix.deviation[:, 1] = turned[2]
        stated = np.where(fix.deviation == 0.0, self._usual, fix.deviation)[0]
        self._ekf.update_pose(stamp_ns, fix.position[0], turned[1][0], stated[:2])

    def _take_twist(self, twist: TwistStream) -> None:
        self._note_velocities([int(twist.time_ns[0])])
        self._ekf.update_velocity(int(twist.time_ns[0]), twist.velocity[0], bool(twist.in_body[0]))


class TransformPublisher:
    """Publishes the estimate on /tf, slower than the IMU: every listener of a machine takes every transform.

    Args:
        node: to publish from; its parameters name the frames and the rate, which is not 0.

    Raises:
        ParameterError: if the package of the messages is not installed.
    """

    def __init__(self, node: SensorNode[EstimatorParameters]) -> None:
        given = node.parameters
        try:
            message_type: Any = message_class(TF_TYPE)
        except AdapterError as error:
            raise ParameterError(f"node {node.get_name()}: parameter `tf_rate_hz`: {error}") from error
        self._period_ns = round(1e9 / given.tf_rate_hz)
        self._period = -1
        self._message = transform_message(given.world_frame, given.body_frame)
        # In no namespace, as tf2 has it: frames carry the vehicle's.
        self._publish = node.announce(message_type, "/tf")

    def publish(self, time_ns: int, pose: Array) -> None:
        """Publish a pose (1, 7), see :func:`transform_message`, if it is the first of its period."""
        period = time_ns // self._period_ns
        if period != self._period:
            self._period = period
            self._message.values[:] = pose
            self._publish(self._message.stamped(time_ns))


def framed_imu(frames: BodyFrames) -> Source:
    """The topic imu, its samples transformed to the body frame."""
    return Source(Imu, IMU_TOPIC, IncomingMessage(sensor_messages.IMU_SAMPLES, frames.imu, frames))


def _reason(outcome: Outcome) -> str:
    return outcome.name.lower().replace("_", " ")


def main() -> int:
    """Run the node in its own process."""
    return run(lambda: serve([EstimatorNode()]))


if __name__ == "__main__":
    raise SystemExit(main())
