# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which format a path is; docs/add-a-log-format.md: its example works, also in another package."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.flight import Recording
from quadpi_core.logs import formats, identify_format, read_recording
from quadpi_core.logs.readers import log_formats
from quadpi_core.vehicle import Vehicle

GUIDE = (Path(__file__).parents[3] / "docs" / "add-a-log-format.md").read_text()
READER = (Path(__file__).parents[3] / "examples" / "text_log.py").read_text()
ENTRY = re.search(r"```toml\n# pyproject.toml\n\[project\.entry-points\.(.*?)```", GUIDE, flags=re.DOTALL)[1]
DESCRIPTION = "ArduPilot log as text (.log)"
COLUMNS = {
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "ESC": ("QBf", "TimeUS,Instance,RPM"),
    "XKF1": ("QBffffff", "TimeUS,C,PN,PE,PD,VN,VE,VD"),
    "XKQ": ("QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    "MSG": ("QZ", "TimeUS,Message"),
}
# Motor of ArduPilot's quad X in the corner of each rotor of the vehicle neurobem.
MOTORS = (4, 1, 2, 3)


@pytest.fixture(autouse=True)
def forget_format() -> Iterator[None]:
    """Find the formats again, before and after."""
    log_formats.cache_clear()
    yield
    log_formats.cache_clear()
    sys.modules.pop(f"{formats.__name__}.text_log", None)


@pytest.fixture
def reader(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader of the guide beside the others."""
    folder = tmp_path / "formats"
    folder.mkdir()
    (folder / "text_log.py").write_text(READER)
    monkeypatch.setattr(formats, "__path__", [*formats.__path__, str(folder)])


def text_log(flight: Recording) -> str:
    """A log as Mission Planner writes it; its two last lines are messages of topic imu."""
    rows: list[tuple[int, str]] = []

    def log(name: str, time_ns: np.ndarray, *columns: np.ndarray) -> None:
        for stamp, values in zip(time_ns // 1000, np.column_stack(columns), strict=True):
            rows.append((stamp, f"{name}, {stamp}, {', '.join(f'{value:.9g}' for value in values)}\n"))

    imu, rotors, pose = flight.imu, flight.rotor_speeds, flight.pose
    start_ns = imu.time_ns[0] - 10**9
    number = np.zeros(len(imu))
    log("IMU", imu.time_ns - start_ns, number, imu.angular_velocity, imu.specific_force)
    log("IMU", imu.time_ns - start_ns, number + 1, imu.angular_velocity + 1.0, imu.specific_force)
    for motor, speed in zip(MOTORS, rotors.speeds.T, strict=True):
        log("ESC", rotors.time_ns - start_ns, np.full(len(rotors), motor - 1), speed * 30.0 / np.pi)
    velocity = np.gradient(pose.position, pose.time_ns * 1e-9, axis=0)
    log("XKF1", pose.time_ns - start_ns, np.zeros(len(pose)), pose.position, velocity)
    log("XKQ", pose.time_ns - start_ns, np.zeros(len(pose)), pose.attitude)
    log("MSG", np.array([10**9]), np.array([0.0]))
    rows.sort(key=lambda row: (row[0], not row[1].startswith("E")))
    rows = [row for row in rows if row[0] <= (imu.time_ns[-1] - start_ns) // 1000]
    head = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"]
    head += [
        f"FMT, {130 + k}, 9, {name}, {', '.join(kind)}\n" for k, (name, kind) in enumerate(COLUMNS.items())
    ]
    return "".join([*head, *(line for _, line in rows)])


@pytest.mark.slow
@pytest.mark.usefixtures("reader")
def test_commands_run_as_written(fly, quadpi, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    flown = [fly(seed) for seed in range(3)]
    for name, flight in zip(("flight", "other", "third"), flown, strict=True):
        Path(f"{name}.log").write_text(text_log(flight))
    commands = re.findall(r"^    quadpi (.*)$", GUIDE, flags=re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["info", "import", "identify", "replay"]
    for command in commands:
        outcome = quadpi(*command.split())
        assert outcome.status == 0, outcome.errors
    vehicle = Vehicle.load("neurobem")
    for source in ("flight.log", "bags/flight.mcap"):
        recording = read_recording(source, vehicle)
        assert recording.imu.angular_velocity == pytest.approx(flown[0].imu.angular_velocity, rel=1e-6)
        assert recording.imu.specific_force == pytest.approx(flown[0].imu.specific_force, rel=1e-6)
        assert recording.odometry.attitude == pytest.approx(flown[0].pose.attitude, abs=0.02)
        speeds = flown[0].rotor_speeds.speeds
        assert recording.rotor_speeds.speeds == pytest.approx(speeds[: len(recording.rotor_speeds)], rel=1e-6)
    assert Path("replayed.mcap").is_file()


@pytest.mark.usefixtures("reader")
@pytest.mark.parametrize("lost", [1, 3, 40])
def test_a_truncated_log_is_refused_with_file_and_sample(lost, fly, quadpi, tmp_path):
    whole = text_log(fly(0))
    path = tmp_path / "cut.log"
    path.write_text(whole[:-lost])
    sample = whole[:-lost].count("\nIMU,") - 1
    outcome = quadpi("info", path)
    assert outcome.status == 2
    assert f"{path}: topic imu: sample {sample}: cut off or damaged: IMU, " in outcome.errors


@pytest.mark.usefixtures("reader")
def test_a_mapping_gives_another_order_of_rotors(fly, tmp_path):
    vehicle = Vehicle.load("neurobem")
    path, mapping = tmp_path / "flight.log", tmp_path / "order.yaml"
    path.write_text(text_log(fly(0)))
    mapping.write_text("{rotors: [1, 2, 3, 4], unit: rpm}")
    usual, other = (read_recording(path, vehicle, one).rotor_speeds.speeds for one in (None, mapping))
    assert usual[:, np.argsort(MOTORS)] == pytest.approx(other)


def announce(folder: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Install what pip would make of the guide's entry point."""
    installed = folder / "my_package-1.0.dist-info"
    installed.mkdir(parents=True)
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1.0\n")
    group, _, entries = ENTRY.replace('"', "").partition("]\n")
    entry_points = f"[{group}]\n{entries}".replace("text_log:", f"{name}:")
    (installed / "entry_points.txt").write_text(entry_points)
    monkeypatch.syspath_prepend(folder)


@pytest.mark.usefixtures("package_of_ones_own")
def test_a_package_of_ones_own_announces_a_format(fly, tmp_path, monkeypatch):
    announce(tmp_path, "text_log", monkeypatch)
    package = tmp_path / "my_package"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "text_log.py").write_text(READER)
    path = tmp_path / "flight.txt"
    path.write_text(text_log(fly(0)))
    assert identify_format(path).description == DESCRIPTION
    assert len(read_recording(path, Vehicle.load("neurobem")).imu) == len(fly(0).imu)


@pytest.mark.usefixtures("package_of_ones_own")
def test_a_package_that_cannot_be_loaded_is_one_line(tmp_path, monkeypatch, quadpi):
    announce(tmp_path, "absent_log", monkeypatch)
    (tmp_path / "flight.txt").write_text("FMT, 128, 89\n")
    outcome = quadpi("info", tmp_path / "flight.txt")
    assert outcome.status == 2
    assert outcome.errors.count("\n") == 1
    assert "log format `text_log` of my_package 1.0 (my_package.absent_log:FORMAT):" in outcome.errors
    assert "cannot be imported: ModuleNotFoundError: No module named 'my_package" in outcome.errors


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("absent.mat", None, "no such file or folder"),
        ("empty.mat", b"", "the file is empty"),
        ("flight.ulg.gz", b"\x1f\x8b\x08\x00", "is compressed; `gunzip flight.ulg.gz` unpacks it"),
        ("flight.mcap.zst", b"\x28\xb5\x2f\xfd", "is compressed; `unzstd flight.mcap.zst` unpacks it"),
        ("LOG.lz4", b"\x04\x22\x4d\x18", "is compressed; `unlz4 LOG.lz4` unpacks it"),
        ("LOG.zip", b"PK\x03\x04\x00", "is compressed; `unzip LOG.zip` unpacks it"),
        (
            "flight.xyz",
            b"some bytes",
            "not a known log format; known: ArduPilot .*, Crazyflie .*, bag ",
        ),
    ],
)
def test_unusable_paths_are_named(tmp_path: Path, name: str, content: bytes | None, message: str):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogError, match=f"{name}: {message}"):
        read_recording(path, None)


def test_formats_are_told_apart(tmp_path: Path):
    for name, content, description in (
        ("a.mcap", b"\x89MCAP", "bag"),
        ("b.mat", b"MATLAB", "NeuroBEM"),
        ("c.CSV", b"t,x", "table"),
        ("log17", b"\xbc\x02\x00", "Crazyflie"),
    ):
        (tmp_path / name).write_bytes(content)
        assert identify_format(tmp_path / name).description.startswith(description)
    assert identify_format(tmp_path).description.startswith("bag")


def test_a_folder_of_logs_is_told_from_a_bag(tmp_path: Path):
    (tmp_path / "one.ulg").write_bytes(b"ULog")
    with pytest.raises(LogError, match=r"a folder that is no bag; give .*/\*"):
        read_recording(tmp_path, None)
