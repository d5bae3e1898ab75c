# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import tracemalloc
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.swings import write_long_bag
from quadpi_core import reading_options
from quadpi_core.errors import LogError, ModelError, SignalError
from quadpi_core.estimator.ekf import Ekf
from quadpi_core.flight import ImuStream, OdometryStream, PoseStream, Recording, RotorSpeedStream, WindStream
from quadpi_core.logs import bag_files
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import read_bag, read_outputs, recording_topics, write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.payloads import Payloads, join_topics
from quadpi_core.monitor import replay as replay_module
from quadpi_core.monitor.alarm import MonitorSettings
from quadpi_core.monitor.monitor import Monitor, Monitors
from quadpi_core.monitor.pairing import NOTHING, PairedSamples, Pairing
from quadpi_core.monitor.replay import recorded_flight, replay, replay_all
from quadpi_core.parallel import Workers
from quadpi_core.results import BAD_DATA, EXTRAPOLATION, LEVEL_ALARM, NOT_BEGUN, SETTLES, WHY_NOT_JUDGED

RATE_HZ = 500.0
START_NS = 1_700_000_000_000_000_000
FX = 0


def stamps(seconds: float, rate_hz: float, offset_s: float = 0.0) -> np.ndarray:
    return START_NS + np.round((offset_s + np.arange(0.0, seconds, 1.0 / rate_hz)) * 1e9).astype(np.int64)


@pytest.fixture(scope="module")
def with_odometry(samples) -> Recording:
    """The flight of `samples`, its state known; rotor speeds between the IMU's stamps."""
    count = len(samples.time_ns)
    return Recording(
        name="swings",
        vehicle="neurobem",
        source="swings",
        imu=ImuStream(samples.time_ns, samples.rates, samples.specific_force),
        rotor_speeds=RotorSpeedStream(samples.time_ns - 700_000, samples.rotor_speeds),
        odometry=OdometryStream(
            samples.time_ns, np.zeros((count, 3)), samples.attitude, samples.velocity, samples.rates
        ),
    )


@pytest.fixture(scope="module")
def with_pose(vehicle) -> Recording:
    """Level swings from side to side, seen by IMU and motion capture."""
    rng = np.random.default_rng(5)
    imu_ns, pose_ns, rotor_ns = stamps(6.0, RATE_HZ), stamps(6.0, 120.0, 0.001), stamps(6.0, 400.0, 0.0004)
    phase = 2.0 * (imu_ns - START_NS) * 1e-9
    specific_force = np.zeros((len(imu_ns), 3))
    specific_force[:, 0] = -2.0 * np.sin(phase)
    specific_force[:, 2] = -vehicle.gravity_m_s2
    position = np.zeros((len(pose_ns), 3))
    position[:, 0] = 0.5 * np.sin(2.0 * (pose_ns - START_NS) * 1e-9)
    return Recording(
        name="level",
        vehicle="neurobem",
        source="level",
        imu=ImuStream(
            imu_ns,
            0.02 * rng.standard_normal((len(imu_ns), 3)),
            specific_force + 0.3 * rng.standard_normal(specific_force.shape),
        ),
        rotor_speeds=RotorSpeedStream(rotor_ns, 1100.0 + 20.0 * rng.standard_normal((len(rotor_ns), 4))),
        pose=PoseStream(
            pose_ns,
            position + 0.002 * rng.standard_normal(position.shape),
            np.tile([1.0, 0.0, 0.0, 0.0], (len(pose_ns), 1)),
        ),
    )


@pytest.fixture
def bag_of(tmp_path):
    def write(recording: Recording):
        path = tmp_path / f"{recording.name}.mcap"
        write_bag(path, recording)
        return path

    return write


