# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping files and the tables that they describe: units, frames, missing values, and the nanodrone set."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
import scipy.io
import yaml
from scipy.spatial.transform import Rotation

from quadpi_core.errors import LogError, VehicleError
from quadpi_core.flight import NOT_MEASURED, Recording
from quadpi_core.frames import rotate_body_to_world
from quadpi_core.inputs import MEASURED, flown_in
from quadpi_core.logs import read_recording
from quadpi_core.vehicle import Vehicle

from ..test_mapping import minimal_mapping

GRAVITY = 9.80665
SPIKES = {"multisine_20251017_run1": 2, "multisine_20251017_run4": 3}


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return Vehicle.load("nanodrone")


def hover_table(samples: int = 50) -> dict[str, np.ndarray]:
    columns = {name: np.zeros(samples) for name in ("p", "q", "r", "ax", "ay")}
    return columns | {"t": np.arange(samples) * 0.01, "az": np.full(samples, -GRAVITY)}


def write(folder: Path, mapping: dict[str, Any], columns: dict[str, Any], suffix: str = ".csv"):
    """Write the table and its mapping; gives both paths."""
    table_path, mapping_path = folder / f"flight{suffix}", folder / "mapping.yaml"
    table = pa.table(columns)
    if suffix == ".csv":
        pyarrow.csv.write_csv(table, table_path)
    else:
        pyarrow.parquet.write_table(table, table_path)
    mapping_path.write_text(yaml.safe_dump(mapping))
    return table_path, mapping_path


