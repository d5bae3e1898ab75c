# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The live nodes over real DDS, fed by the player from a small bag."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rclpy
from nav_msgs.msg import Odometry
from quadpi.msg import ExtrapolationAlarm, WrenchPrediction

from quadpi_core.flight import AXES, OdometryStream, Recording, TwistStream, WindStream
from quadpi_core.identification.identify import identify
from quadpi_core.identification.prepared_flights import prepare_recording
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bags import output_topic, read_outputs, write_bag
from quadpi_core.messages import result_messages, sensor_messages
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.alarm_limits import AlarmLimits
from quadpi_core.models.envelope import Envelope
from quadpi_core.models.kinds.polynomial import Polynomial
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.models.regressors import load_pools
from quadpi_core.monitor.alarm import Alarm, MonitorSettings
from quadpi_core.monitor.replay import replay
from quadpi_core.paths import bags_directory, config_directory
from quadpi_core.results import LEVEL_ALARM, Alarms, Predictions, ReportedAlarms
from quadpi_core.vehicle import Vehicle
from quadpi_ros import live_session
from quadpi_ros.callbacks import OUTPUT_QOS
from quadpi_ros.live_session import (
    AlarmChange,
    AlarmFollower,
    ChildError,
    Collector,
    SessionError,
    SessionResult,
    await_rest,
    await_start,
    play,
    run_session,
)
from quadpi_ros.parameters import START_TIMEOUT_S
from quadpi_ros.playlist import PlayerError
from test.core.identification.test_found_wind import WINDS, by_gps

from .rig import PATIENCE_S

VEHICLE = "neurobem"
OUTSIDE_FROM_S = 2.3


@pytest.fixture(scope="module")
def heard() -> list[AlarmChange]:
    return []


@pytest.fixture(scope="module")
def session(folder: Path, heard: list[AlarmChange]) -> SessionResult:
    return run_session(folder / "hover.mcap", folder / "model", vehicle=VEHICLE, on_alarm=heard.append)


def test_every_imu_sample_gets_its_prediction(session: SessionResult, hover: Recording) -> None:
    assert session.dropped == 0
    expected = hover.imu.time_ns
    assert len(session.imu_stamps_ns) == len(expected)
    odometry_ns = sensor_messages.unpack_stamps(session.odometry)
    initialised = expected[expected >= odometry_ns[0]]
    np.testing.assert_array_equal(odometry_ns, initialised)
    np.testing.assert_array_equal(session.predictions.time_ns, initialised)
    assert initialised[0] - expected[0] < 1.1e9


def test_what_comes_out_is_finite_and_ordered(session: SessionResult) -> None:
    predictions = session.predictions
    held = [AXES.index("Fx"), AXES.index("Mz")]
    assert (predictions.lower[:, held] < predictions.predicted[:, held]).all()
    assert (predictions.predicted[:, held] < predictions.upper[:, held]).all()
    assert not np.delete(predictions.predicted, held, axis=1).any()
    assert np.isfinite(predictions.measured).all()
    odometry = sensor_messages.unpack_odometry(session.odometry)
    np.testing.assert_allclose(np.linalg.norm(odometry.attitude, axis=1), 1.0)
    assert np.abs(odometry.velocity).max() < 0.5


def test_the_alarm_comes_when_the_rotors_leave_the_envelope(
    session: SessionResult, heard: list[AlarmChange]
) -> None:
    summary = session.summary()
    assert summary["alarm_first_s"] == pytest.approx(OUTSIDE_FROM_S + 0.1, abs=0.1)
    assert 0.1 < summary["alarm_fraction"] < 0.5
    inside = session.alarms.time_ns < session.imu_stamps_ns[0] + 1e9 * (OUTSIDE_FROM_S - 0.1)
    assert (session.alarms.level[inside] < LEVEL_ALARM).all()
    raised = [change for change in heard if change.level == LEVEL_ALARM]
    assert raised
    assert "extrapolation" in raised[0].causes
    assert "omega_avg" in raised[0].inputs_outside
    assert "ALARM" in str(raised[0])