def test_replay_gives_what_the_monitor_gives(model, vehicle, samples, with_odometry, bag_of, tmp_path):
    summary = replay(model, vehicle, bag_of(with_odometry), tmp_path / "out.mcap")
    predictions, alarms = read_outputs(tmp_path / "out.mcap")

    rotor_ns = samples.time_ns - 700_000
    speeds = np.stack(
        [
            np.interp(samples.time_ns - START_NS, rotor_ns - START_NS, column)
            for column in samples.rotor_speeds.T
        ],
        axis=1,
    )
    paired = PairedSamples(samples.time_ns, samples.values.copy())
    paired.rotor_speeds[:] = speeds
    # In the first second the rate of the IMU is measured.
    measured = slice(round(RATE_HZ), -1)
    expected, _, _ = Monitor(model, vehicle, RATE_HZ).step(*(column[measured] for column in paired))
    for field in fields(expected):
        np.testing.assert_allclose(
            getattr(predictions, field.name), getattr(expected, field.name), rtol=1e-9, atol=1e-9
        )
    assert summary.samples_in == len(samples.time_ns)
    assert summary.predictions_out == len(samples.time_ns) - 1 - round(RATE_HZ)
    assert summary.dropped == 0
    assert summary.alarm_first_s is None
    assert summary.alarm_fraction == 0.0
    assert not alarms.level.any()
    # The second in which the rate is measured, and that in which the state settles.
    assert summary.not_judged_fraction == pytest.approx(0.2, abs=0.001)
    reasons = {part.reason: part.fraction for part in summary.not_judged_reasons}
    assert reasons == pytest.approx({NOT_BEGUN: 0.1, WHY_NOT_JUDGED[SETTLES]: 0.1}, abs=0.001)


def test_an_hour_without_samples_is_no_flight(model, vehicle, with_odometry, bag_of, tmp_path):
    """Three samples of the IMU stamped before its clock was set must not make the rest a thousandth."""
    imu_ns = with_odometry.imu.time_ns.copy()
    imu_ns[:3] -= 3600 * 10**9
    bag = bag_of(replace(with_odometry, imu=replace(with_odometry.imu, time_ns=imu_ns)))
    summary = replay(model, vehicle, bag, tmp_path / "out.mcap")
    # The pause counts as one second more, of eleven.
    assert summary.not_judged_fraction == pytest.approx(3.0 / 11.0, abs=0.005)


def test_the_same_bytes_each_time(each_model, vehicle, with_pose, bag_of, tmp_path):
    bag = bag_of(with_pose)
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    replay(each_model, vehicle, bag, first)
    replay(each_model, vehicle, bag, second)
    assert first.read_bytes() == second.read_bytes()


def cut(recording: Recording, seconds: float) -> Recording:
    """The first seconds of a recording."""
    return replace(
        recording,
        **{
            name: type(stream)(
                *(
                    getattr(stream, column.name)[stream.time_ns < START_NS + seconds * 1e9]
                    for column in fields(stream)
                )
            )
            for name in ("imu", "rotor_speeds", "pose", "odometry")
            if (stream := getattr(recording, name)) is not None
        },
    )


def set_back(recording: Recording, after_s: float, by_s: float, path: Path) -> Path:
    """A bag whose recorder's clock went on while those of the sensors were set back."""
    topics = []
    for topic in recording_topics(recording):
        stamps = topic.log_time_ns - np.where(
            topic.log_time_ns < START_NS + after_s * 1e9, 0, int(by_s * 1e9)
        )
        rows = topic.payloads.rows(np.arange(len(stamps)), int(topic.payloads.lengths[0])).copy()
        # Seconds and nanoseconds follow the four bytes of the encapsulation.
        rows[:, 4:12] = np.stack(np.divmod(stamps, 10**9), axis=1).astype("<u4").view(np.uint8)
        topics.append(replace(topic, payloads=Payloads.from_rows(rows)))
    write_mcap(path, topics, {"vehicle": recording.vehicle})
    return path


@pytest.fixture
def odd_bag(with_pose, tmp_path) -> Path:
    """Six seconds in which a sample of the IMU is none, rotor speeds pause and the clock is set back."""
    imu, rotors = with_pose.imu, with_pose.rotor_speeds
    force = imu.specific_force.copy()
    force[700, 1] = np.nan
    kept = np.r_[0:700, 900 : len(rotors)]
    odd = replace(
        with_pose,
        imu=replace(imu, specific_force=force),
        rotor_speeds=RotorSpeedStream(rotors.time_ns[kept], rotors.speeds[kept]),
    )
    return set_back(odd, 3.5, 2.2, tmp_path / "odd.mcap")