def read(folder: Path, mapping: dict[str, Any], columns: dict[str, Any], vehicle: Vehicle | None = None):
    table_path, mapping_path = write(folder, mapping, columns)
    return read_recording(table_path, vehicle, mapping_path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_csv_and_parquet_hold_the_same(tmp_path: Path, suffix: str):
    table_path, mapping_path = write(tmp_path, minimal_mapping(), hover_table(), suffix)
    recording = read_recording(table_path, None, mapping_path)
    assert recording.name == "flight"
    assert recording.imu.time_ns[3] == 30_000_000
    np.testing.assert_allclose(recording.imu.specific_force, [[0.0, 0.0, -GRAVITY]] * 50)
    assert recording.rotor_speeds is None


def test_angular_and_acceleration_units(tmp_path: Path):
    mapping, columns = minimal_mapping(), hover_table()
    mapping["time"]["unit"] = "ms"
    mapping["angular_velocity"]["unit"] = "deg/s"
    mapping["acceleration"]["unit"] = "g"
    columns |= {"t": columns["t"] * 1e3, "q": np.full(50, 180.0), "az": np.full(50, -1.0)}
    imu = read(tmp_path, mapping, columns).imu
    assert imu.time_ns[1] == 10_000_000
    np.testing.assert_allclose(imu.angular_velocity[0], [0.0, np.pi, 0.0])
    np.testing.assert_allclose(imu.specific_force[0], [0.0, 0.0, -GRAVITY])


@pytest.mark.parametrize(
    ("unit", "value"), [("rad/s", 1000.0), ("rpm", 30_000.0 / np.pi), ("erpm", 6 * 30_000.0 / np.pi)]
)
def test_rotor_speed_units(tmp_path: Path, vehicle: Vehicle, unit: str, value: float):
    mapping = minimal_mapping() | {"rotor_speeds": {"columns": ["m1", "m2", "m3", "m4"], "unit": unit}}
    columns = hover_table() | {f"m{i}": np.full(50, value * i / 2) for i in (1, 2, 3, 4)}
    recording = read(tmp_path, mapping, columns, vehicle)
    np.testing.assert_allclose(recording.rotor_speeds.speeds[0], [500.0, 1000.0, 1500.0, 2000.0])


def test_electrical_speeds_need_pole_pairs(tmp_path: Path):
    mapping = minimal_mapping() | {"rotor_speeds": {"columns": ["m1", "m2", "m3", "m4"], "unit": "erpm"}}
    columns = hover_table() | {f"m{i}": np.full(50, 1e5) for i in (1, 2, 3, 4)}
    with pytest.raises(VehicleError, match="need `pole_pairs`"):
        read(tmp_path, mapping, columns, Vehicle.load("neurobem"))
    with pytest.raises(LogError, match="need the vehicle"):
        read(tmp_path, mapping, columns, None)


def tumbling(samples: int = 40) -> tuple[dict[str, np.ndarray], Rotation, np.ndarray, np.ndarray]:
    """A table of one tumbling body; with its attitude, world velocity and world acceleration."""
    rng = np.random.default_rng(7)
    attitude = Rotation.random(samples, rng=7)
    velocity, acceleration = rng.normal(size=(2, samples, 3))
    x, y, z, w = attitude.as_quat().T
    columns = hover_table(samples) | {"qx": x, "qy": y, "qz": z, "qw": w}
    columns |= dict(zip(("vx", "vy", "vz"), velocity.T, strict=True))
    columns |= dict(zip(("x", "y", "z"), rng.normal(size=(3, samples)), strict=True))
    return columns, attitude, velocity, acceleration


def state_mapping(**changes: Any) -> dict[str, Any]:
    return (
        minimal_mapping()
        | {
            "position": {"columns": ["x", "y", "z"], "unit": "m"},
            "attitude": {"columns": ["qw", "qx", "qy", "qz"], "form": "wxyz"},
            "velocity": {"columns": ["vx", "vy", "vz"], "unit": "m/s", "axes": "world"},
        }
        | changes
    )


@pytest.mark.parametrize("gravity", ["included", "removed"])
@pytest.mark.parametrize("axes", ["body", "world"])
@pytest.mark.parametrize("world", ["enu", "ned"])
@pytest.mark.parametrize("body", ["flu", "frd"])
def test_every_frame_gives_the_same_physics(tmp_path: Path, body: str, world: str, axes: str, gravity: str):
    """Turned back into the world, specific force and velocity must be those that the table was made of."""
    columns, attitude, velocity, acceleration = tumbling()
    up = np.array([0.0, 0.0, 1.0 if world == "enu" else -1.0])
    logged = acceleration + (GRAVITY * up if gravity == "included" else 0.0)
    logged = attitude.inv().apply(logged) if axes == "body" else logged
    columns |= dict(zip(("ax", "ay", "az"), logged.T, strict=True))
    choices = {"axes": axes, "gravity": gravity}
    mapping = state_mapping(body=body, world=world)
    mapping["acceleration"] = mapping["acceleration"] | choices
    recording = read(tmp_path, mapping, columns)
    force = rotate_body_to_world(recording.odometry.attitude, recording.imu.specific_force)
    expected = acceleration + GRAVITY * up
    if world == "enu":
        expected, velocity = (v[:, [1, 0, 2]] * [1.0, 1.0, -1.0] for v in (expected, velocity))
    np.testing.assert_allclose(force, expected, atol=1e-9)
    in_world = rotate_body_to_world(recording.odometry.attitude, recording.odometry.velocity)
    np.testing.assert_allclose(in_world, velocity, atol=1e-9)


def test_attitude_forms_agree(tmp_path: Path):
    columns, attitude, _, _ = tumbling()
    yaw, pitch, roll = attitude.as_euler("ZYX", degrees=True).T
    columns |= {"roll": roll, "pitch": pitch, "yaw": yaw}
    forms = (
        {"columns": ["qw", "qx", "qy", "qz"], "form": "wxyz"},
        {"columns": ["qx", "qy", "qz", "qw"], "form": "xyzw"},
        {"columns": ["roll", "pitch", "yaw"], "form": "roll-pitch-yaw", "unit": "deg"},
    )
    reference, *others = (
        read(tmp_path, state_mapping(attitude=form), columns).odometry.attitude for form in forms
    )
    for other in others:
        np.testing.assert_allclose(np.abs(np.sum(reference * other, axis=1)), 1.0, atol=1e-12)


def test_world_axes_need_an_attitude(tmp_path: Path):
    mapping = minimal_mapping()
    mapping["acceleration"]["axes"] = "world"
    with pytest.raises(LogError, match="need `attitude`"):
        read(tmp_path, mapping, hover_table())


def rotor_table(missing: list[int]) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    rotors = {f"m{i}": np.full(100, 1500.0) for i in (1, 2, 3, 4)}
    rotors["m3"][missing] = np.nan
    mapping = minimal_mapping() | {"rotor_speeds": {"columns": list(rotors), "unit": "rad/s"}}
    return mapping, hover_table(100) | rotors


def test_rows_without_a_value_at_either_end_are_dropped_and_logged(tmp_path: Path, vehicle, caplog):
    mapping, columns = rotor_table([0, 1, 99])
    recording = read(tmp_path, mapping, columns, vehicle)
    assert len(recording.rotor_speeds) == 97
    assert len(recording.imu) == 100
    assert "topic rotor_speeds: dropped 3 of 100 rows without a value" in caplog.text


def test_rows_without_a_value_in_between_are_counted_and_refused_if_many_unless_allowed(
    tmp_path: Path, vehicle: Vehicle
):
    mapping, columns = rotor_table([40, 41])
    recording = read(tmp_path, mapping, columns, vehicle)
    assert len(recording.rotor_speeds) == 98
    assert [(said.samples, said.first) for said in recording.quality.left_out] == [(2, 40)]
    mapping["rotor_speeds"]["missing"] = 0.02
    assert read(tmp_path, mapping, columns, vehicle).quality.left_out == ()
    mapping, columns = rotor_table(list(range(40, 92)))
    with pytest.raises(LogError, match=r"topic rotor_speeds: sample 40: no value, as in 52\.00% of the rows"):
        read(tmp_path, mapping, columns, vehicle)
    mapping["rotor_speeds"]["missing"] = 0.6
    assert len(read(tmp_path, mapping, columns, vehicle).rotor_speeds) == 48


def test_empty_column_is_refused(tmp_path: Path, vehicle: Vehicle):
    mapping, columns = rotor_table(list(range(100)))
    with pytest.raises(LogError, match="topic rotor_speeds: no row has a value for all of rotor_speeds"):
        read(tmp_path, mapping, columns, vehicle)


def test_spikes_are_left_out(tmp_path: Path, vehicle: Vehicle):
    mapping, columns = rotor_table([])
    columns["m2"][30] = 1e5
    recording = read(tmp_path, mapping, columns, vehicle)
    assert recording.rotor_speeds.speeds.max() == 1500.0
    assert 300_000_000 not in recording.rotor_speeds.time_ns
    assert list(recording.quality.sentences()) == [
        "topic rotor_speeds: left out 1 of 100 samples above the vehicle's 3000 rad/s; the first is "
        "sample 30, at 0.300 s"
    ]


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"az": None}, "no column az; it has"),
        ({"az": np.array(["up"] * 50)}, "column az: 'up' is no number"),
        ({"t": np.zeros(50)}, "topic imu: sample 1: the stamp repeats"),
        ({"t": np.arange(50)[::-1] * 1.0}, "topic imu: sample 2: the stamp runs backward"),
    ],
)
def test_unusable_columns_are_named(tmp_path: Path, columns: dict[str, Any], message: str):
    table = {name: values for name, values in (hover_table() | columns).items() if values is not None}
    with pytest.raises(LogError, match=rf"flight\.csv: {message}"):
        read(tmp_path, minimal_mapping(), table)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"ay"', '"ax"', "column ax is present twice"),
        (",", "!", "no row has numbers in two columns"),
    ],
)
def test_heading_and_separator_of_a_csv_file(tmp_path: Path, old: str, new: str, message: str):
    path, mapping_path = write(tmp_path, minimal_mapping(), hover_table())
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(LogError, match=rf"flight\.csv: {message}"):
        read_recording(path, None, mapping_path)