def test_the_summary_counts(session: SessionResult) -> None:
    summary = session.summary()
    assert summary["samples_in"] == len(session.imu_stamps_ns) == 1500
    assert summary["predictions_out"] == len(session.predictions.time_ns)
    assert 0.0 < summary["latency_ms_p50"] <= summary["latency_ms_p99"]


def assert_same(live: Any, replayed: Any) -> None:
    for item in fields(replayed):
        of_live, of_replay = getattr(live, item.name), getattr(replayed, item.name)
        if isinstance(of_replay, list):
            assert of_live == of_replay
        else:
            np.testing.assert_allclose(of_live, of_replay, rtol=1e-9, atol=1e-12)


def assert_live_equals_replay(
    session: SessionResult, model: Path, vehicle: str, bag: Path, settings: MonitorSettings | None = None
) -> None:
    output = bag.with_name(f"{bag.stem}_replayed.mcap")
    replay(AerodynamicModel.load(model), Vehicle.load(vehicle), bag, output, settings=settings)
    predictions, alarms = read_outputs(output)
    assert_same(session.predictions, predictions)
    assert_same(session.alarms, alarms)
    # Whole messages, the covariances too: the estimator's steps are the same, bit for bit.
    with Bag(output) as replayed:
        assert list(session.odometry) == list(replayed.read(["/odometry"])["/odometry"].payloads)


def test_live_equals_replay(session: SessionResult, folder: Path) -> None:
    assert_live_equals_replay(session, folder / "model", VEHICLE, folder / "hover.mcap")


def test_live_equals_replay_in_what_it_says_while_a_sensor_lacks(
    folder: Path, hover: Recording, tmp_path: Path
) -> None:
    bag, stamps = tmp_path / "lacking.mcap", hover.rotor_speeds.time_ns
    since_ns = stamps - stamps[0] - 1_300_000_000
    speeds = hover.rotor_speeds.take((since_ns < 0) | (since_ns > 1_000_000_000))
    write_bag(bag, replace(hover, rotor_speeds=speeds))
    session = run_session(bag, folder / "model", vehicle=VEHICLE)
    assert_live_equals_replay(session, folder / "model", VEHICLE, bag)
    said = {text for words in session.alarms.reasons for text in words}
    assert "no rotor speeds for 0.8 s" in said


def moving(hover: Recording, in_body: bool) -> TwistStream:
    """Velocities as motion capture would have them of a vehicle that stands, nearly."""
    rng = np.random.default_rng(3)
    time_ns = hover.pose.time_ns
    noise = 0.01 * rng.standard_normal((len(time_ns), 3))
    return TwistStream(time_ns, noise, np.full(len(time_ns), in_body))


def test_live_equals_replay_with_erpm_odometry_wind_and_adaptive_intervals(
    folder: Path, hover: Recording, tmp_path: Path
) -> None:
    vehicle = tmp_path / f"{VEHICLE}.yaml"
    described = (config_directory() / "vehicles" / vehicle.name).read_text()
    vehicle.write_text(described.replace("pole_pairs: null", "pole_pairs: 7"))
    erpm = np.rint(hover.rotor_speeds.speeds * 7 * 60.0 / (2.0 * np.pi))
    twist = moving(hover, in_body=True)
    pose_ns = hover.pose.time_ns
    odometry = OdometryStream(
        pose_ns, hover.pose.position, hover.pose.attitude, twist.velocity, np.zeros((len(pose_ns), 3))
    )
    stamps = hover.imu.time_ns[::100]
    wind = np.column_stack((np.linspace(0.0, 2.0, len(stamps)), np.ones((len(stamps), 2))))
    bag = tmp_path / "other_inputs.mcap"
    rotor_ns = hover.rotor_speeds.time_ns
    write_bag(
        bag,
        replace(hover, rotor_speeds=None, pose=None, wind=WindStream(stamps, wind)),
        (
            output_topic("erpm", rotor_ns, sensor_messages.pack_erpm(rotor_ns, erpm)),
            output_topic("mocap/odometry", pose_ns, sensor_messages.pack_odometry(odometry)),
        ),
    )
    session = run_session(bag, folder / "model", vehicle=str(vehicle), parameters={"adaptive": True})
    assert session.dropped == 0
    settings = MonitorSettings(adaptive=True)
    assert_live_equals_replay(session, folder / "model", str(vehicle), bag, settings)


