# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bags with messages of other packages, as those packages' recorders write them, through the command line."""

import json
import re
import shlex
import shutil
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from quadpi_core.errors import LogError
from quadpi_core.field.field_reading import read_field_log
from quadpi_core.flight import NOT_MEASURED, AirStream
from quadpi_core.frames import body_frd_to_flu, quaternion_frd_ned_to_flu_enu, rotate_body_to_world
from quadpi_core.logs import bag_files, read_recording
from quadpi_core.logs.bag_files import Bag
from quadpi_core.logs.bag_topics import unnamed
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import read_bag
from quadpi_core.messages import sensor_messages
from quadpi_core.messages.adapters.adapter_settings import with_topics
from quadpi_core.messages.payloads import Topic
from quadpi_core.paths import config_directory
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.vehicle import Vehicle

from ..messages.adapters.vendor_messages import frame, mavros_status, px4_status, satellite_fix

VEHICLE = "neurobem"
PAGE = Path(__file__).parents[3] / "docs" / "adapters.md"
RAD_S_TO_RPM = 60.0 / (2.0 * np.pi)


def write(path, vendor, topics, storage=StoragePlugin.MCAP):
    """A bag of topics: name to (type name, log times, payloads); a folder, as `ros2 bag record` writes it."""
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for name, (type_name, log_times, payloads) in topics.items():
            connection = writer.add_connection(name, type_name, typestore=vendor.store)
            for time_ns, payload in zip(log_times, payloads, strict=True):
                writer.write(connection, int(time_ns), payload)
    return path


@pytest.fixture(scope="module")
def flown(fly):
    return fly(1, seconds=1.5)


def rotors_by_corner(speeds):
    """Columns of speeds (N, 4) in PX4's motor order: front right, rear left, front left, rear right."""
    corners = [tuple(np.sign(position[:2])) for position in Vehicle.load(VEHICLE).rotor_positions]
    return speeds[:, [corners.index(corner) for corner in [(1, 1), (-1, -1), (1, -1), (-1, 1)]]]


def imu_topic(flown):
    return (sensor_messages.IMU, flown.imu.time_ns, list(sensor_messages.pack_imu(flown.imu)))


@pytest.fixture(scope="module")
def made(vendor, flown):
    """mavros ESCStatus and a motion capture with two bodies, beside a standard imu."""
    vendor = vendor.px4_1_14
    rpm = np.rint(rotors_by_corner(flown.rotor_speeds.speeds) * RAD_S_TO_RPM)
    escs = [mavros_status(vendor, *row) for row in zip(flown.rotor_speeds.time_ns, rpm, strict=True)]
    pose = [
        vendor.store.deserialize_cdr(one, sensor_messages.POSE).pose
        for one in sensor_messages.pack_pose(flown.pose)
    ]
    frames = []
    for time_ns, one in zip(flown.pose.time_ns, pose, strict=True):
        p, q = one.position, one.orientation
        bodies = [("wand", [0, 0, 0], [0, 0, 0, 1]), ("quad", [p.x, p.y, p.z], [q.x, q.y, q.z, q.w])]
        frames.append(frame(vendor, "mocap4r2", time_ns, bodies))
    return {
        "/imu": imu_topic(flown),
        "/mavros/esc_status/status": ("mavros_msgs/msg/ESCStatus", flown.rotor_speeds.time_ns, escs),
        "/rigid_bodies": ("mocap4r2_msgs/msg/RigidBodies", flown.pose.time_ns, frames),
    }


@pytest.fixture
def topics(made):
    """A copy of them, to change."""
    return {name: (kind, times, list(payloads)) for name, (kind, times, payloads) in made.items()}


SETTINGS = """
rotor_speeds: {rotors: quad-x, unit: rpm}
mocap: {body: quad, frames: flu-enu}
"""