def test_the_sign_of_rotor_speeds_is_the_sense_of_rotation(tmp_path: Path, vehicle: Vehicle, caplog):
    mapping, columns = rotor_table([])
    columns |= {"m2": -columns["m2"], "m4": -columns["m4"]}
    recording = read(tmp_path, mapping, columns, vehicle)
    np.testing.assert_array_equal(recording.rotor_speeds.speeds, np.full((100, 4), 1500.0))
    assert "topic rotor_speeds: negative of rotor 2, 4, by the sense of rotation" in caplog.text


def test_what_is_mapped_and_not_used_is_said(tmp_path: Path, caplog):
    mapping = state_mapping()
    del mapping["attitude"]
    recording = read(tmp_path, mapping, tumbling()[0])
    assert recording.odometry is None
    assert "topic odometry: attitude is missing, so position and velocity are not used" in caplog.text


@pytest.mark.parametrize("lacking", [("position",), ("velocity",), ("position", "velocity")])
def test_an_attitude_needs_no_position_and_no_velocity(tmp_path: Path, lacking: tuple[str, ...]):
    whole = read(tmp_path, state_mapping(), tumbling()[0]).odometry
    mapping = {name: signal for name, signal in state_mapping().items() if name not in lacking}
    state = read(tmp_path, mapping, tumbling()[0]).odometry
    np.testing.assert_array_equal(state.attitude, whole.attitude)
    for place, name in enumerate(("position", "attitude", "velocity")):
        assert set(state.deviation[:, place]) == {NOT_MEASURED if name in lacking else 0.0}