@pytest.fixture
def same_in_blocks(vehicle, tmp_path, monkeypatch):
    """same_in_blocks(model, flight, messages, …): replay in blocks of that many writes the same bytes."""
    settings = MonitorSettings(adaptive=True)

    def replayed(model, flight, size):
        monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", size)
        output = tmp_path / f"blocks{size}.mcap"
        return replay(model, vehicle, flight, output, settings=settings), output.read_bytes()

    def check(model, flight, *sizes):
        whole = replayed(model, flight, 10**6)
        for size in sizes:
            assert replayed(model, flight, size) == whole

    return check


def test_the_bytes_do_not_depend_on_the_blocks(each_model, with_pose, odd_bag, bag_of, same_in_blocks):
    same_in_blocks(each_model, bag_of(cut(with_pose, 1.3)), 1)
    same_in_blocks(each_model, odd_bag, 1000)


@pytest.mark.parametrize("each_model", ["physical"], indirect=True)
def test_what_is_odd_at_the_border_of_blocks(each_model, odd_bag, same_in_blocks):
    """Of the model whose rotor speeds have a past of their own, in blocks that begin everywhere."""
    same_in_blocks(each_model, odd_bag, 7)


def test_a_clock_that_is_set_back_keeps_what_was_before(model, vehicle, odd_bag, tmp_path):
    summary = replay(model, vehicle, odd_bag, tmp_path / "out.mcap")
    assert summary.events > 0  # the pause of the rotor speeds
    with Bag(tmp_path / "out.mcap") as bag:
        blocks = list(bag.blocks(["/odometry", "/prediction"]))
    stamps = {
        name: sensor_messages.unpack_stamps(join_topics([block[name] for block in blocks]).payloads)
        for name in ("/odometry", "/prediction")
    }
    # The estimator begins anew: 1.3 s after the clock was set back come again.
    assert np.sum(stamps["/odometry"] < START_NS + 2.3e9) == pytest.approx(650, abs=3)
    assert len(stamps["/odometry"]) == pytest.approx(2 * RATE_HZ * (3.5 - 1.0 + 2.5 - 1.0) / 2, abs=5)
    assert np.isin(stamps["/prediction"], stamps["/odometry"]).all()


@pytest.mark.parametrize("samples", [7, 1000])
def test_blocks_of_a_log_are_followed_like_those_of_its_bag(
    model, vehicle, with_pose, bag_of, tmp_path, monkeypatch, samples
):
    """Logs that are no bags are read whole: what arrived when follows from the stamps."""
    bag = bag_of(with_pose)
    replay(model, vehicle, bag, tmp_path / "bag.mcap")
    monkeypatch.setattr(reading_options, "BLOCK_SAMPLES", samples)
    recording = read_bag(bag, vehicle)

    @contextmanager
    def whole(_path, _vehicle, _part):
        yield recorded_flight(replace(recording, arrivals={}), vehicle)

    monkeypatch.setattr(replay_module, "open_flight", whole)
    replay(model, vehicle, bag, tmp_path / "log.mcap")
    assert (tmp_path / "log.mcap").read_bytes() == (tmp_path / "bag.mcap").read_bytes()


def test_memory_does_not_grow_with_the_flight(model, vehicle, tmp_path):
    peaks = []
    lengths_s = (40.0, 80.0)
    for seconds in lengths_s:
        bag = tmp_path / "long.mcap"
        write_long_bag(bag, vehicle, seconds)
        tracemalloc.start()
        summary = replay(model, vehicle, bag, tmp_path / "out.mcap")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert summary.predictions_out == pytest.approx((seconds - 1.0) * RATE_HZ, abs=5)
    # Of a flight are kept the stamps of its IMU and the alarm's levels: 8 and 0.2 bytes per sample.
    assert peaks[1] - peaks[0] < 60 * np.diff(lengths_s) * RATE_HZ


def test_leaving_the_envelope_is_in_the_bag_and_the_summary(model, vehicle, with_odometry, bag_of, tmp_path):
    odometry = with_odometry.odometry
    velocity = odometry.velocity.copy()
    velocity[2500:3500, 0] += 15.0
    bag = bag_of(replace(with_odometry, odometry=replace(odometry, velocity=velocity)))
    summary = replay(model, vehicle, bag, tmp_path / "out.mcap")
    _, alarms = read_outputs(tmp_path / "out.mcap")

    assert summary.alarm_first_s == pytest.approx(5.13, abs=0.05)
    assert summary.alarm_fraction == pytest.approx(0.24, abs=0.03)
    raised = int(np.argmax(alarms.level == LEVEL_ALARM))
    assert alarms.causes[raised] == EXTRAPOLATION
    assert {"u", "mu_x"} <= set(alarms.inputs_outside[raised])
    assert alarms.envelope_distance[raised] > 0.5


