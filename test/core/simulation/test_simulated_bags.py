# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.frames import rotate_body_to_world, rotate_world_to_body
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import has_topic, topic_stamps
from quadpi_core.logs.bags import read_bag, write_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.topics import TOPIC_TYPES
from quadpi_core.paths import bags_directory
from quadpi_core.screening.sample_order import usable_recording
from quadpi_core.simulation import simulated_bags
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.scenario import FlightPlan, load_scenario
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.sensors import sense
from quadpi_core.simulation.simulated_bags import read_truth, simulate, write_simulated_bag
from quadpi_core.vehicle import Vehicle
from quadpi_core.version import __version__

BEBOP = Vehicle.load("bebop2")


@pytest.fixture(scope="module")
def plan():
    keys = {"name": "swing", "scenario": "demo", "vehicle": "bebop2", "noise": "paper"}
    return FlightPlan.from_dict({**keys, "seed": 7, "duration_s": 4.0, "truth_rate_hz": 50}, "here")


@pytest.fixture(scope="module")
def truth(swing):
    return swing(4.0)


def sensed_of(plan, truth, vehicle=BEBOP):
    return sense(truth, vehicle, SensorSuite.load(plan.noise), plan.effects, plan.faults, plan.seed)


@pytest.fixture(scope="module")
def sensed(plan, truth):
    return sensed_of(plan, truth)


@pytest.fixture(scope="module")
def bag(tmp_path_factory, plan, truth, sensed):
    path = tmp_path_factory.mktemp("simulated") / "swing.mcap"
    write_simulated_bag(path, plan, truth, sensed)
    return path


def assert_same_streams(found, expected):
    assert [type(stream) for stream in found.streams()] == [type(stream) for stream in expected.streams()]
    for one, other in zip(found.streams(), expected.streams(), strict=True):
        for column in fields(other):
            # Attitudes are rotated by half turns and back, whose roots of one half round.
            tolerance = 1e-15 if column.name == "attitude" else 0.0
            np.testing.assert_allclose(
                getattr(one, column.name), getattr(other, column.name), rtol=0.0, atol=tolerance
            )


def test_bag_gives_back_what_was_sensed(bag, sensed):
    found = read_bag(bag, BEBOP)
    assert_same_streams(found, sensed.recording)
    assert found.odometry is None
    assert found.vehicle == "bebop2"
    read_recording(bag, BEBOP)


def test_bag_of_a_vehicle_without_pole_pairs_holds_rotor_speeds(tmp_path, plan, truth):
    vehicle = replace(BEBOP, pole_pairs=None)
    sent = sensed_of(plan, truth, vehicle)
    write_simulated_bag(tmp_path / "swing.mcap", plan, truth, sent)
    assert not has_topic(tmp_path / "swing.mcap", "erpm")
    assert_same_streams(read_bag(tmp_path / "swing.mcap"), sent.recording)


def test_cdr(bag):
    names = list(topic_stamps(bag))
    sensors = ["/erpm", "/imu", "/mocap/pose", "/wind"]
    assert names == sorted([*sensors, *(f"/{topic}" for topic in TOPIC_TYPES if topic.startswith("truth/"))])


def test_messages_are_logged_when_they_arrive(bag, sensed):
    with Bag(bag) as opened:
        topics = opened.read(["/imu", "/erpm", "/mocap/pose", "/wind"])
    for name, topic in topics.items():
        arrival_ns = sensed.arrival_ns["rotor_speeds" if name == "/erpm" else name[1:]]
        np.testing.assert_array_equal(topic.log_time_ns, arrival_ns)
    late = topics["/mocap/pose"].log_time_ns - sensed.recording.pose.time_ns
    assert late.min() >= 8_000_000


def recorded(path, topic, unpack, **options):
    with Bag(path) as opened:
        return unpack(opened.read([f"/truth/{topic}"])[f"/truth/{topic}"].payloads, **options)


def test_truth_comes_back(bag, truth):
    found = read_truth(bag)
    taken = slice(None, None, 10)
    np.testing.assert_array_equal(found.time_ns, truth.time_ns[taken])
    np.testing.assert_array_equal(found.flight.stamps_ns, truth.time_ns[taken])
    for name in ("position", "velocity", "rates"):
        np.testing.assert_array_equal(getattr(found.odometry, name), getattr(truth, name)[taken])
    for name in ("angular_acceleration", "rotor_speeds", "specific_force", "wind"):
        np.testing.assert_array_equal(getattr(found.flight, name), getattr(truth, name)[taken])
    np.testing.assert_array_equal(found.wrench, truth.wrench[taken])
    np.testing.assert_allclose(found.odometry.attitude, truth.attitude[taken], rtol=0.0, atol=1e-15)
    reference = recorded(bag, "reference", sensor_messages.unpack_pose)
    np.testing.assert_array_equal(reference.position, truth.reference.position[taken])
    heading = truth.reference.yaw[taken]
    nose = rotate_body_to_world(reference.attitude, np.tile([1.0, 0.0, 0.0], (len(heading), 1)))
    expected = np.stack((np.cos(heading), np.sin(heading), np.zeros_like(heading)), axis=1)
    np.testing.assert_allclose(nose, expected, atol=1e-15)


