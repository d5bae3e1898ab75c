# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Monitor node: odometry, imu and rotor speeds in, prediction and extrapolation_alarm out."""

from __future__ import annotations

import math
import time
import traceback
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
from quadpi.msg import Erpm, RotorSpeeds
from quadpi.srv import LoadModel
from rclpy.clock import ROSClock

from quadpi_core.errors import ModelError, QuadpiError
from quadpi_core.estimator.filter_run import FusedSamples, with_gyro_faults
from quadpi_core.estimator.filter_state import ImuRate
from quadpi_core.flight import (
    MAX_JUMP_BACK_NS,
    NO_STAMP,
    AirStream,
    ImuStream,
    MotorCommandStream,
    OdometryStream,
    RotorSpeedStream,
    WindStream,
)
from quadpi_core.inputs import Air
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.one_by_one import IncomingMessage
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor import Monitor, MonitorSettings
from quadpi_core.monitor.alarm_log import naming_sensors
from quadpi_core.monitor.health import MOTION_CAPTURE, SILENT_S, WATCH_S, Heard, Latency, Silence
from quadpi_core.monitor.monitor import Judged
from quadpi_core.monitor.pairing import CAPACITY, NOTHING, Completed, Judging, Pairing
from quadpi_core.monitor.unsure_states import deviation_of_one
from quadpi_core.paths import resolved_below
from quadpi_core.vehicle import Motors, Vehicle
from quadpi_ros import callbacks
from quadpi_ros.callbacks import SlowService
from quadpi_ros.estimator_node import IMU_TOPIC, EstimatorNode, StateListener, framed_imu
from quadpi_ros.input_sources import AdaptedSources, CommandedRotors, Source, command_sources
from quadpi_ros.parameters import FASTEST_IMU_HZ, MonitorParameters
from quadpi_ros.result_publishers import Results, named
from quadpi_ros.runtime import run, serve
from quadpi_ros.sensor_node import ConsistencyWatch, SensorNode, Watch