def test_live_equals_replay_with_velocities_alone(folder: Path, hover: Recording, tmp_path: Path) -> None:
    """In the world's axes, and from half of the flight on in those of the body: the frame of each says so."""
    bag = tmp_path / "velocities.mcap"
    twist = moving(hover, in_body=False)
    in_body = np.arange(len(twist)) > len(twist) // 2
    write_bag(bag, replace(hover, pose=None, twist=replace(twist, in_body=in_body)))
    session = run_session(bag, folder / "model", vehicle=VEHICLE)
    assert session.dropped == 0
    assert_live_equals_replay(session, folder / "model", VEHICLE, bag)


@pytest.mark.slow
def test_live_equals_replay_with_a_physical_model(physical_folder: Path, tmp_path: Path) -> None:
    """In a flight of 20 s at angles of up to 40 degrees; all six axes, and rotor accelerations."""
    bag = tmp_path / "flight.mcap"
    bag.write_bytes((bags_directory() / "interpolation.mcap").read_bytes())
    session = run_session(bag, physical_folder, vehicle="bebop2")
    assert session.dropped == 0
    assert session.predictions.predicted.any(axis=0).all()
    assert_live_equals_replay(session, physical_folder, "bebop2", bag)


@pytest.mark.slow
def test_live_equals_replay_in_a_wind_that_drag_tells(tmp_path: Path) -> None:
    """Flights by GPS: two teach model and drag, of the third half a minute is flown live.

    Its rotor speeds come at a fifth of the IMU's rate, so that samples wait as the wind begins to be sought.
    """
    *learned, flown = (by_gps(tmp_path, wind, seed) for seed, wind in enumerate(WINDS))
    vehicle = Vehicle.load("bebop2")
    prepared = [prepare_recording(one, vehicle, 30.0) for one in learned]
    options = IdentifyOptions(method=Polynomial())
    model = identify(prepared, vehicle, load_pools("quadrotor"), options)
    assert model.wind is not None
    model.save(tmp_path / "model")
    begin_ns = flown.imu.time_ns[0]
    part = {name: getattr(flown, name) for name in ("imu", "rotor_speeds", "odometry")}
    cut = {name: own.take(own.time_ns < begin_ns + 30_000_000_000) for name, own in part.items()}
    cut["rotor_speeds"] = cut["rotor_speeds"].take(slice(None, None, 5))
    bag, state = tmp_path / "windy.mcap", cut["odometry"]
    packed = output_topic("mocap/odometry", state.time_ns, sensor_messages.pack_odometry(state))
    write_bag(bag, replace(flown, **cut | {"odometry": None}), (packed,))
    session = run_session(bag, tmp_path / "model", vehicle="bebop2")
    assert_live_equals_replay(session, tmp_path / "model", "bebop2", bag)
    widths = (session.predictions.upper - session.predictions.lower)[:, 0]
    # Intervals of Fx are wider until the wind is told, once five velocities have shown that it is to be.
    assert np.median(widths[500:700]) > 2.0 * np.median(widths[-5000:])