@pytest.mark.parametrize(
    "settings", [MonitorSettings(), MonitorSettings(adaptive=True)], ids=["own", "adaptive"]
)
def test_replay_equals_the_live_path_sample_by_sample(
    each_model, vehicle, with_pose, bag_of, tmp_path, settings
):
    replay(each_model, vehicle, bag_of(with_pose), tmp_path / "out.mcap", settings=settings)
    replayed, _ = read_outputs(tmp_path / "out.mcap")

    recording = read_bag(tmp_path / "level.mcap", vehicle)
    imu, pose, rotors = recording.imu, recording.pose, recording.rotor_speeds
    ekf, pairing = Ekf(vehicle, RATE_HZ), Pairing()
    monitors = Monitors({"model": Monitor(each_model, vehicle, RATE_HZ, settings=settings)})
    order = sorted(
        [(t, 0, i) for i, t in enumerate(imu.time_ns)]
        + [(t, 1, i) for i, t in enumerate(pose.time_ns)]
        + [(t, 2, i) for i, t in enumerate(rotors.time_ns)]
    )
    live = []
    for time_ns, kind, i in order:
        by, completed = None if pairing.rate.begins else monitors.paired(pairing), NOTHING
        if kind == 0:
            estimate = ekf.step(int(time_ns), imu.angular_velocity[i], imu.specific_force[i]).fused
            if estimate is not None:
                state = estimate.odometry
                pairing.add_imu(int(time_ns), estimate.imu.specific_force[0])
                motion = state.velocity[0], state.attitude[0], state.rates[0]
                completed = pairing.add_state(int(time_ns), *motion, by)
            else:
                completed = pairing.add_imu(int(time_ns), imu.specific_force[i], by)
        elif kind == 1:
            ekf.update_pose(int(time_ns), pose.position[i], pose.attitude[i])
        else:
            completed = pairing.add_rotor_speeds(int(time_ns), rotors.speeds[i], by)
        judged = monitors.judged(completed) if isinstance(completed, tuple) else None
        if judged is None:
            paired = pairing.take()
            if paired is not None and not pairing.rate.begins:
                judged = monitors.judge(paired)
        if judged is not None:
            # The next ones overwrite them.
            live.append(deepcopy(judged.predictions[0]).predictions)

    for field in fields(replayed):
        joined = np.concatenate([getattr(predictions, field.name) for predictions in live])
        np.testing.assert_array_equal(getattr(replayed, field.name), joined)
    assert len(replayed.time_ns) > 2400


def test_a_spike_of_the_imu_is_reported_and_leaves_the_rest_as_it_was(
    model, vehicle, with_pose, bag_of, tmp_path
):
    replay(model, vehicle, bag_of(with_pose), tmp_path / "out.mcap")
    expected, _ = read_outputs(tmp_path / "out.mcap")
    spike = 2000
    specific_force = with_pose.imu.specific_force.copy()
    specific_force[spike, 2] = -1e30
    imu = replace(with_pose.imu, specific_force=specific_force)
    summary = replay(model, vehicle, bag_of(replace(with_pose, imu=imu)), tmp_path / "out.mcap")
    predictions, alarms = read_outputs(tmp_path / "out.mcap")
    assert summary.dropped == 1
    assert set(expected.time_ns) - set(predictions.time_ns) == {imu.time_ns[spike]}
    kept = np.isin(expected.time_ns, predictions.time_ns)
    np.testing.assert_allclose(predictions.predicted, expected.predicted[kept], atol=0.05)
    reported = int(np.flatnonzero(alarms.causes & BAD_DATA)[0])
    assert alarms.time_ns[reported] == imu.time_ns[spike]