def test_newton_and_euler_hold_in_the_bag_alone(bag):
    assert_newton_and_euler(bag)


def test_newton_and_euler_hold_in_the_bag_of_an_altered_vehicle(tmp_path, plan):
    altered = plan.overridden(
        duration_s=3.0,
        head_wind_m_s=5.0,
        motion={"x": [{"sine": {"amplitude_m": 0.5, "frequency_hz": 0.7, "start_s": 0.0}}]},
        effects={"payload": {"mass_kg": 0.05}, "gyroscopic": None, "inertia": None},
    )
    vehicle = SimulatedVehicle.load("bebop2")
    reference, wind = altered.reference(1000.0), altered.known_wind
    flown = simulate_flight("swing", vehicle, reference, known_wind=wind, effects=altered.effects)
    write_simulated_bag(tmp_path / "heavy.mcap", altered, flown, sensed_of(altered, flown))
    assert json.loads(metadata(tmp_path / "heavy.mcap")["truth"])["mass_kg"] == BEBOP.mass_kg + 0.05
    assert_newton_and_euler(tmp_path / "heavy.mcap")


def assert_newton_and_euler(path):
    found, body = read_truth(path), json.loads(metadata(path)["truth"])
    kind = sensor_messages.ACCELERATION
    _, both = recorded(path, "acceleration", sensor_messages.unpack_body_vectors, type_name=kind)
    down = np.broadcast_to([0.0, 0.0, body["gravity_m_s2"]], both[:, :3].shape)
    force = both[:, :3] - rotate_world_to_body(found.odometry.attitude, down)
    np.testing.assert_allclose(found.wrench[:, :3], body["mass_kg"] * force, rtol=0.0, atol=1e-12)
    momentum = found.odometry.rates @ body["inertia_kg_m2"]
    moment = both[:, 3:] @ body["inertia_kg_m2"] + np.cross(found.odometry.rates, momentum)
    np.testing.assert_allclose(found.wrench[:, 3:], moment, rtol=0.0, atol=1e-12)


def test_info_knows_the_vehicle_of_the_bag(bag, quadpi):
    outcome = quadpi("info", bag)
    assert outcome.status == 0, outcome.errors
    assert "vehicle bebop2" in outcome.output
    findings = [line for line in outcome.output.splitlines() if "▲" in line]
    assert ["topic mocap/pose: gaps" in line for line in findings] == [True], (
        "markers are hidden, else all is well"
    )


def test_noise_of_rotors_at_their_limit_is_no_spike(tmp_path, plan, truth):
    limit = np.full_like(truth.rotor_speeds, BEBOP.rotor_speed_max_rad_s)
    sent = sensed_of(plan, replace(truth, rotor_speeds=limit))
    assert sent.recording.rotor_speeds.speeds.max() > BEBOP.rotor_speed_max_rad_s
    write_simulated_bag(tmp_path / "fast.mcap", plan, truth, sent)
    assert len(read_recording(tmp_path / "fast.mcap", BEBOP).rotor_speeds) == len(truth)


def test_truth_names_the_vehicle_that_truly_flew(tmp_path, plan, truth, sensed):
    heavy = replace(truth, vehicle=replace(truth.vehicle, mass_kg=0.424))
    write_simulated_bag(tmp_path / "swing.mcap", plan, heavy, sensed)
    found = read_truth(tmp_path / "swing.mcap")
    np.testing.assert_array_equal(found.flight.specific_force, found.wrench[:, :3] / 0.424)


def test_truth_at_the_rate_of_the_plan(tmp_path, plan, truth, sensed):
    write_simulated_bag(tmp_path / "swing.mcap", plan.overridden(truth_rate_hz=500), truth, sensed)
    np.testing.assert_array_equal(read_truth(tmp_path / "swing.mcap").time_ns, truth.time_ns)


def test_plan_travels_with_the_bag(bag, plan):
    with Bag(bag) as opened:
        metadata = opened.metadata
    expected = {"vehicle": "bebop2", "scenario": "demo", "flight": "swing", "seed": "7"}
    assert expected.items() <= metadata.items()
    assert metadata["version"] == __version__
    assert json.loads(metadata["effects"]) == plan.effects == {}
    assert FlightPlan.from_dict(json.loads(metadata["plan"]), "bag") == plan