def test_a_damaged_row_is_left_out_and_a_damaged_parquet_file_refused(tmp_path: Path, caplog):
    for suffix in (".csv", ".parquet"):
        path, mapping_path = write(tmp_path, minimal_mapping(), hover_table(), suffix)
        path.write_bytes(path.read_bytes()[:200] + b"\xff\x00,,,,,,,,,,,,\n")
        if suffix == ".csv":
            assert 5 < len(read_recording(path, None, mapping_path).imu) < 10
            assert "left out 1 of" in caplog.text
            continue
        with pytest.raises(LogError, match="flight"):
            read_recording(path, None, mapping_path)


def test_table_needs_a_mapping_and_others_take_none(tmp_path: Path):
    path, mapping_path = write(tmp_path, minimal_mapping(), hover_table())
    with pytest.raises(LogError, match=r"needs a mapping file .* \(--mapping\)"):
        read_recording(path, None)
    (tmp_path / "log00").write_bytes(b"\xbcanything")
    with pytest.raises(LogError, match="takes no mapping file"):
        read_recording(tmp_path / "log00", None, mapping_path)


@pytest.fixture(scope="module", params=[*SPIKES, "random1_20251017_run2"])
def nanodrone(request, shared_data: Path, vehicle: Vehicle) -> Recording:
    """The worked example of docs/add-a-data-set.md; its IMU and state share their rows."""
    recording = read_recording(shared_data / "nanodrone" / f"{request.param}.parquet", vehicle, "nanodrone")
    imu, odometry = recording.imu, recording.odometry

    def of(stream, other):
        both = np.isin(stream.time_ns, other.time_ns)
        return replace(
            stream, **{column.name: getattr(stream, column.name)[both] for column in fields(stream)}
        )

    return replace(recording, imu=of(imu, odometry), odometry=of(odometry, imu))


@pytest.mark.parametrize(("name", "spikes"), SPIKES.items())
def test_nanodrone_spikes_are_left_out(shared_data: Path, vehicle: Vehicle, name: str, spikes: int):
    recording = read_recording(shared_data / "nanodrone" / f"{name}.parquet", vehicle, "nanodrone")
    beyond = [left_out for left_out in recording.quality.left_out if left_out.limit.startswith("above")]
    assert [(left_out.topic, left_out.samples) for left_out in beyond] == [("rotor_speeds", spikes)]
    assert recording.rotor_speeds.speeds.max() < vehicle.rotor_speed_max_rad_s


def test_nanodrone_thrust_follows_rotor_speeds(nanodrone: Recording, vehicle: Vehicle):
    rotors, imu = nanodrone.rotor_speeds, nanodrone.imu
    squares = np.sum(rotors.speeds**2, axis=1)
    thrust = -vehicle.mass_kg * np.interp(rotors.time_ns, imu.time_ns, imu.specific_force[:, 2])
    flying = squares > 0.5 * np.median(squares)
    fit = thrust[flying] @ squares[flying] / (squares[flying] @ squares[flying])
    assert fit == pytest.approx(3.72e-8, rel=0.03)


def test_nanodrone_thrust_is_along_the_body(nanodrone: Recording):
    """World axes must be turned back into the body, where the lateral force is small."""
    fast = np.linalg.norm(nanodrone.odometry.velocity, axis=1) > 1.0
    force = nanodrone.imu.specific_force[fast]
    in_world = rotate_body_to_world(nanodrone.odometry.attitude[fast], force)
    assert np.abs(force[:, :2]).mean() < 0.6 * np.abs(in_world[:, :2]).mean()