class MonitorNode(SensorNode[MonitorParameters]):
    """`quadpi_core.monitor` between its topics.

    In a process of its own it listens to imu and odometry; the accelerometer bias is then part of the
    measured wrench, as odometry does not carry it. An estimator in the same process hands over
    :meth:`take_estimate` directly.

    Args:
        estimator: in the same process.
    """

    def __init__(self, estimator: EstimatorNode | None = None) -> None:
        super().__init__("monitor", MonitorParameters)
        self._estimator = estimator
        self._load_model: SlowService | None = None
        self._commanded: CommandedRotors | None = None
        self._measuring: Monitor | None = None
        self._dropped = self._judged = 0
        self._newest_ns = NO_STAMP
        # Stamps of the state and the rotor speeds that came last, late ones too, as in a replay.
        self._came_ns = [NO_STAMP, NO_STAMP]
        self._silence_watch: Watch | None = None
        self._silence = Silence()
        self._silence_published_s = -math.inf
        self._clock_ns: int | None = None
        self._clock_moved_s = time.monotonic()
        self._rate = ImuRate()
        self._rate_begins = True
        self._rate_problem = ""
        self._said = ""

    def configure(self) -> None:
        """Load the vehicle and the models."""
        parameters = self.parameters
        self._vehicle = Vehicle.load(parameters.vehicle)
        adapted = AdaptedSources(self.get_name(), parameters.adapters, self._vehicle)
        self._rotors = self._rotor_source(adapted)
        self._body = self.frames_of(parameters.body_frame, parameters.frames)
        if self._estimator is None:
            self._imu = adapted.instead_of(framed_imu(self._body), "imu")
            odometry = IncomingMessage(sensor_messages.ODOMETRY_SAMPLES, self._body.world, self._body)
            self._odometry = adapted.instead_of(Source(Odometry, "odometry", odometry), "odometry")
        monitors = named(self._load(path) for path in parameters.model)
        self._commanded, self._measuring = self._commanded_rotors(next(iter(monitors.values()))), None
        for monitor in monitors.values():
            self._require_same_rotors(monitor)
        if self._commanded is not None:
            self._commands = command_sources(adapted, self._commanded.motors, parameters.command_topic)
        self._air_sources = (
            adapted.self_described(parameters.air_topic),
            adapted.self_described("temperature"),
        )
        self._results = Results(
            self, monitors, parameters.body_frame, self._explained, parameters.publish_wrenches
        )

    def activate(self) -> None:
        """Start to listen, with an empty memory."""
        self._restart()
        self._consistency = ConsistencyWatch(self, self._vehicle)
        if self._estimator is None:
            self.hear_transforms(self._body)
            self.listen(*self._imu, self._take_raw_imu, rate_hz=self.parameters.imu_rate_hz or None)
            self.listen(*self._odometry, self.take_odometry)
        else:
            self._estimator.listener = StateListener(
                self.guard("take_imu", self.take_imu), self.guard("take_estimate", self.take_estimate)
            )
        wind = IncomingMessage(sensor_messages.WIND_SAMPLES, self._body.world, self._body)
        self.listen(Vector3Stamped, "wind", wind, self._take_wind, required=False)
        self._air = Air()
        self._results.monitors.fly_in(self._air.density)
        for source in self._air_sources:
            self.listen(*source, self._take_air, required=False)
        self.listen(*self._rotors, self._take_rotor_speeds, required=self._commanded is None)
        if self._commanded is not None:
            commands, battery = self._commands
            self.listen(*commands, self._take_commands, required=self._commanded.fallback is None)
            self.listen(*battery, self._commanded.take_battery, required=False)
        self._load_model = SlowService(self, LoadModel, "~/load_model", self._prepare_model)
        self._silence_watch = self.watch(WATCH_S, self._watch_inputs)

    def deactivate(self) -> None:
        """Stop listening."""
        super().deactivate()
        if self._silence_watch is not None:
            self.unwatch(self._silence_watch)
            self._silence_watch = None
        if self._estimator is not None:
            self._estimator.listener = None
        if self._load_model is not None:
            self._load_model.destroy()
            self._load_model = None

    def parameters_changed(self) -> None:
        """Change the times and rates of the alarm in flight."""
        self._results.monitors.change(self._settings())

    def statuses(self) -> list[DiagnosticStatus]:
        """The models and their alarm, how samples meet, and how long results take."""
        values = asdict(self._pairing.counts) | {"imu_rate": str(self._rate)} | self._latencies()
        dropped, self._dropped = self._pairing.counts.dropped - self._dropped, self._pairing.counts.dropped
        level, message = callbacks.OK, "samples are complete"
        if dropped:
            level, message = callbacks.WARN, f"{dropped} IMU samples without state or rotor speeds in time"
        if self._rate_problem:
            level, message = callbacks.ERROR, self._rate_problem
        alarm_level, alarm, models = self._results.alarm_status()
        judged, self._judged = self._pairing.arrived.judged - self._judged, self._pairing.arrived.judged
        if not judged:
            level = alarm_level = callbacks.STALE
            message = alarm = ", ".join(self._silence.reasons) or "no sample came in the last second"
        told = [] if self._commanded is None else [self._tachometer_status(self._commanded)]
        return [
            *told,
            self.status("alarm", alarm_level, alarm, models),
            self.status("pairing", level, message, values),
            self._consistency.status(),
        ]

    def _tachometer_status(self, rotors: CommandedRotors) -> DiagnosticStatus:
        """Where rotor speeds come from, and tachometers that do not read what the commands give."""
        source = "motor commands" if rotors.counts else "measured"
        sentences = rotors.watch.found(alarm=self._results.alarm_status()[0] != callbacks.OK)
        for sentence in sentences:
            self.warn(sentence, "see its wiring, or the pairs of poles of its speed controller")
        level = callbacks.WARN if sentences or (rotors.counts and rotors.fallback) else callbacks.OK
        return self.status("rotor speeds", level, "; ".join(sentences) or f"from {source}", {"from": source})

    def _latencies(self) -> dict[str, float | str | None]:
        """Since the last status; results that are far from their stamps tell that the clocks differ."""
        simulated_ns = self._simulated_ns()
        ahead_ns = None
        if simulated_ns is None:
            ahead_ns = self.get_clock().now().nanoseconds - time.monotonic_ns()
        latency = self._latency.report(ahead_ns)
        if latency is None:
            return {}
        values: dict[str, float | str | None] = {
            "latency_p50_ms": 1e3 * latency.arrival.median,
            "latency_p99_ms": 1e3 * latency.arrival.p99,
        }
        if latency.stamp is not None:
            values["latency_from_stamp_p50_ms"] = 1e3 * latency.stamp.median
            values["latency_from_stamp_p99_ms"] = 1e3 * latency.stamp.p99
        else:
            other = "use_sim_time" if ahead_ns is None else "stamps are of another clock than this computer's"
            values["latency_from_stamp"] = f"unknown: {other}"
        return values

    def _simulated_ns(self) -> int | None:
        """Time of `/clock`; None where the node does not go by it."""
        clock = self.get_clock()
        if not (isinstance(clock, ROSClock) and clock.ros_time_is_active):
            return None
        return int(clock.now().nanoseconds)

    def take_imu(self, imu: ImuStream) -> None:
        """Take one IMU sample."""
        time_ns = int(imu.time_ns[0])
        self._note_arrival(time_ns)
        self._publish(self._pairing.add_imu(time_ns, imu.specific_force[0], self._judging()))

    def take_estimate(self, sample: FusedSamples) -> None:
        """Take an IMU sample and the state at its stamp."""
        time_ns = int(sample.time_ns[0])
        self._note_arrival(time_ns)
        context = self._results.monitors.sample_context
        context.unsure.take_one(time_ns, *deviation_of_one(sample))
        if self._estimator is not None:
            context.wind_since_ns = self._estimator.slow_since_ns
        self._publish(self._pairing.add_estimate(time_ns, sample.motion, self._judging()))

    def _note_arrival(self, time_ns: int) -> None:
        self.look_at_watches()
        if time_ns < self._newest_ns - MAX_JUMP_BACK_NS:
            self._reset_monitors()
            self._latency.reset()
        self._newest_ns = time_ns
        state_ns, rotors_ns = self._came_ns
        if self._estimator is not None:
            state_ns = self._estimator.mocap_ns
        self._heard.take_one(time_ns, state_ns, rotors_ns)
        self._latency.arrived(time_ns, time.monotonic_ns())

    def _take_raw_imu(self, imu: ImuStream) -> None:
        self.take_imu(with_gyro_faults(imu))

    def take_odometry(self, odometry: OdometryStream) -> None:
        """Take one state."""
        time_ns, (_, attitude, velocity) = int(odometry.time_ns[0]), odometry.stated[0].tolist()
        self._results.monitors.sample_context.unsure.take_one(time_ns, max(velocity, 0.0), max(attitude, 0.0))
        self._came_ns[0] = time_ns
        state = odometry.velocity[0], odometry.attitude[0], odometry.rates[0]
        self._publish(self._pairing.add_state(time_ns, *state, self._judging()))

    def _take_rotor_speeds(self, rotor_speeds: RotorSpeedStream) -> None:
        if self._commanded is not None:
            before = self._commanded.counts
            if not self._commanded.take_measured(rotor_speeds):
                return
            if before and self._measuring is not None and not self._switch(self._measuring):
                return
        self._add_rotor_speeds(rotor_speeds)

    def _take_commands(self, commands: MotorCommandStream) -> None:
        assert self._commanded is not None
        before = self._commanded.counts
        speeds = self._commanded.take_commands(commands)
        if not self._commanded.counts:
            return
        fallback = self._commanded.fallback
        if not before and fallback is not None and not self._switch(fallback):
            return
        self._add_rotor_speeds(speeds)

    def _switch(self, monitor: Monitor) -> bool:
        """Put another monitor in the place of the first, as rotor speeds are silent, or come again.

        Where it cannot fly, the one before goes on by the speeds that it knows; each sample tries again.
        """
        assert self._commanded is not None
        monitor.change(self._settings())
        name = self._results.monitors.names[0]
        if self._commanded.counts:
            self._measuring = self._results.monitors[name]
        try:
            self._results.replace(name, monitor)
        except ModelError as error:
            self._commanded.counts = not self._commanded.counts
            self.warn("rotor speeds", f"are silent or come again, and the model for that cannot fly: {error}")
            return False
        identity = monitor.model.identity
        if self._commanded.counts:
            self.get_logger().warning(
                f"rotor speeds are silent: they are made of motor commands from now on, judged by {identity}"
            )
        else:
            self.get_logger().info(f"rotor speeds come again: they are used, judged by {identity}")
        return True

    def _take_wind(self, wind: WindStream) -> None:
        self._pairing.add_wind(int(wind.time_ns[0]), wind.velocity[0])

    def _take_air(self, air: AirStream) -> None:
        if self._air.hear(float(air.pressure[0]), float(air.celsius[0])):
            self._results.monitors.fly_in(self._air.density)

    def _add_rotor_speeds(self, rotor_speeds: RotorSpeedStream) -> None:
        time_ns, speeds = int(rotor_speeds.time_ns[0]), rotor_speeds.speeds[0]
        self._came_ns[1] = time_ns
        self._publish(self._pairing.add_rotor_speeds(time_ns, speeds, self._judging()))

    def _judging(self) -> Judging:
        """What judges samples as they are completed; None where :meth:`_judge_due` does."""
        if not self._consistency.complete or self._rate_begins:
            return None
        return self._results.monitors.paired(self._pairing)

    def _publish(self, completed: Completed) -> None:
        """Publish what follows from the samples that are complete by now."""
        if completed == NOTHING:
            return
        monitors = self._results.monitors
        judged = monitors.judged(completed) if isinstance(completed, tuple) else self._judge_due()
        if judged is None:
            return
        self._results.publish(judged)
        now_ns, predicted_ns = time.monotonic_ns(), judged.predictions[0].time_ns
        for time_ns in predicted_ns:
            self._latency.published(time_ns, now_ns)

    def _judge_due(self) -> Judged | None:
        """Judge samples that are complete; None where none is to be judged."""
        samples = self._pairing.take()
        if self._pairing.rate is not self._rate:
            self._follow_rate()
        # In the first second the rate of the IMU is measured: nothing can be filtered.
        if samples is None or self._rate_begins:
            return None
        if not self._consistency.complete:
            self._consistency.take(None, *samples)
        return self._results.monitors.judge(samples)

    def _watch_inputs(self) -> None:
        """Raise the alarm while nothing arrives, by this process's clock, at the alarm's rate or slower."""
        now_s, simulated_ns = time.monotonic(), self._simulated_ns()
        if simulated_ns != self._clock_ns:
            self._clock_ns, self._clock_moved_s = simulated_ns, now_s
        self._silence.follow(now_s, self._pairing.arrived)
        since_s = now_s - self._silence_published_s
        if not self._silence.reasons or since_s < 1.0 / self.parameters.alarm_rate_hz - 0.5 * WATCH_S:
            return
        self._silence_published_s = now_s
        time_ns = self.get_clock().now().nanoseconds
        reasons = self._explained(self._silence.reasons, self._newest_ns)
        if self._newest_ns != NO_STAMP:
            time_ns = self._newest_ns + round(1e9 * self._silence.elapsed_s)
        if simulated_ns is not None:
            # The stamps that follow a pause of the simulation go on where those before it ended.
            time_ns = max(self._newest_ns, min(time_ns, simulated_ns))
            if now_s - self._clock_moved_s >= SILENT_S:
                reasons = (*reasons, "/clock stands still")
        self._results.publish_silence(time_ns, reasons)

    def _explained(self, reasons: tuple[str, ...], time_ns: int) -> tuple[str, ...]:
        """Reasons with the sensors that lack at a stamp, and what of a sensor is refused."""
        refused = self.refusals() + (self._estimator.refusals() if self._estimator else ())
        return tuple(dict.fromkeys(naming_sensors((*reasons, *refused), self._heard.lacks(time_ns))))

    def _follow_rate(self) -> None:
        """Design the filters for the rate of the IMU; nothing is predicted without one."""
        rate = self._rate = self._pairing.rate
        self._rate_begins = rate.begins
        problems = [f"topic {IMU_TOPIC}: {rate}: set it to 0"] if rate.differs else []
        problems += self._results.monitors.retune(rate)
        self._rate_problem = "; ".join(problems)
        if problems:
            self.get_logger().error(f"nothing is predicted: {self._rate_problem}")
        elif not rate.begins:
            monitors = self._results.monitors
            models = ", ".join(monitors[name].model.identity for name in monitors.names)
            self._say(f"active: {models}, {IMU_TOPIC} at {rate}")

    def _say(self, text: str) -> None:
        """Log what is so from now on, once: after each pause the rate is measured again."""
        if text != self._said:
            self._said = text
            self.get_logger().info(text)

    def _restart(self) -> None:
        timeout_s, rate_hz = self.parameters.pairing_timeout_s, self.parameters.imu_rate_hz
        # Room for all that may come while a sample waits, or the timeout would be shorter than it says.
        waiting = math.ceil(timeout_s * (rate_hz or FASTEST_IMU_HZ))
        self._pairing = Pairing(timeout_s, max(CAPACITY, 2 * waiting), rate_hz, self._vehicle.rotor_count)
        self._follow_rate()
        self._dropped = self._judged = 0
        self._silence = Silence()
        self._silence_published_s = -math.inf
        self._newest_ns, self._came_ns = NO_STAMP, [NO_STAMP, NO_STAMP]
        self._heard = Heard("odometry" if self._estimator is None else MOTION_CAPTURE)
        self._latency = Latency()
        if self._commanded is not None:
            self._commanded.restart()
        self._reset_monitors()

    def _reset_monitors(self) -> None:
        """Forget the past, also of the one that does not fly while another stands in for it."""
        self._results.monitors.reset()
        fallback = None if self._commanded is None else self._commanded.fallback
        for monitor in (fallback, self._measuring):
            if monitor is not None:
                monitor.reset()

    def _rotor_source(self, adapted: AdaptedSources) -> Source:
        """The topic that the parameters name."""
        topic = self.parameters.rotor_topic
        if topic == "rotor_speeds":
            samples = sensor_messages.rotor_speed_samples(self._vehicle.rotor_count)
            return Source(RotorSpeeds, topic, IncomingMessage(samples))
        if topic == "erpm":
            return Source(Erpm, topic, IncomingMessage(sensor_messages.erpm_samples(self._vehicle)))
        return adapted.named(topic)

    def _commanded_rotors(self, first: Monitor) -> CommandedRotors | None:
        """Rotor speeds by commands, if the first model or the fallback was identified on them.

        Raises:
            ModelError: for a fallback that was not, or without need.
        """
        path = self.parameters.fallback_model
        motors = _motors(first)
        if motors is not None:
            if path:
                raise ModelError(f"{path}: the first model flies by motor commands, and needs no fallback")
            return CommandedRotors(motors)
        if not path:
            return None
        fallback = self._load(path)
        motors = _motors(fallback)
        if motors is None:
            raise ModelError(
                f"{path}: fallback_model: was not identified on motor commands (identify --from-commands)"
            )
        if len(self.parameters.model) > 1:
            raise ModelError(
                f"{path}: fallback_model: takes the place of one model; others would go on by rotor speeds "
                "that they do not know: start a node with them"
            )
        return CommandedRotors(motors, fallback)

    def _require_same_rotors(self, monitor: Monitor) -> None:
        """Refuse a model by other rotor speeds than those that the node pairs.

        Raises:
            ModelError: naming the model.
        """
        rotors = self._commanded
        motors = None if rotors is None or rotors.fallback is not None else rotors.motors
        if _motors(monitor) != motors:
            raise ModelError(
                f"{monitor.model.identity}: its rotor speeds are not those of the first model, measured or "
                "by the same motors: start a node with it"
            )

    def _load(self, path: str) -> Monitor:
        parameters = self.parameters
        return Monitor(
            AerodynamicModel.load(path),
            self._vehicle,
            parameters.imu_rate_hz or None,
            parameters.confidence or None,
            self._settings(),
        )

    def _settings(self) -> MonitorSettings:
        parameters = self.parameters
        return MonitorSettings(
            parameters.persistence_s,
            parameters.release_s,
            parameters.alarm_rate_hz,
            parameters.adaptive,
            parameters.change,
        )

    def _permitted(self, path: str) -> str:
        """The path of a model that a request may name: anyone on the network can ask for any.

        Raises:
            ModelError: for a path outside of the folders of models.
        """
        given = self.parameters.model_folder
        folders = (
            [Path(given)] if given else [Path(model).resolve().parent for model in self.parameters.model]
        )
        # A relative path is below such a folder: nobody on the network knows where this process was started.
        below = [folder / path for folder in folders]
        below = [one for one in below if one.is_dir()] or below
        permitted = resolved_below(below[0], folders)
        if permitted is None:
            listed = " or ".join(str(folder) for folder in dict.fromkeys(folders))
            raise ModelError(f"{path}: lies outside of {listed}: models are loaded from there (model_folder)")
        return str(permitted)

    def _prepare_model(self, request: LoadModel.Request) -> Callable[[LoadModel.Response], None]:
        """Load in the service's thread; gives what is to be done between two samples."""
        monitors = self._results.monitors
        name = request.replaces or monitors.names[0]
        try:
            monitor, error = self._load(self._permitted(request.path)), None
            self._require_same_rotors(monitor)
        except QuadpiError as caught:
            monitor, error = None, str(caught)
        except Exception:
            # Of any kind: the caller is told that the model did not load, and the others fly on.
            self.get_logger().error(traceback.format_exc())
            monitor, error = None, f"{request.path}: cannot be loaded, see the log of the node"

        def swap(response: LoadModel.Response) -> None:
            rotors = self._commanded
            if monitor is not None and rotors is not None and rotors.counts and rotors.fallback is not None:
                self._measuring = monitor
                response.success, response.model = True, monitor.model.identity
                response.message = f"{monitor.model.identity} flies once rotor speeds come again"
            else:
                self._results.swap(name, monitor, error, response)
            # They may have changed while the model was loaded.
            self.parameters_changed()
            self.get_logger().info(response.message)

        return swap


def _motors(monitor: Monitor) -> Motors | None:
    """Those that a model was identified by; None for measured rotor speeds."""
    return None if monitor.model.flown is None else monitor.model.flown.motors


def main() -> int:
    """Run the node in its own process."""
    return run(lambda: serve([MonitorNode()]))


if __name__ == "__main__":
    raise SystemExit(main())