def test_estimated_odometry_is_in_the_bag(model, vehicle, with_pose, bag_of, tmp_path):
    replay(model, vehicle, bag_of(with_pose), tmp_path / "out.mcap")
    predictions, _ = read_outputs(tmp_path / "out.mcap")
    with Bag(tmp_path / "out.mcap") as bag:
        estimated = sensor_messages.unpack_odometry(bag.read(["/odometry"])["/odometry"].payloads)
    time = (estimated.time_ns - START_NS) * 1e-9
    settled = time > 3.0
    np.testing.assert_allclose(estimated.velocity[settled, 0], np.cos(2.0 * time[settled]), atol=0.1)
    # The first second initialises the estimator.
    assert 0.99 < (predictions.time_ns[0] - START_NS) * 1e-9 < 1.02


def test_pause_of_the_rotor_speeds_is_bad_data(model, vehicle, with_odometry, bag_of, tmp_path):
    rotors = with_odometry.rotor_speeds
    kept = np.r_[0:2000, 2150 : len(rotors)]
    bag = bag_of(
        replace(with_odometry, rotor_speeds=RotorSpeedStream(rotors.time_ns[kept], rotors.speeds[kept]))
    )
    summary = replay(model, vehicle, bag, tmp_path / "out.mcap")
    predictions, alarms = read_outputs(tmp_path / "out.mcap")
    # Nothing is interpolated across the 0.3 s without rotor speeds.
    assert summary.dropped == pytest.approx(150, abs=2)
    assert np.any((alarms.level == LEVEL_ALARM) & (alarms.causes == BAD_DATA))
    assert np.all(np.isfinite(predictions.predicted))


