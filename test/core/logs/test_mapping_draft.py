# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The mapping file that a table without one is answered with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from quadpi_core.errors import LogError
from quadpi_core.logs import decode_recording
from quadpi_core.logs.mapping import Mapping
from quadpi_core.vehicle import Vehicle

N = 60
BEBOP = Vehicle.load("bebop2")


@pytest.fixture
def drafted(caplog: pytest.LogCaptureFixture) -> Callable[[Path], Path]:
    """drafted(table) → the mapping file that is shown with the refusal of a table without one."""

    def written(path: Path) -> Path:
        with pytest.raises(
            LogError, match=r"needs a mapping file .*\(--mapping\), like the one above; it has"
        ):
            decode_recording(path, BEBOP)
        mapping = path.with_suffix(".yaml")
        mapping.write_text(caplog.messages[-1].partition("a mapping file to start from:\n")[2])
        return mapping

    return written


def table(path: Path, heading: str, **scales: float) -> Path:
    """A table with columns of these names: rising stamps, gravity along z, else noise of a size."""
    rng = np.random.default_rng(3)
    names = [name.strip() for name in heading.split(",")]
    columns = [np.arange(N) * 0.01]
    for name in names[1:]:
        size, middle = scales.get(name.partition(" ")[0], (1.0, 0.0))
        columns.append(middle + rng.normal(0.0, size, N))
    lines = [heading, *(",".join(f"{value:.6f}" for value in row) for row in np.column_stack(columns))]
    path.write_text("\n".join(lines))
    return path


CASES = {
    "short names": (
        "t,wx,wy,wz,ax,ay,az,m1,m2,m3,m4,x,y,z,qx,qy,qz,qw",
        {
            "az": (0.1, 9.8),
            **{f"q{axis}": (1e-4, 0.0) for axis in "xyz"},
            "qw": (0.0, 1.0),
            "m1": (9.0, 7e3),
            "m2": (9.0, 7e3),
            "m3": (9.0, 7e3),
            "m4": (9.0, 7e3),
        },
        {
            "body": "flu",
            "angular_velocity": {"columns": ["wx", "wy", "wz"], "unit": "rad/s"},
            "rotor_speeds": {"columns": ["m1", "m2", "m3", "m4"], "unit": "rpm"},
            "mocap_position": {"columns": ["x", "y", "z"], "unit": "m"},
            "mocap_attitude": {"columns": ["qw", "qx", "qy", "qz"], "form": "wxyz"},
        },
    ),
    "units in brackets": (
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
        "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]",
        {"a_RS_S_z": (0.1, -9.8)},
        {
            "time": {"columns": ["timestamp"]},
            "body": "frd",
            "angular_velocity": {"columns": ["w_RS_S_x", "w_RS_S_y", "w_RS_S_z"], "unit": "rad/s"},
        },
    ),
    "numbers, degrees and g": (
        "time,gyroADC[0],gyroADC[1],gyroADC[2],acc.x,acc.y,acc.z,eRPM[0],eRPM[1],eRPM[2],eRPM[3],vbatLatest,"
        "pos.x,pos.y,pos.z,vel.x,vel.y,vel.z,roll,pitch,yaw",
        {
            "acc.z": (0.01, 1.0),
            "yaw": (90.0, 0.0),
            "vbatLatest": (1.0, 16.0),
            **{f"gyroADC[{k}]": (100.0, 0.0) for k in range(3)},
        },
        {
            "angular_velocity": {"columns": ["gyroADC[0]", "gyroADC[1]", "gyroADC[2]"], "unit": "deg/s"},
            "acceleration": {
                "columns": ["acc.x", "acc.y", "acc.z"],
                "unit": "g",
                "axes": "body",
                "gravity": "included",
            },
            "rotor_speeds": {"columns": ["eRPM[0]", "eRPM[1]", "eRPM[2]", "eRPM[3]"], "unit": "erpm"},
            "velocity": {"columns": ["vel.x", "vel.y", "vel.z"], "unit": "m/s", "axes": "world"},
            "attitude": {"columns": ["roll", "pitch", "yaw"], "form": "roll-pitch-yaw", "unit": "deg"},
            "battery": {"columns": ["vbatLatest"], "unit": "V"},
        },
    ),
    "suffixes of quadpi's own export": (
        "time_s,p_rad_s,q_rad_s,r_rad_s,force_x_m_s2,force_y_m_s2,force_z_m_s2,rotor_1_rad_s,rotor_2_rad_s,"
        "rotor_3_rad_s,rotor_4_rad_s",
        {"rotor_1_rad_s": (1.0, 900.0), "force_z_m_s2": (0.1, -9.8)},
        {
            "time": {"columns": ["time_s"]},
            "angular_velocity": {"columns": ["p_rad_s", "q_rad_s", "r_rad_s"], "unit": "rad/s"},
            "acceleration": {
                "columns": ["force_x_m_s2", "force_y_m_s2", "force_z_m_s2"],
                "unit": "m/s2",
                "axes": "body",
                "gravity": "included",
            },
        },
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_columns_and_units_are_guessed_by_names_and_numbers(tmp_path: Path, drafted, case: str):
    heading, scales, expected = CASES[case]
    mapping = drafted(table(tmp_path / "flight.csv", heading, **scales))
    content = yaml.safe_load(mapping.read_text())
    assert {name: content.get(name) for name in expected} == expected
    assert set(Mapping.load(mapping).signals) >= set(expected) - {"body"}
    recording = decode_recording(tmp_path / "flight.csv", BEBOP, mapping)
    assert len(recording.imu) == N


def test_what_cannot_be_guessed_is_asked_for(tmp_path: Path, drafted):
    mapping = drafted(table(tmp_path / "flight.csv", "clock,alpha,beta"))
    content = yaml.safe_load(mapping.read_text())
    assert content["time"] == {"columns": ["clock"]}
    assert content["acceleration"]["columns"] == ["?x", "?y", "?z"]
    with pytest.raises(LogError, match=r"no column \?x; it has clock, alpha, beta"):
        decode_recording(tmp_path / "flight.csv", BEBOP, mapping)


@pytest.mark.parametrize("case", ["csv_space_after_comma", "esc_without_telemetry", "erpm_in_hundreds"])
def test_tables_of_reports_are_read_by_the_draft_alone(shared_data: Path, tmp_path: Path, drafted, case: str):
    folder = shared_data / "reports" / case
    table_path = tmp_path / "flight.csv"
    table_path.write_bytes((folder / "flight.csv").read_bytes())
    own = decode_recording(table_path, BEBOP, drafted(table_path))
    expected = decode_recording(folder / "flight.csv", BEBOP, folder / "mapping.yaml")
    for stream, other in zip(own.streams(), expected.streams(), strict=True):
        np.testing.assert_array_equal(stream.time_ns, other.time_ns)
    np.testing.assert_array_equal(own.imu.specific_force, expected.imu.specific_force)


@pytest.mark.parametrize("absent", ["", "None", "-"])
def test_a_slow_sensor_in_a_fast_table_is_drafted_with_the_share_that_it_lacks(tmp_path, drafted, absent):
    path = table(tmp_path / "a.csv", *CASES["short names"][:1], **CASES["short names"][1])
    rows = [line.split(",") for line in path.read_text().splitlines()]
    for place, row in enumerate(rows[1:]):
        row[11:] = row[11:] if place % 5 == 0 else [absent] * 7
    path.write_text("\n".join(map(",".join, rows)))
    assert len(decode_recording(path, BEBOP, drafted(path)).pose) == N / 5