def test_nanodrone_specific_force_is_acceleration_without_gravity(nanodrone: Recording, vehicle: Vehicle):
    odometry = nanodrone.odometry
    velocity = rotate_body_to_world(odometry.attitude, odometry.velocity)
    acceleration = np.gradient(velocity, odometry.time_ns * 1e-9, axis=0)
    expected = acceleration - [0.0, 0.0, vehicle.gravity_m_s2]
    in_world = rotate_body_to_world(odometry.attitude, nanodrone.imu.specific_force)
    slow = np.ones(30) / 30
    for axis in range(3):
        measured, derived = (np.convolve(v[:, axis], slow, mode="valid") for v in (in_world, expected))
        flying = odometry.position[15:-14, 2] < -0.3
        assert np.corrcoef(measured[flying], derived[flying])[0, 1] > 0.9


EUROC = """#timestamp [ns],{}
{}
"""


def test_tables_of_one_flight_on_their_own_clocks(tmp_path: Path):
    """As EuRoC has them, by the mapping of the guide."""
    guide = (Path(__file__).parents[4] / "docs" / "add-a-data-set.md").read_text()
    (tmp_path / "euroc.yaml").write_text(
        guide.partition("# euroc.yaml")[2].partition("```")[0].partition("\n")[2]
    )
    start_ns = 1_403_636_579_758_555_392
    imu_ns, pose_ns = start_ns + np.arange(400) * 5_000_000, start_ns + 3_333 + np.arange(150) * 10_000_000
    rng = np.random.default_rng(5)
    rates, force, position = (rng.normal(size=(n, 3)) for n in (400, 400, 150))
    attitude = Rotation.random(150, rng=5).as_quat(scalar_first=True)
    names = [f"w_RS_S_{x} [rad s^-1],a_RS_S_{x} [m s^-2]" for x in "xyz"]
    poses = [*(f"p_RS_R_{x} [m]" for x in "xyz"), *(f"q_RS_{x} []" for x in "wxyz")]
    tables = {
        "imu0": (names, imu_ns, np.stack((rates, force), axis=2).reshape(-1, 6)),
        "vicon0": (poses, pose_ns, np.hstack((position, attitude))),
    }
    for folder, (heading, time_ns, values) in tables.items():
        (tmp_path / folder).mkdir()
        rows = zip(time_ns.tolist(), values.tolist(), strict=True)
        lines = "\n".join(",".join([str(stamp), *map(repr, row)]) for stamp, row in rows)
        (tmp_path / folder / "data.csv").write_text(EUROC.format(",".join(heading), lines))
    recording = read_recording(tmp_path / "imu0" / "data.csv", None, tmp_path / "euroc.yaml")
    np.testing.assert_array_equal(recording.imu.time_ns, imu_ns)
    np.testing.assert_array_equal(recording.imu.angular_velocity, rates * [1.0, -1.0, -1.0])
    np.testing.assert_array_equal(recording.pose.time_ns, pose_ns)
    np.testing.assert_allclose(recording.pose.position, position[:, [1, 0, 2]] * [1.0, 1.0, -1.0])


def test_a_state_in_another_table_takes_the_rates_of_the_imu(tmp_path: Path):
    columns, *_ = tumbling(60)
    names = ("x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz")
    state = {"stamp": columns["t"][5:50:2]} | {name: columns[name][5:50:2] for name in names}
    pyarrow.csv.write_csv(pa.table(state), tmp_path / "state.csv")
    mapping = state_mapping()
    for name in ("position", "attitude", "velocity"):
        mapping[name]["table"] = "estimator"
    other = {"estimator": {"file": "state.csv", "time": {"columns": ["stamp"], "unit": "s"}}}
    columns |= {name: np.full(60, value) for name, value in zip("pqr", (0.1, 0.2, 0.3), strict=True)}
    odometry = read(tmp_path, mapping | {"tables": other}, columns).odometry
    whole = read(tmp_path, state_mapping(), columns).odometry
    for column in fields(whole):
        found, kept = getattr(odometry, column.name), getattr(whole, column.name)[5:50:2]
        sign = np.sign(np.sum(found * kept, axis=-1, keepdims=True)) if column.name == "attitude" else 1.0
        np.testing.assert_allclose(sign * found, kept, atol=1e-9)
    mapping["velocity"].pop("table")
    with pytest.raises(LogError, match="velocity needs an `attitude` in the same table"):
        read(tmp_path, mapping | {"tables": other}, columns)