@pytest.mark.usefixtures("ros_domain")
def test_nodes_in_processes_of_their_own(folder: Path, hover: Recording) -> None:
    monitor = {"vehicle": VEHICLE, "model": folder / "model"}
    # A busy machine may hold the estimator up for longer than a vehicle's may.
    monitor |= {"pairing_timeout_s": 1.0}
    nodes = {
        "estimator_node": ["-p", f"vehicle:={VEHICLE}"],
        "monitor_node": [part for name, value in monitor.items() for part in ("-p", f"{name}:={value}")],
    }
    children = [
        subprocess.Popen([sys.executable, "-m", f"quadpi_ros.{module}", "--ros-args", *arguments])
        for module, arguments in nodes.items()
    ]

    def ended() -> list[int]:
        return [status for status in (child.poll() for child in children) if status is not None]

    last_ns = hover.imu.time_ns[-1]
    try:
        with Collector(int(hover.imu.time_ns[0])) as collector:
            collector.spin_until(lambda: ended() or collector.connected, START_TIMEOUT_S)
            assert collector.connected, ended()
            played = ("--topics", "imu", "rotor_speeds", "mocap/pose", "--nodes", "estimator", "monitor")
            waits = ("--wait", str(START_TIMEOUT_S))
            player = subprocess.Popen(
                [sys.executable, "-m", "quadpi_ros.player", str(folder / "hover.mcap"), *played, *waits]
            )
            children.append(player)
            collector.spin_until(lambda: bool(ended()))
            assert player.poll() == 0
            collector.spin_until(lambda: last_ns in collector.predictions().time_ns, 60.0)
            predictions = collector.predictions()
            odometry_ns = sensor_messages.unpack_stamps(collector.odometry())
    finally:
        for child in children:
            child.terminate()
    assert [child.wait(10.0) for child in children] == [0, 0, 0]
    np.testing.assert_array_equal(odometry_ns, hover.imu.time_ns[hover.imu.time_ns >= odometry_ns[0]])
    np.testing.assert_array_equal(predictions.time_ns, odometry_ns)


def test_a_missing_model_is_one_line_and_leaves_nothing_behind(folder: Path) -> None:
    before = dict(os.environ)
    with pytest.raises(ChildError, match="no_such_model") as caught:
        run_session(folder / "hover.mcap", folder / "no_such_model", vehicle=VEHICLE)
    assert "\n" not in str(caught.value)
    assert os.environ == before


def test_a_bag_without_mocap_is_refused(folder: Path) -> None:
    with pytest.raises(PlayerError, match=r"blind\.mcap: topic mocap/pose"):
        run_session(folder / "blind.mcap", folder / "model", vehicle=VEHICLE)


def test_a_flight_too_short_for_the_estimator_gives_no_prediction_and_says_so(
    folder: Path, hover: Recording, tmp_path: Path
) -> None:
    end_ns = hover.imu.time_ns[0] + 800_000_000
    streams = {name: getattr(hover, name) for name in ("imu", "rotor_speeds", "pose")}
    cut = {name: stream.take(stream.time_ns < end_ns) for name, stream in streams.items()}
    bag = tmp_path / "short.mcap"
    write_bag(bag, replace(hover, **cut))
    with pytest.raises(SessionError, match=r"short\.mcap: no prediction came; the estimator needs a second"):
        run_session(bag, folder / "model", vehicle=VEHICLE)


class Ended:
    """Nodes that have ended, or run on."""

    def __init__(self, *, ended: bool) -> None:
        self.ended = ended

    def finished(self) -> bool:
        return self.ended


@pytest.mark.usefixtures("ros_domain")
def test_nodes_that_do_not_start_or_end_too_early_are_an_error(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_session, "START_TIMEOUT_S", 0.2)
    bag, topics = folder / "hover.mcap", ("imu", "rotor_speeds", "mocap/pose")
    with Collector(0) as collector:
        for ended in (False, True):
            with pytest.raises(SessionError, match=r"did not start within 0\.2 s"):
                await_start(Ended(ended=ended), collector)
        with pytest.raises(SessionError, match="ended before the flight did"):
            play(bag, topics, 1.0, tmp_path, Ended(ended=True), collector)
        with pytest.raises(SessionError, match="ended before the flight did"):
            await_rest(Ended(ended=True), collector, 0)


# What the live nodes publish, kept and told while it comes.


def silent_alarm() -> Alarms:
    """An alarm that reports silence, at the stamp 0."""
    each, six = np.ones(len(INPUT_NAMES)), np.ones(len(AXES))
    envelope = Envelope(-each, each, each, six, six, six, six)
    return Alarm(envelope, AlarmLimits(), MonitorSettings()).without_sample(0)


def alarm_message(time_ns: int, *, of_sample: bool) -> bytes:
    """A message of an alarm by the data: of a sample, or of silence."""
    silent = silent_alarm()
    health = 0 * silent.cause_health if of_sample else silent.cause_health
    alarm = replace(silent, time_ns=np.array([time_ns]), cause_health=health)
    return bytes(result_messages.pack_alarms(alarm, [()])[0])