@pytest.fixture
def settings(tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text(SETTINGS)
    return path


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_of_mavros_and_motion_capture_is_read_like_one_of_standard_topics(
    tmp_path, vendor, topics, flown, settings, storage
):
    path = write(tmp_path / "field", vendor.px4_1_14, topics, storage)
    found = read_recording(path, Vehicle.load(VEHICLE), settings)
    assert found.rotor_speeds.time_ns.tolist() == flown.rotor_speeds.time_ns.tolist()
    np.testing.assert_allclose(found.rotor_speeds.speeds, flown.rotor_speeds.speeds, atol=0.5 / RAD_S_TO_RPM)
    np.testing.assert_allclose(found.pose.position, flown.pose.position, atol=1e-12)
    turn = np.abs(np.einsum("ni,ni->n", found.pose.attitude, flown.pose.attitude))
    np.testing.assert_allclose(turn, 1.0, atol=1e-9)


def test_import_and_info_take_the_settings_as_mapping(tmp_path, vendor, topics, flown, settings, quadpi):
    path = write(tmp_path / "field", vendor.px4_1_14, topics)
    result = quadpi("import", path, "--vehicle", VEHICLE, "--mapping", settings, "-o", tmp_path / "bags")
    assert result.status == 0, result.errors
    assert "topics imu, rotor_speeds, mocap/pose" in result.output
    found = read_bag(tmp_path / "bags" / "field.mcap")
    np.testing.assert_allclose(found.rotor_speeds.speeds, flown.rotor_speeds.speeds, atol=0.5 / RAD_S_TO_RPM)
    shown = quadpi("info", path, "--vehicle", VEHICLE, "--mapping", settings)
    assert shown.status == 0, shown.errors
    assert "mavros/esc_stat" in shown.output


def test_without_settings_the_standard_topics_are_read_and_the_others_named(tmp_path, vendor, topics, caplog):
    path = write(tmp_path / "field", vendor.px4_1_14, topics)
    found = read_bag(path)
    assert [stream.topic for stream in found.streams()] == ["imu"]
    told = " ".join(caplog.messages)
    assert "topic /mavros/esc_status/status: mavros_msgs/msg/ESCStatus is not read" in told
    assert "topic /rigid_bodies: mocap4r2_msgs/msg/RigidBodies is not read" in told


@pytest.mark.parametrize("version", ["px4_1_14", "px4_1_18"])
def test_a_px4_bag_needs_no_standard_topic_and_brings_its_own_version(tmp_path, vendor, flown, version):
    vendor = getattr(vendor, version)
    rpm = rotors_by_corner(flown.rotor_speeds.speeds) * RAD_S_TO_RPM
    imu, pose = flown.imu, flown.pose
    north_east_down = np.gradient(pose.position, 1e-9 * (pose.time_ns - pose.time_ns[0]), axis=0)

    def f32(values):
        return np.asarray(values, dtype=np.float32)

    combined = [
        vendor.bytes(
            vendor.make(
                "px4_msgs/msg/SensorCombined",
                timestamp=int(time_ns) // 1000,
                gyro_rad=f32(rates),
                accelerometer_m_s2=f32(force),
            )
        )
        for time_ns, rates, force in zip(imu.time_ns, imu.angular_velocity, imu.specific_force, strict=True)
    ]
    states = [
        vendor.bytes(
            vendor.make(
                "px4_msgs/msg/VehicleOdometry",
                timestamp=int(time_ns) // 1000,
                timestamp_sample=int(time_ns) // 1000,
                pose_frame=1,
                velocity_frame=1,
                position=f32(position),
                q=f32(attitude),
                velocity=f32(velocity),
                **dict.fromkeys(
                    ("angular_velocity", "position_variance", "orientation_variance", "velocity_variance"),
                    f32(np.zeros(3)),
                ),
            )
        )
        for time_ns, position, attitude, velocity in zip(
            pose.time_ns, pose.position, pose.attitude, north_east_down, strict=True
        )
    ]
    rotor_ns = flown.rotor_speeds.time_ns
    escs = [px4_status(vendor, int(time_ns), row) for time_ns, row in zip(rotor_ns, rpm, strict=True)]
    topics = {
        "/fmu/out/sensor_combined": ("px4_msgs/msg/SensorCombined", imu.time_ns, combined),
        "/fmu/out/vehicle_odometry": ("px4_msgs/msg/VehicleOdometry", pose.time_ns, states),
        "/fmu/out/esc_status": ("px4_msgs/msg/EscStatus", rotor_ns, escs),
    }
    path = write(tmp_path / "px4", vendor, topics)
    found = read_recording(path, Vehicle.load(VEHICLE), "px4")
    np.testing.assert_allclose(found.imu.specific_force, imu.specific_force, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(found.rotor_speeds.speeds, flown.rotor_speeds.speeds, atol=1.0 / RAD_S_TO_RPM)
    world = rotate_body_to_world(found.odometry.attitude, found.odometry.velocity)
    np.testing.assert_allclose(world, north_east_down, atol=1e-4)


def test_what_the_settings_ask_for_must_be_there_once(tmp_path, vendor, topics, settings):
    vehicle = Vehicle.load(VEHICLE)
    two = write(tmp_path / "two", vendor.px4_1_14, {**topics, "/other": topics["/rigid_bodies"]})
    with pytest.raises(LogError, match=r"two: `mocap` could be any of /other, /rigid_bodies"):
        read_recording(two, vehicle, settings)
    settings.write_text(SETTINGS.replace("frames: flu-enu", "frames: flu-enu, topic: /other"))
    assert read_recording(two, vehicle, settings).pose is not None
    settings.write_text(SETTINGS.replace("frames: flu-enu", "frames: flu-enu, topic: /poses"))
    with pytest.raises(LogError, match=r"two: topic /poses: no messages of mocap4r2_msgs"):
        read_recording(two, vehicle, settings)
    del topics["/mavros/esc_status/status"]
    with pytest.raises(LogError, match="`rotor_speeds`: no messages of mavros_msgs"):
        read_recording(write(tmp_path / "none", vendor.px4_1_14, topics), vehicle, settings)


def test_a_topic_that_gives_no_sample_says_why(tmp_path, vendor, topics, settings, quadpi):
    type_name, time_ns, payloads = topics["/mavros/esc_status/status"]
    empty = [mavros_status(vendor.px4_1_14, int(at), []) for at in time_ns]
    topics["/mavros/esc_status/status"] = (type_name, time_ns, empty)
    path = write(tmp_path / "field", vendor.px4_1_14, topics)
    result = quadpi("import", path, "--vehicle", VEHICLE, "--mapping", settings, "-o", tmp_path / "bags")
    assert result.status == 2
    assert result.errors.count("\n") == 1
    assert (
        f"topic /mavros/esc_status/status: none of {len(payloads)} messages gives a sample" in result.errors
    )
    assert "no ESC is announced yet" in result.errors


def test_reports_that_are_no_sample_are_counted_in_the_answer(
    tmp_path, vendor, topics, flown, settings, quadpi
):
    """Messages 40 to 49: an ESC is not announced; 51 and 52: all repeat their reports."""
    type_name, time_ns, payloads = topics["/mavros/esc_status/status"]
    payloads[40:50] = [mavros_status(vendor.px4_1_14, int(at), [8000.0] * 3) for at in time_ns[40:50]]
    payloads[51:53] = [payloads[50]] * 2
    topics["/mavros/esc_status/status"] = (type_name, time_ns, payloads)
    path = write(tmp_path / "field", vendor.px4_1_14, topics)
    # Of the repeated report, the stamp is that of message 50.
    after_s = 1e-9 * (time_ns[[40, 50]] - flown.imu.time_ns[0])
    expected = [
        (
            "rotor_speeds",
            "in which fewer ESCs report than `rotors` names",
            10,
            600,
            40,
            pytest.approx(after_s[0]),
        ),
        ("rotor_speeds", "in which no report is new", 2, 600, 51, pytest.approx(after_s[1])),
    ]
    quality = read_recording(path, Vehicle.load(VEHICLE), settings).quality
    assert [astuple(one) for one in quality.left_out] == expected
    data = tmp_path / "data.json"
    options = ("--vehicle", VEHICLE, "--mapping", settings)
    assert quadpi("import", path, *options, "-o", tmp_path / "bags", "--json", data).status == 0
    (imported,) = json.loads(data.read_text())["bags"]
    assert [tuple(one.values()) for one in imported["data_quality"]["left_out"]] == expected
    assert "left out 10 of" in " ".join(quadpi("info", path, *options).output.split())


def test_damaged_messages_are_named(tmp_path, vendor, topics, settings):
    frames = topics["/rigid_bodies"][2]
    frames[7] = frames[7][:-30]
    path = write(tmp_path / "field", vendor.px4_1_14, topics)
    with pytest.raises(LogError, match=r"field: topic /rigid_bodies: sample 7: "):
        read_recording(path, Vehicle.load(VEHICLE), settings)


def test_commands_of_the_page_run(tmp_path, vendor, topics, quadpi, monkeypatch):
    text = PAGE.read_text()
    monkeypatch.chdir(tmp_path)
    write(tmp_path / "field_bag", vendor.px4_1_14, topics)
    shutil.copy(config_directory() / "vehicles" / f"{VEHICLE}.yaml", "my-quad.yaml")
    settings, *_ = re.findall(r"```yaml\n(.*?)```", text, flags=re.DOTALL)
    Path("field.yaml").write_text(settings)
    ran = [quadpi(*shlex.split(line)[1:]) for line in re.findall(r"^quadpi .*$", text, flags=re.MULTILINE)]
    assert [one.status for one in ran] == [0, 0], ran
    assert read_bag("bags/field_bag.mcap").pose is not None


def test_the_temperature_of_a_part_is_not_that_of_the_air(tmp_path: Path) -> None:
    times = np.arange(2) * 10**9
    nothing = np.full(2, np.nan)
    payloads = sensor_messages.pack_temperature(AirStream(times, nothing, np.full(2, 40.0)))
    names = ["/imu/temperature", "/quad/temperature", "/quad/imu/temperature_baro", "/quad/temperature_imu"]
    write_mcap(
        tmp_path / "a.mcap", [Topic(name, sensor_messages.TEMPERATURE, times, payloads) for name in names], {}
    )
    with Bag(tmp_path / "a.mcap") as bag:
        found = unnamed(bag, "temperature", names)
    assert [one.name for one in found] == ["/quad/imu/temperature_baro", "/quad/temperature"]


def oriented(vendor, flight, frame_id="base_link"):
    """IMU messages whose orientation is the attitude of motion capture, as mavros sends them."""
    imu, pose = flight.imu, flight.pose
    at = np.clip(np.searchsorted(pose.time_ns, imu.time_ns), 0, len(pose) - 1)
    turned = quaternion_frd_ned_to_flu_enu(pose.attitude[at])[:, [1, 2, 3, 0]]
    payloads = [
        vendor.bytes(
            vendor.make(
                "sensor_msgs/msg/Imu",
                header=vendor.header(int(time_ns), frame_id),
                orientation=vendor.make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", q, strict=True))),
                orientation_covariance=4e-4 * np.eye(3).ravel(),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration_covariance=np.zeros(9),
                angular_velocity=vendor.make("geometry_msgs/msg/Vector3", **dict(zip("xyz", w, strict=True))),
                linear_acceleration=vendor.make(
                    "geometry_msgs/msg/Vector3", **dict(zip("xyz", f, strict=True))
                ),
            )
        )
        for time_ns, q, w, f in zip(
            imu.time_ns,
            turned,
            body_frd_to_flu(imu.angular_velocity),
            body_frd_to_flu(imu.specific_force),
            strict=True,
        )
    ]
    return {"/mavros/imu/data": ("sensor_msgs/msg/Imu", imu.time_ns, payloads)}


def test_a_position_by_satellites_has_the_orientation_of_the_imu(tmp_path, vendor, flown, caplog):
    store, pose = vendor.px4_1_14, flown.pose
    fixes = pose.take(slice(10, None, 20))
    degrees = np.rad2deg(fixes.position / 6.37e6)
    payloads = [
        satellite_fix(store, int(time_ns), 0.001 + north, 8.0 + east, 500.0 - down)
        for time_ns, (north, east, _), (*_, down) in zip(fixes.time_ns, degrees, fixes.position, strict=True)
    ]
    topics = oriented(store, flown)
    topics["/mavros/global_position/raw/fix"] = ("sensor_msgs/msg/NavSatFix", fixes.time_ns, payloads)
    state = read_bag(write(tmp_path / "fixes", store, topics)).odometry
    assert len(state) == len(fixes)
    assert np.all(state.deviation[:, 0] == 2.0)
    assert np.all(state.deviation[:, 2] == NOT_MEASURED)
    np.testing.assert_allclose(state.deviation[:, 1], 0.02)
    at = np.searchsorted(pose.time_ns, state.time_ns)
    assert np.abs(np.sum(state.attitude * pose.attitude[at], axis=1)).min() > 0.999
    # On a sphere of about the earth's size.
    np.testing.assert_allclose(
        state.position - state.position[0], fixes.position - fixes.position[0], atol=0.02, rtol=0.01
    )
    imu = {"/imu": imu_topic(flown), "/fix": topics["/mavros/global_position/raw/fix"]}
    assert read_bag(write(tmp_path / "plain", store, imu)).odometry is None
    assert "topic /fix: is not read: its attitude must be the orientation of an IMU" in caplog.text


def test_an_orientation_alone_is_the_attitude(tmp_path, vendor, flown, caplog):
    bag = write(tmp_path / "turned", vendor.px4_1_14, oriented(vendor.px4_1_14, flown))
    state = read_bag(bag).odometry
    assert np.unique(state.deviation[:, [0, 2]]).tolist() == [NOT_MEASURED]
    assert np.diff(state.time_ns).min() >= 40_000_000
    assert 15.0 < len(state) / (1e-9 * float(np.ptp(flown.imu.time_ns))) <= 21.0
    assert "its orientation is the attitude, alone" in caplog.text
    log = read_field_log(tmp_path / "turned", ReadingOptions())
    assert (log.velocity, log.position) == (None, None)
    assert len(log.attitude) == len(state)


def test_satellites_without_a_fix_are_as_no_topic(tmp_path, vendor, flown, caplog):
    store, stamps = vendor.px4_1_14, flown.pose.time_ns[::20]
    lost = [satellite_fix(store, int(time_ns), 47.0, 8.0, 500.0, status=-1) for time_ns in stamps]
    topics = oriented(store, flown) | {"/fix": ("sensor_msgs/msg/NavSatFix", stamps, lost)}
    state = read_bag(write(tmp_path / "lost", store, topics)).odometry
    assert np.unique(state.deviation[:, [0, 2]]).tolist() == [NOT_MEASURED]
    assert "topic /fix: is not read: none of its messages gives a position" in caplog.text


def test_an_orientation_in_axes_that_cannot_be_used_is_one_clear_line(tmp_path, vendor, flown):
    store = vendor.px4_1_14
    bag = write(tmp_path / "ned", store, oriented(store, flown, "imu_ned"))
    with pytest.raises(LogError, match=r"ned: topic /mavros/imu/data: sample 0: the frame `imu_ned`"):
        read_bag(bag)


def test_satellites_beside_motion_capture_get_no_attitude_that_nobody_measured(tmp_path, vendor, flown):
    store, pose = vendor.px4_1_14, flown.pose
    fixes = [satellite_fix(store, int(time_ns), 47.0, 8.0, 500.0) for time_ns in pose.time_ns[::20]]
    topics = {
        "/imu": imu_topic(flown),
        "/mocap/pose": (sensor_messages.POSE, pose.time_ns, list(sensor_messages.pack_pose(pose))),
        "/fix": ("sensor_msgs/msg/NavSatFix", pose.time_ns[::20], fixes),
    }
    named = with_topics(None, {"odometry": "/fix"}, "")
    recording = read_bag(write(tmp_path / "both", store, topics), adapters=named)
    assert recording.odometry is None
    assert len(recording.pose) == len(pose)


def test_satellites_without_an_imu_beside_them_have_no_attitude(tmp_path, vendor, flown, monkeypatch):
    store = vendor.px4_1_14
    later = flown.imu.time_ns[-1] + 100_000_000 * np.arange(1, 400)
    stamps = np.concatenate((flown.pose.time_ns[10::20], later))
    fixes = [satellite_fix(store, int(time_ns), 47.0, 8.0, 500.0) for time_ns in stamps]
    topics = oriented(store, flown) | {"/fix": ("sensor_msgs/msg/NavSatFix", stamps, fixes)}
    monkeypatch.setattr(bag_files, "BLOCK_MESSAGES", 100)
    state = read_bag(write(tmp_path / "gone", store, topics)).odometry
    level = np.all(state.attitude == [1.0, 0.0, 0.0, 0.0], axis=1)
    assert len(state) < 300
    assert not level.any()
