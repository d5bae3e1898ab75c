# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Tables: dialects of CSV, units of stamps, columns by their names, and the mapping file that is guessed."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from quadpi_core.errors import LogError
from quadpi_core.logs import decode_recording, read_recording
from quadpi_core.logs.mapping import UNITS, Mapping
from quadpi_core.logs.table_columns import open_columns
from quadpi_core.vehicle import Vehicle

from .formats.test_table_files import hover_table, read, write
from .test_mapping import minimal_mapping


def text_of(time_ns: np.ndarray, precision: str) -> np.ndarray:
    return np.datetime_as_string(time_ns.astype("datetime64[ns]"), unit=precision)


START_NS = 1_403_636_579_758_555_392
STAMPS = {
    "s": lambda ns: ns / 1e9,
    "ms": lambda ns: ns // 10**6,
    "us": lambda ns: ns // 1000,
    "ns": lambda ns: ns,
    "iso": lambda ns: text_of(ns, "ns"),
    "iso, UTC": lambda ns: np.char.add(text_of(ns, "us"), "Z"),
    "iso, decimal comma": lambda ns: np.char.replace(text_of(ns, "us"), ".", ","),
    "iso, offset": lambda ns: np.char.add(text_of(ns + 7_200 * 10**9, "us"), "+02:00"),
    "iso, decimal comma, UTC": lambda ns: np.char.add(np.char.replace(text_of(ns, "us"), ".", ","), "Z"),
    "iso, basic": lambda ns: np.char.replace(np.char.replace(text_of(ns, "us"), "-", ""), ":", ""),
    "slashes": lambda ns: np.char.replace(text_of(ns, "us"), "-", "/"),
    "date and time": lambda ns: np.char.replace(text_of(ns, "us"), "T", " "),
}