def test_a_table_that_is_absent_is_named(tmp_path: Path):
    mapping = state_mapping(tables={"estimator": {"file": "state.csv", "time": {"columns": ["t"]}}})
    mapping["position"]["table"] = "estimator"
    with pytest.raises(LogError, match=r"state\.csv: cannot be read: No such file"):
        read(tmp_path, mapping, tumbling()[0])


@pytest.mark.parametrize("lies", [False, True])
def test_variables_of_matlab(tmp_path: Path, lies: bool):
    """Structs, columns and rows, a matrix by one name or by its columns, a second clock in the same file."""
    columns, attitude, *_ = tumbling(40)
    rates, force = (np.random.default_rng(k).normal(size=(40, 3)) for k in (1, 2))
    quaternions = attitude.as_quat(scalar_first=True)[::4]
    turned = (lambda matrix: matrix.T) if lies else (lambda matrix: matrix)
    log = {"t": columns["t"], "gyro": turned(rates), **dict(zip(("fx", "fy", "fz"), force.T, strict=True))}
    mocap = {"t": columns["t"][::4], "p": turned(rates[::4]), "q": turned(quaternions)}
    scipy.io.savemat(tmp_path / "flight.mat", {"imu": log, "mocap": mocap, "note": "of Monday"})
    mapping = minimal_mapping() | {
        "time": {"columns": ["imu.t"]},
        "angular_velocity": {"columns": ["imu.gyro"], "unit": "rad/s"},
        "tables": {"mocap": {"time": {"columns": ["mocap.t"], "unit": "s"}}},
        "mocap_position": {"table": "mocap", "columns": ["mocap.p.1", "mocap.p.2", "mocap.p.3"], "unit": "m"},
        "mocap_attitude": {"table": "mocap", "columns": ["mocap.q"], "form": "wxyz"},
    }
    mapping["acceleration"]["columns"] = ["imu.fx", "imu.fy", "imu.fz"]
    (tmp_path / "mapping.yaml").write_text(yaml.safe_dump(mapping))
    recording = read_recording(tmp_path / "flight.mat", None, tmp_path / "mapping.yaml")
    np.testing.assert_array_equal(recording.imu.angular_velocity, rates)
    np.testing.assert_array_equal(recording.imu.specific_force, force)
    np.testing.assert_array_equal(recording.pose.position, rates[::4])
    np.testing.assert_allclose(recording.pose.attitude, quaternions)
    mapping["mocap_position"].pop("table")
    (tmp_path / "mapping.yaml").write_text(yaml.safe_dump(mapping))
    with pytest.raises(LogError, match=r"mocap\.p\.1 has 10 values, the time imu\.t has 40"):
        read_recording(tmp_path / "flight.mat", None, tmp_path / "mapping.yaml")


def test_commands_battery_and_air(tmp_path: Path) -> None:
    columns = hover_table() | {f"u{motor}": np.full(50, 1000.0 + 100.0 * motor) for motor in range(1, 7)}
    columns |= {"hPa": np.full(50, 950.0), "kelvin": np.full(50, 293.15), "volts": np.full(50, 11.1)}
    mapping = minimal_mapping() | {
        "motor_commands": {"columns": ["u*"], "unit": "us"},
        "pressure": {"columns": ["hPa"], "unit": "hPa"},
        "temperature": {"columns": ["kelvin"], "unit": "K"},
        "battery": {"columns": ["volts"], "unit": "V"},
    }
    found = read(tmp_path, mapping, columns)
    assert found.commands.commands[0] == pytest.approx(0.1 * np.arange(1, 7))
    assert found.command_source == "table mapping"
    assert flown_in(found) == (pytest.approx(95000.0 / (287.053 * 293.15)), MEASURED)


def test_one_name_stands_for_as_many_rotors_as_the_table_has(tmp_path: Path) -> None:
    columns = hover_table() | {f"w_{rotor}": np.full(50, 100.0 * rotor) for rotor in (1, 2, 10, 3, 4, 5)}
    mapping = minimal_mapping() | {"rotor_speeds": {"columns": ["w_*"], "unit": "rad/s"}}
    speeds = read(tmp_path, mapping, columns).rotor_speeds.speeds[0]
    assert speeds.tolist() == [100.0, 200.0, 300.0, 400.0, 500.0, 1000.0]
