# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Monitor node: odometry, imu and rotor speeds in, prediction and extrapolation_alarm out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import Erpm, ExtrapolationAlarm, RotorSpeeds, WrenchPrediction
from sensor_msgs.msg import Imu

from quadpi_core.flight import ImuStream, OdometryStream, RotorSpeedStream, WindStream
from quadpi_core.logs import messages
from quadpi_core.logs.payloads import Payloads
from quadpi_core.models import AerodynamicModel
from quadpi_core.monitor import Monitor, MonitorSettings, Predictions
from quadpi_core.monitor.pairing import TIMEOUT_S, PairedSamples, Pairing
from quadpi_core.vehicle import ROTORS, Vehicle
from quadpi_ros.parameters import parameter, read_parameters
from quadpi_ros.runtime import run, spin
from quadpi_ros.sensor_node import SensorNode

_SETTINGS = MonitorSettings()


@dataclass(frozen=True)
class MonitorParameters:
    """Parameters of the node `monitor`."""

    vehicle: str = parameter("", "vehicle file: a name in config/vehicles or a path")
    model: str = parameter("", "model folder, as `quadpi identify` writes it")
    rotor_topic: str = parameter(
        "rotor_speeds", "topic and type of the rotor speeds to use", choices=("rotor_speeds", "erpm")
    )
    imu_rate_hz: float = parameter(500.0, "nominal rate of the topic imu", limits=(50.0, 5000.0))
    confidence: float = parameter(
        0.0, "nominal coverage of the intervals; 0 takes the model's own", limits=(0.0, 0.9999)
    )
    persistence_s: float = parameter(
        _SETTINGS.persistence_s, "evidence that raises an alarm, in seconds", limits=(0.001, 60.0)
    )
    release_s: float = parameter(
        _SETTINGS.release_s, "absence of evidence that clears an alarm, in seconds", limits=(0.001, 60.0)
    )
    alarm_rate_hz: float = parameter(
        _SETTINGS.alarm_rate_hz, "rate of extrapolation_alarm between changes", limits=(0.1, 1000.0)
    )
    adaptive: bool = parameter(
        _SETTINGS.adaptive, "intervals that adapt to the measured wrench, instead of the model's own"
    )
    pairing_timeout_s: float = parameter(
        TIMEOUT_S, "how long an IMU sample waits for its state and rotor speeds", limits=(0.005, 1.0)
    )
    body_frame: str = parameter(messages.BODY_FRAME, "frame_id of what is published: forward-left-up")


class MonitorNode(SensorNode):
    """`quadpi_core.monitor` between its topics.

    In a process of its own it listens to imu and odometry; the accelerometer bias is then part of the
    measured wrench, as odometry does not carry it. With the estimator in the same process, the estimator
    calls :meth:`take_imu` (bias removed) and :meth:`take_odometry`.

    Args:
        estimator_in_process: do not subscribe to what the estimator hands over.
        shared_with: parameter classes of other nodes in this process.
    """

    def __init__(self, *, estimator_in_process: bool = False, shared_with: tuple[type, ...] = ()) -> None:
        super().__init__("monitor")
        parameters = read_parameters(self, MonitorParameters, shared_with=shared_with)
        vehicle = Vehicle.load(parameters.vehicle)
        if parameters.rotor_topic == "erpm":
            vehicle.rotor_speeds_from_erpm(np.zeros(ROTORS))
        model = AerodynamicModel.load(parameters.model)
        settings = MonitorSettings(
            parameters.persistence_s, parameters.release_s, parameters.alarm_rate_hz, parameters.adaptive
        )
        self._monitor = Monitor(
            model, vehicle, parameters.imu_rate_hz, parameters.confidence or None, settings
        )
        self._pairing = Pairing(parameters.pairing_timeout_s)
        self._body_frame = parameters.body_frame
        self._warm_up(vehicle.gravity_m_s2)

        self._publish_prediction = self.announce(WrenchPrediction, "prediction")
        self._publish_alarm = self.announce(ExtrapolationAlarm, "extrapolation_alarm")
        if not estimator_in_process:
            self.listen(Imu, "imu", messages.unpack_imu, self.take_imu)
            self.listen(Odometry, "odometry", messages.unpack_odometry, self.take_odometry)
        self.listen(Vector3Stamped, "wind", messages.unpack_wind, self._take_wind, required=False)
        if parameters.rotor_topic == "erpm":
            self.listen(
                Erpm, "erpm", lambda payload: messages.unpack_erpm(payload, vehicle), self._take_rotor_speeds
            )
        else:
            self.listen(RotorSpeeds, "rotor_speeds", messages.unpack_rotor_speeds, self._take_rotor_speeds)

    def _warm_up(self, gravity_m_s2: float) -> None:
        """Load every compiled kernel now: the first sample in flight must not wait for it."""
        hover = PairedSamples(
            time_ns=np.zeros(1, dtype=np.int64),
            velocity=np.zeros((1, 3)),
            attitude=np.array([[1.0, 0.0, 0.0, 0.0]]),
            rates=np.zeros((1, 3)),
            specific_force=np.array([[0.0, 0.0, -gravity_m_s2]]),
            rotor_speeds=np.full((1, ROTORS), 1.0),
            wind=np.zeros((1, 3)),
        )
        predictions, alarms = self._monitor.step(*hover)
        self._pack(predictions)
        messages.pack_alarms(alarms)
        self._monitor.reset()

    def take_imu(self, imu: ImuStream) -> None:
        """Take one IMU sample."""
        self._pairing.add_imu(int(imu.time_ns[0]), imu.specific_force[0])
        self._advance()

    def take_odometry(self, odometry: OdometryStream) -> None:
        """Take one state."""
        self._pairing.add_state(
            int(odometry.time_ns[0]), odometry.velocity[0], odometry.attitude[0], odometry.rates[0]
        )
        self._advance()

    def _take_rotor_speeds(self, rotor_speeds: RotorSpeedStream) -> None:
        self._pairing.add_rotor_speeds(int(rotor_speeds.time_ns[0]), rotor_speeds.speeds[0])
        self._advance()

    def _take_wind(self, wind: WindStream) -> None:
        self._pairing.add_wind(int(wind.time_ns[0]), wind.velocity[0])

    def _advance(self) -> None:
        samples = self._pairing.take()
        if samples is None:
            return
        predictions, alarms = self._monitor.step(*samples)
        if len(predictions.time_ns):
            self._publish_all(self._publish_prediction, self._pack(predictions))
        if len(alarms.time_ns):
            self._publish_all(self._publish_alarm, messages.pack_alarms(alarms, self._body_frame))
        if len(predictions.time_ns) < len(samples.time_ns):
            self.warn("IMU samples without a prediction", f"so far {self._pairing.counts}")

    def _pack(self, predictions: Predictions) -> Payloads:
        return messages.pack_predictions(
            predictions,
            model=self._monitor.model.identity,
            confidence=self._monitor.confidence,
            axes=self._monitor.model.axes,
            frame_id=self._body_frame,
        )

    @staticmethod
    def _publish_all(publish: Callable[[bytes], None], payloads: Payloads) -> None:
        for payload in payloads:
            publish(payload)


def main() -> int:
    """Run the node in its own process."""
    return run(lambda: spin([MonitorNode()]))


if __name__ == "__main__":
    raise SystemExit(main())