def test_wind_holds_its_last_value(model, vehicle, with_odometry, bag_of, tmp_path):
    wind = WindStream(
        START_NS + np.array([2_000_000_000, 6_000_000_000]), np.array([[-15.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    )
    replay(model, vehicle, bag_of(replace(with_odometry, wind=wind)), tmp_path / "out.mcap")
    _, alarms = read_outputs(tmp_path / "out.mcap")
    seconds = (alarms.time_ns - START_NS) * 1e-9
    windy = np.array(["u" in names for names in alarms.inputs_outside])
    assert seconds[windy].min() == pytest.approx(2.1, abs=0.1)
    assert seconds[windy].max() == pytest.approx(6.2, abs=0.1)


def test_nothing_usable_gives_alarms_alone(model, vehicle, with_odometry, bag_of, tmp_path):
    speeds = np.full_like(with_odometry.rotor_speeds.speeds, 2.0 * vehicle.rotor_speed_max_rad_s)
    bag = bag_of(
        replace(with_odometry, rotor_speeds=RotorSpeedStream(with_odometry.rotor_speeds.time_ns, speeds))
    )
    summary = replay(model, vehicle, bag, tmp_path / "out.mcap")
    assert summary.predictions_out == 0
    assert summary.alarm_fraction > 0.9
    _, alarms = read_outputs(tmp_path / "out.mcap")
    assert alarms.causes[-1] == BAD_DATA


def _without_rotor_speeds(recording):
    return replace(recording, rotor_speeds=None)


def _without_state(recording):
    return replace(recording, odometry=None)


def _with_nan(recording):
    force = recording.imu.specific_force.copy()
    force[1042, 1] = np.nan
    return replace(recording, imu=replace(recording.imu, specific_force=force))


def _repeating(recording):
    time_ns = recording.rotor_speeds.time_ns.copy()
    time_ns[7] = time_ns[6]
    return replace(recording, rotor_speeds=replace(recording.rotor_speeds, time_ns=time_ns))


def _hours_apart(recording):
    time_ns = recording.rotor_speeds.time_ns + 3_600_000_000_000
    return replace(recording, rotor_speeds=replace(recording.rotor_speeds, time_ns=time_ns))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_without_rotor_speeds, r"swings\.mcap: topic rotor_speeds \(or erpm\) is missing"),
        (_without_state, r"swings\.mcap: topics mocap/pose and odometry are missing"),
        (_hours_apart, r"swings\.mcap: topics imu, rotor_speeds and the state share no time"),
    ],
)
def test_bad_bag_is_refused_and_nothing_written(
    model, vehicle, with_odometry, bag_of, tmp_path, damage, message
):
    bag = bag_of(damage(with_odometry))
    with pytest.raises(LogError, match=message):
        replay(model, vehicle, bag, tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize(("damage", "lost"), [(_with_nan, 1), (_repeating, 0)])
def test_bad_samples_are_followed_as_in_flight(model, vehicle, with_odometry, bag_of, tmp_path, damage, lost):
    summary = replay(model, vehicle, bag_of(damage(with_odometry)), tmp_path / "out.mcap")
    predictions, alarms = read_outputs(tmp_path / "out.mcap")
    assert summary.dropped == lost
    assert np.isfinite(predictions.predicted).all()
    assert bool(np.any(alarms.causes & BAD_DATA)) == bool(lost)


def test_too_short_for_the_estimator_is_refused(model, vehicle, with_pose, bag_of, tmp_path):
    imu = with_pose.imu
    short = ImuStream(*(getattr(imu, field.name)[:300] for field in fields(imu)))
    with pytest.raises(SignalError, match="the estimator never started"):
        replay(model, vehicle, bag_of(replace(with_pose, imu=short)), tmp_path / "out.mcap")


def test_model_of_another_vehicle_is_refused(model, vehicle, with_pose, bag_of, tmp_path):
    with pytest.raises(ModelError, match="is of vehicle bebop2"):
        replay(replace(model, vehicle="bebop2"), vehicle, bag_of(with_pose), tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_real_fast_flight_leaves_a_slow_envelope(model, vehicle, shared_data, tmp_path):
    """The model knows swings of 3 m/s; the flight reaches 14 m/s."""
    flight = shared_data / "neurobem" / "bemnn20210218172600seg1.mat"
    summary = replay(model, vehicle, flight, tmp_path / "out.mcap")
    _, alarms = read_outputs(tmp_path / "out.mcap")
    assert summary.dropped == 0
    assert summary.alarm_fraction > 0.8
    assert "u" in {name for names in alarms.inputs_outside for name in names}


class TestSeveral:
    @pytest.fixture
    def flights(self, with_pose, with_odometry, bag_of):
        return [bag_of(with_pose), bag_of(with_odometry)]

    @pytest.mark.slow
    def test_bags_and_summaries_are_those_of_one_by_one(
        self, each_model, vehicle, flights, cluster, tmp_path, monkeypatch
    ):
        """Workers have another working folder."""
        settings = MonitorSettings(adaptive=True)
        outputs = [tmp_path / "alone" / flight.name for flight in flights]
        alone = {
            flight.stem: replay(each_model, vehicle, flight, output, confidence=0.9, settings=settings)
            for flight, output in zip(flights, outputs, strict=True)
        }
        monkeypatch.chdir(tmp_path)
        for workers in (Workers(), Workers(scheduler=cluster)):
            together = replay_all(
                each_model,
                vehicle,
                flights,
                Path("together"),
                confidence=0.9,
                settings=settings,
                workers=workers,
            )
            assert together == alone
            for output in outputs:
                assert (tmp_path / "together" / output.name).read_bytes() == output.read_bytes()
            assert len(list((tmp_path / "together").iterdir())) == len(flights)

    def test_one_that_fails_is_named_and_nothing_is_written(self, model, vehicle, flights, tmp_path):
        bad = tmp_path / "bad.mcap"
        bad.write_bytes(flights[0].read_bytes()[:-8])
        with pytest.raises(LogError, match=f"^{bad}: cut off"):
            replay_all(model, vehicle, [*flights, bad], tmp_path / "out")
        assert sorted(tmp_path.iterdir()) == sorted([bad, *flights])

    def test_the_others_of_a_batch_with_a_bad_one(self, model, vehicle, flights, tmp_path):
        bad = tmp_path / "bad.mcap"
        bad.write_bytes(flights[0].read_bytes()[:-8])
        left_out = []
        replayed = replay_all(
            model, vehicle, [bad, *flights, flights[0]], tmp_path / "out", left_out=left_out
        )
        assert list(replayed) == [flight.stem for flight in flights]
        assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(f.name for f in flights)
        assert [flight.path for flight in left_out] == [str(flights[0]), str(bad)]

    def test_in_the_place_of_a_flight(self, model, vehicle, flights):
        before = flights[1].read_bytes()
        with pytest.raises(LogError, match=r"its bag would replace .*; choose another folder"):
            replay_all(model, vehicle, flights, flights[1].parent)
        assert flights[1].read_bytes() == before
