# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""CSV files of every dialect that tools write hold the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from quadpi_core.logs import read_recording

from .formats.test_table_files import hover_table, write
from .test_mapping import minimal_mapping

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