def test_equal_input_gives_equal_bytes(bag, tmp_path, plan, truth, swing):
    again = tmp_path / "again.mcap"
    write_simulated_bag(again, plan, swing(4.0), sensed_of(plan, truth))
    assert again.read_bytes() == bag.read_bytes()


def test_truth_is_no_sensor(tmp_path, plan, truth, sensed):
    """Without poses, nothing but the truth tells the state: it must not be taken for a fused odometry."""
    blind = replace(sensed, recording=replace(sensed.recording, pose=None, wind=None))
    write_simulated_bag(tmp_path / "blind.mcap", plan, truth, blind)
    found = read_bag(tmp_path / "blind.mcap", BEBOP)
    assert found.odometry is None
    assert found.pose is None
    assert found.wind is None
    assert not has_topic(tmp_path / "blind.mcap", "odometry")
    np.testing.assert_array_equal(found.rotor_speeds.speeds, sensed.recording.rotor_speeds.speeds)


def test_faults_survive_the_bag(tmp_path, plan, truth):
    faults = [
        {"kind": "not_finite", "topic": "imu", "signal": "specific_force", "at_s": 1.0, "for_s": 0.1},
        {"kind": "not_finite", "topic": "mocap/pose", "at_s": 1.0, "for_s": 0.1},
        {"kind": "half_reading", "topic": "rotor_speeds", "rotors": [2], "at_s": 2.0, "for_s": 0.5},
        {"kind": "stamps_backward", "topic": "imu", "at_s": 3.0, "for_s": 0.1, "size_s": 0.02},
    ]
    sent = sensed_of(plan.overridden(faults=faults), truth)
    write_simulated_bag(tmp_path / "faults.mcap", plan, truth, sent)
    found = read_bag(tmp_path / "faults.mcap", BEBOP)
    assert_same_streams(found, sent.recording)
    assert np.isnan(found.imu.specific_force[500:550]).all()
    assert np.diff(found.imu.time_ns).min() < 0
    said = [(one.topic, one.limit) for one in usable_recording(found).quality.left_out]
    assert ("imu", "whose stamp runs backward") in said or ("imu", "whose stamp repeats") in said
    assert ("imu", "whose specific_force is not finite") in said


def test_bag_without_truth(tmp_path, fly):
    write_bag(tmp_path / "real.mcap", fly(0, 2.0))
    with pytest.raises(
        LogError, match=r"real\.mcap: topic truth/odometry: missing: no flight of quadpi's sim"
    ):
        read_truth(tmp_path / "real.mcap")


@pytest.mark.parametrize(
    "text",
    [
        "none",
        "{}",
        '{"mass_kg": 1e999, "gravity_m_s2": 9.8, "inertia_kg_m2": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}',
        '{"mass_kg": -1, "gravity_m_s2": 9.8, "inertia_kg_m2": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}',
        "[" * 5000,
    ],
)
def test_a_damaged_truth_is_refused_in_one_line(monkeypatch, bag, text):
    metadata = Bag(bag).metadata | {"truth": text}
    monkeypatch.setattr(Bag, "metadata", metadata)
    with pytest.raises(LogError, match=r"swing\.mcap: `truth` in its metadata: "):
        read_truth(bag)


# The bags that come with quadpi are those that its simulation makes.


LARGEST_MB = 25
REMADE = "faults"
PLANS = {plan.name: plan for plan in load_scenario("bundled").flights}


def metadata(path):
    with Bag(path) as bag:
        return bag.metadata


def test_there_is_a_bag_of_every_flight_and_no_other():
    found = sorted(bags_directory().glob("*.mcap"))
    assert [path.stem for path in found] == sorted(PLANS)
    assert sum(path.stat().st_size for path in found) < 1e6 * LARGEST_MB


@pytest.mark.parametrize("name", PLANS)
def test_bag_holds_the_plan_as_it_is_now(name):
    assert json.loads(metadata(bags_directory() / f"{name}.mcap")["plan"]) == PLANS[name].as_dict()


def test_a_bag_is_made_again_byte_for_byte(monkeypatch, tmp_path):
    original = bags_directory() / f"{REMADE}.mcap"
    # A later version of quadpi need not ship new bags that differ in nothing but its name.
    monkeypatch.setattr(simulated_bags, "__version__", metadata(original)["version"])
    (flight,) = simulate([PLANS[REMADE]], tmp_path)
    assert flight.bag.read_bytes() == original.read_bytes()