@pytest.mark.parametrize("stamps", STAMPS)
@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns", None])
@pytest.mark.parametrize("rate_hz", [50, 1000])
def test_the_rate_tells_the_unit_of_the_stamps(tmp_path: Path, stamps: str, unit: str, rate_hz: int, caplog):
    mapping = minimal_mapping()
    mapping["time"] = {"columns": ["t"]} | ({"unit": unit} if unit else {})
    time_ns = START_NS + np.arange(50) * (10**9 // rate_hz)
    imu = read(tmp_path, mapping, hover_table() | {"t": STAMPS[stamps](time_ns)}).imu
    precision = {"s": 300, "ms": 1_000_000, "ns": 1, "iso": 1}.get(stamps, 1000)
    assert np.abs(imu.time_ns - time_ns).max() < precision
    expected = f"the stamps are taken to be in {stamps}"
    assert (expected in caplog.text) == (stamps in UNITS["time"] and stamps != unit)


@pytest.mark.parametrize(
    ("unit", "interval", "expected_s"),
    [
        ("ms", 0.051, 5.1e-5),  # 20 kHz; in seconds it would be 20 Hz
        ("ms", 0.049, 0.049),
        ("s", 0.49, 0.49),
        ("s", 0.51, 5.1e-4),
        (None, 5.1e-4, 5.1e-4),
        (None, 0.49, 0.49),
    ],
)
def test_between_which_rates_the_unit_of_the_stamps_is_told(tmp_path: Path, unit, interval, expected_s):
    mapping = minimal_mapping()
    mapping["time"] = {"columns": ["t"], "unit": unit}
    imu = read(tmp_path, mapping, hover_table() | {"t": np.arange(50) * interval}).imu
    assert imu.time_ns[1] == pytest.approx(expected_s * 1e9)


def test_a_unit_that_cannot_be_told_is_asked_for(tmp_path: Path):
    mapping = minimal_mapping()
    del mapping["time"]["unit"]
    with pytest.raises(LogError, match="unit of the time cannot be told; `unit` in the mapping says it"):
        read(tmp_path, mapping, hover_table() | {"t": np.zeros(50)})


@pytest.mark.parametrize(
    ("period_ns", "written"),
    [
        (2**32 * 1000, lambda ns: ns // 1000),
        (2**32 * 1000, lambda ns: ns / 1e9),
        (2**32 * 10**6, lambda ns: ns // 10**6),
        (86_400 * 10**9, lambda ns: np.array([one[11:] for one in text_of(ns, "ms")])),
    ],
)
def test_a_clock_that_begins_again_at_its_period_is_counted_on(
    tmp_path: Path, period_ns: int, written, caplog
):
    time_ns = period_ns // 10**6 * 10**6 - 10**9 + np.arange(50) * 40_000_000
    mapping = minimal_mapping()
    del mapping["time"]["unit"]
    imu = read(tmp_path, mapping, hover_table() | {"t": written(time_ns % period_ns)}).imu
    np.testing.assert_allclose(np.diff(imu.time_ns), 40_000_000, atol=1_000_000)
    assert "the clock begins again after" in caplog.text


def test_a_clock_that_starts_again_at_any_other_time_is_not(tmp_path: Path):
    time_us = np.r_[4_294_000_000 + np.arange(30) * 40_000, np.arange(20) * 40_000]
    flight = read(tmp_path, minimal_mapping(), hover_table() | {"t": time_us})
    assert (len(flight.imu), len(flight.quality.breaks)) == (30, 1)


def test_stamps_before_zero_are_moved(tmp_path: Path, caplog):
    imu = read(tmp_path, minimal_mapping(), hover_table() | {"t": np.arange(50) * 0.01 - 0.2}).imu
    np.testing.assert_array_equal(imu.time_ns, 800_000_000 + np.arange(50) * 10_000_000)
    assert "the stamps begin at -0.200 s: 1 s are added to all" in caplog.text


@pytest.mark.parametrize(
    ("stamps", "said"),
    [
        (739_000 + np.arange(50) / 86_400 / 500, "is the interval of no flight"),
        (np.array(["17.05.2024 23:59:55.1"] * 50), "is neither a number nor date and time"),
    ],
)
def test_a_time_in_days_or_in_words_is_refused(tmp_path: Path, stamps, said):
    with pytest.raises(LogError, match=said):
        read(tmp_path, minimal_mapping(), hover_table() | {"t": stamps})


def test_a_table_needs_the_extra(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    (tmp_path / "a.csv").write_text("t,x\n0,1\n")
    with pytest.raises(LogError, match=r"a\.csv: this needs pyarrow, .* pip install quadpi-monitor\[logs\]"):
        open_columns(tmp_path / "a.csv")


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


BLACKBOX = "H Product:Blackbox flight data recorder by Nicholas Sherlock\nH rates:67,67,67\nH P ratio:16\n"
VIEWER = '"Product","Blackbox flight data recorder"\n"minthrottle",1070\n"gyro_scale","0x3f800000"\n'
DIALECTS = {
    "spaces": lambda text: text.replace(",", ", "),
    "quotes": lambda text: text.replace("t,p,q", '"t","p","q"'),
    "quoted values": lambda text: '"' + text.strip().replace(",", '","').replace("\n", '"\n"') + '"\n',
    "semicolon": lambda text: text.replace(",", ";"),
    "decimal comma": lambda text: text.replace(",", ";").replace(".", ","),
    "decimal comma in quotes": lambda text: (
        '"' + text.strip().replace(",", '","').replace(".", ",").replace("\n", '"\n"') + '"\n'
    ),
    "tabs": lambda text: text.replace(",", "\t"),
    "tabs, decimal comma": lambda text: text.replace(",", "\t").replace(".", ","),
    "columns of text": lambda text: "\n".join(f"  {line.replace(',', '   ')} " for line in text.splitlines()),
    "windows": lambda text: "\ufeff" + text.replace("\n", "\r\n"),
    "blank lines": lambda text: text.replace("\n", "\n\n"),
    "no last line feed": lambda text: text.rstrip(),
    "last comma": lambda text: text.replace("\n", ",\n"),
    "last comma of the values": lambda text: text.replace("\n", ",\n").replace(",\n", "\n", 1),
    "units below": lambda text: text.replace("\n", "\ns,rad/s,rad/s,(rad/s),m/s^2,[m/s2],m/s²\n", 1),
    "units in other words": lambda text: text.replace("\n", "\nsec,1/s,1/s,1/s,N/kg,N/kg,N/kg\n", 1),
    "units in brackets": lambda text: text.replace("p,q,r", "p [rad/s],q (rad s^-1),r [°/s]"),
    "comment above": lambda text: f"# of Monday, in the hall, 3 m high\n#\n{text}",
    "heading as a comment": lambda text: f"# {text}",
    "blackbox_decode": lambda text: BLACKBOX + text.replace(",", ", "),
    "blackbox viewer": lambda text: VIEWER + text,
    "cut off": lambda text: f"{text}0.5,0.1,0.",
    "numpy": lambda text: f"# {text}".replace(",", " "),
    "numpy, names with commas": lambda text: (
        "# t,p,q,r,ax,ay,az\n" + text.replace(",", " ").partition("\n")[2]
    ),
    "old Macintosh": lambda text: text.replace("\n", "\r"),
    "units of Windows": lambda text: text.replace("\n", "\ns,°/s,°/s,°/s,m/s²,m/s²,m/s²\n", 1),
    "a comment between": lambda text: text.replace("\n0.25,", "\n# gedrückt\n0.25,"),
}


def table_text() -> tuple[str, dict[str, np.ndarray]]:
    rng = np.random.default_rng(4)
    columns = {"t": np.arange(50) * 0.01} | {name: rng.normal(size=50) for name in ("p", "q", "r")}
    columns |= {name: rng.normal(size=50).round(3) for name in ("ax", "ay", "az")}
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows.tolist())]
    return "\n".join(lines) + "\n", columns


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
def test_a_csv_file_of_any_dialect_holds_the_same(tmp_path: Path, dialect: str, encoding: str):
    text, columns = table_text()
    path, mapping_path = write(tmp_path, minimal_mapping(), hover_table())
    path.write_bytes(DIALECTS[dialect](text).encode(encoding, errors="ignore"))
    imu = read_recording(path, None, mapping_path).imu
    np.testing.assert_array_equal(imu.time_ns, np.arange(50) * 10_000_000)
    np.testing.assert_array_equal(imu.angular_velocity, np.column_stack([columns[name] for name in "pqr"]))
    np.testing.assert_array_equal(
        imu.specific_force, np.column_stack([columns[name] for name in ("ax", "ay", "az")])
    )


@pytest.mark.parametrize(
    ("written", "dialect"),
    [
        ('"6,991.125"', lambda text: text),
        ("6,991.125", lambda text: text.replace(",", "\t").replace("6\t991", "6,991")),
        ("6'991#125", lambda text: text.replace(",", ";").replace(".", ",").replace("6'991#", "6.991,")),
    ],
)
def test_thousands_are_grouped_by_the_other_decimal_point(tmp_path: Path, written: str, dialect):
    path, mapping_path = write(tmp_path, minimal_mapping(), hover_table() | {"p": np.full(50, 0.125)})
    path.write_text(dialect(path.read_text().replace("0.125", written)))
    assert np.all(read_recording(path, None, mapping_path).imu.angular_velocity[:, 0] == 6991.125)


@pytest.mark.parametrize("absent", ["None", "-", "null", " ", "#N/A", "#REF!", "p"])
def test_what_is_no_number_costs_its_sample_alone(tmp_path: Path, absent: str, caplog):
    path, mapping_path = write(tmp_path, minimal_mapping(), hover_table() | {"p": np.arange(50) + 0.125})
    path.write_text(path.read_text().replace("20.125", absent))
    flight = read_recording(path, None, mapping_path)
    assert sorted(set(np.arange(50) + 0.125) - set(flight.imu.angular_velocity[:, 0])) == [20.125]
    assert [one.samples for one in flight.quality.left_out] == [1]
    assert ("is no number, as 1 of 50 values" in caplog.text) == (absent in {"#REF!", "p"})


def test_columns_that_are_not_mapped_may_hold_anything(tmp_path: Path):
    text, _ = table_text()
    path, mapping_path = write(tmp_path, minimal_mapping(), hover_table())
    lines = text.splitlines()
    modes = ["mode,note", *(f"ANGLE|{k},{'' if k < 30 else 'late'}" for k in range(50))]
    path.write_text("\n".join(f"{line},{mode}" for line, mode in zip(lines, modes, strict=True)))
    assert len(read_recording(path, None, mapping_path).imu) == 50


def test_a_table_without_a_heading_has_numbered_columns(tmp_path: Path):
    text, columns = table_text()
    mapping = minimal_mapping()
    mapping["time"]["columns"], mapping["angular_velocity"]["columns"] = [1], [2, 3, 4]
    mapping["acceleration"]["columns"] = [5, 6, 7]
    path, mapping_path = write(tmp_path, mapping, hover_table())
    path.write_text(text.partition("\n")[2])
    np.testing.assert_array_equal(
        read_recording(path, None, mapping_path).imu.specific_force[:, 1], columns["ay"]
    )


def test_whole_numbers_that_become_fractions_late_in_a_long_table(tmp_path: Path):
    columns = hover_table(60_000)
    columns |= {"t": columns["t"] * 0.1, "ax": np.where(columns["t"] < 500.0, 0.0, 0.25)}
    path, mapping_path = write(tmp_path, minimal_mapping(), columns)
    path.write_text(path.read_text().replace(",0,", ",0,").replace(",0.0,", ",0,"))
    assert read_recording(path, None, mapping_path).imu.specific_force[-1, 0] == 0.25