def test_alarm_follower_tells_changes_from_repetition() -> None:
    def alarm(time_s: float, level: int, *inputs: str) -> Any:
        return SimpleNamespace(
            time_ns=[round(time_s * 1e9)],
            level=[level],
            causes=[1 if level else 0],
            inputs_outside=[inputs],
            envelope_distance=[0.1],
        )

    follower = AlarmFollower(start_ns=0)
    rows: list[ReportedAlarms] = [
        alarm(0.0, 0),
        alarm(0.1, 1, "u"),
        alarm(0.2, 2, "u"),
        alarm(0.3, 2, "u"),
        alarm(0.4, 2, "p", "u"),
        alarm(0.5, 2, "p"),
        alarm(0.6, 0),
        alarm(0.7, 0, "u"),
    ]
    changes = [follower.follow(row) for row in rows]
    assert [change is not None for change in changes] == [False, True, True, False, True, False, True, False]
    assert changes[4].time_s == pytest.approx(0.4)
    assert changes[4].inputs_outside == ("p", "u")


@pytest.mark.parametrize(
    ("inputs", "text"),
    [
        ((), "   2.50 s  ALARM   extrapolation, bad data"),
        (("u", "p"), "   2.50 s  ALARM   extrapolation, bad data: u, p, 12% out"),
        (("u", "p", "q", "r", "w"), "   2.50 s  ALARM   extrapolation, bad data: u, p, q +2, 12% out"),
    ],
)
def test_a_change_is_one_line_that_names_three_inputs(inputs: tuple[str, ...], text: str) -> None:
    assert str(AlarmChange(2.5, 2, ("extrapolation", "bad data"), inputs, 0.12)) == text


@pytest.mark.usefixtures("ros")
def test_what_is_published_is_kept_as_it_came_and_alarms_are_told_at_once() -> None:
    sender = rclpy.create_node("sender")
    kinds = {"odometry": Odometry, "prediction": WrenchPrediction, "extrapolation_alarm": ExtrapolationAlarm}
    told: list[AlarmChange] = []
    rng = np.random.default_rng(2)
    stamp, three = np.array([2_000_000_000]), rng.normal(size=(1, 3))
    level = np.array([[1.0, 0.0, 0.0, 0.0]])
    odometry = sensor_messages.pack_odometry(OdometryStream(stamp, three, level, three, three))
    predictions = Predictions(stamp, *rng.normal(size=(5, 1, 6)))
    prediction = result_messages.pack_predictions(
        predictions, model="m", confidence=0.9, axes=AXES, frame_id="b"
    )
    with Collector(1_500_000_000, told.append) as collector:
        publishers: dict[str, Any] = {}
        for topic, kind in kinds.items():
            assert not collector.connected
            publishers[topic] = sender.create_publisher(kind, topic, OUTPUT_QOS)
            assert collector.spin_until(lambda topic=topic: collector.hears(topic), PATIENCE_S)
        assert collector.connected
        assert not collector.spin_until(lambda: False, 0.1)
        for publisher in publishers.values():
            assert collector.spin_until(lambda one=publisher: one.get_subscription_count() > 0, PATIENCE_S)

        publishers["odometry"].publish(odometry[0])
        publishers["prediction"].publish(prediction[0])
        publishers["extrapolation_alarm"].publish(alarm_message(stamp[0] - 10, of_sample=False))
        assert collector.spin_until(lambda: collector.silent_ns is not None, PATIENCE_S)
        assert told == []
        publishers["extrapolation_alarm"].publish(alarm_message(stamp[0], of_sample=True))
        assert collector.spin_until(lambda: bool(told), PATIENCE_S)
        assert collector.spin_until(lambda: len(collector.odometry()) > 0, PATIENCE_S)
        assert collector.spin_until(lambda: len(collector.arrived_ns) > 0, PATIENCE_S)
    assert (told[0].time_s, told[0].level, told[0].causes) == (0.5, 2, ("bad data",))
    assert collector.silent_ns is None
    assert list(collector.odometry()) == list(odometry)
    assert collector.alarms().time_ns.tolist() == stamp.tolist()
    np.testing.assert_array_equal(collector.predictions().measured, predictions.measured)
    sender.destroy_node()
