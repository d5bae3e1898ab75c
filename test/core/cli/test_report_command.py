# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi report`: from a raw log to a page, and the exit statuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ..field.field_examples import example
from ..field.stacks.test_crazyflie_stack import usd

GYRO, ACCELERATION = ("gyro.x", "gyro.y", "gyro.z"), ("acc.x", "acc.y", "acc.z")
NAMES = [
    *(*GYRO, *ACCELERATION, "pm.vbatMV", *(f"pwm.m{motor}_pwm" for motor in range(1, 5))),
    *(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "qw", "qx", "qy", "qz")),
]


def raw(path: Path, *, harder: float = 1.0) -> Path:
    """The example flight as a log of a card; motor 1 works `harder`."""
    log = example()
    time = np.arange(0.0, 59.0, 0.01)
    imu, commands = log.imu.at(time), log.commands.at(time) * np.array([harder, 1.0, 1.0, 1.0])
    velocity, position = log.velocity.at(time), log.position.at(time)
    flu = np.array([1.0, -1.0, -1.0])
    enu = [1, 0, 2]
    down = np.array([1.0, 1.0, -1.0])
    columns = [np.degrees(imu[:, :3] * flu), imu[:, 3:] * flu / 9.80665, 1000.0 * log.battery.at(time)]
    columns += [65535.0 * commands, (position * down)[:, enu], (velocity * down)[:, enu]]
    # The nose to the north, by quaternions from a body with z up to a world with z up.
    columns += [np.tile([0.5**0.5, 0.0, 0.0, 0.5**0.5], (len(time), 1))]
    table = np.hstack(columns)
    path.write_bytes(usd(NAMES, [tuple(row) for row in table[np.isfinite(table).all(axis=1)].tolist()]))
    return path


def test_a_raw_log_becomes_a_page(quadpi, read_json, tmp_path):
    done = quadpi("report", raw(tmp_path / "log00"), "-o", tmp_path / "out", "--mass", "0.5")
    assert (done.status, done.errors) == (0, "")
    assert "drag 0.30 1/s along the nose" in done.output
    assert sorted(file.name for file in (tmp_path / "out").iterdir()) == ["report.html", "report.json"]
    report = read_json(tmp_path / "out" / "report.json")
    assert report["mass_kg"] == 0.5
    drags = [axis["value"] for axis in report["vehicles"][0]["drag"]["per_mass"]]
    assert drags == pytest.approx([0.3, 0.2], rel=0.1)


def test_an_alarm_ends_with_1_where_it_is_asked_for(quadpi, tmp_path):
    log = raw(tmp_path / "log00", harder=2.0)
    assert quadpi("report", log, "-o", tmp_path / "out").status == 0
    assert quadpi("report", log, "-o", tmp_path / "out", "--fail-on", "alarm").status == 1


def test_a_log_given_twice_or_copied_counts_once(quadpi, read_json, tmp_path):
    log, copy = raw(tmp_path / "log00"), tmp_path / "log01"
    copy.write_bytes(log.read_bytes())
    said = f"the same flight as {log}; give each flight once"
    for again in (log, copy):
        done = quadpi("report", log, again, "-o", tmp_path / "out")
        assert (done.status, f"{again}: {said}" in done.errors) == (3, True)
        report = read_json(tmp_path / "out" / "report.json")
        assert [flight["name"] for flight in report["flights"]] == ["log00"]
        # Good flights before, of which one more narrows what flights scatter by.
        done = quadpi("report", log, "-o", tmp_path / "out", "--against", log, "--against", again)
        assert (done.status, done.errors.strip().endswith(f"{again}: {said}")) == (2, True)


def test_logs_that_are_left_out_end_with_3(quadpi, tmp_path):
    other = tmp_path / "log01"
    other.write_bytes(usd(NAMES[:6], [(0.0,) * 6] * 100))
    done = quadpi("report", raw(tmp_path / "log00"), other, "-o", tmp_path / "out")
    assert done.status == 3
    assert done.errors.startswith("quadpi: left out log01: ")
    assert "no flight in it" in done.errors


def test_no_flight_is_refused_in_a_sentence(refused, tmp_path):
    log = tmp_path / "log01"
    log.write_bytes(usd(NAMES[:6], [(0.0,) * 6] * 100))
    refused(
        "log01: no flight in it: by gyro the vehicle never left the ground",
        "report",
        log,
        "-o",
        tmp_path / "out",
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--fail-on", "warning"), "--fail-on warning: known is alarm"),
        (("--mass", "-1"), "expected kilograms"),
    ],
)
def test_options_are_checked_before_logs_are_read(refused, tmp_path, options, said):
    refused(said, "report", tmp_path / "log00", "-o", tmp_path / "out", *options)


def test_a_default_px4_log(quadpi, read_json, shared_data, tmp_path):
    log = shared_data / "logs" / "px4_ekf_failure.ulg"
    assert quadpi("report", log, "-o", tmp_path / "out").status == 0
    flight = read_json(tmp_path / "out" / "report.json")["flights"][0]
    assert flight["settings"][0]["parameter"] == "SDLOG_PROFILE"
    assert flight["settings"][0]["present"] == "1"


def section(stack: str) -> str:
    """What docs/report.md says of a flight stack."""
    page = (Path(__file__).parents[3] / "docs" / "report.md").read_text()
    return page.partition(f"### {stack}\n")[2].partition("\n#")[0]


@pytest.fixture
def flown_as_said(quadpi, read_json, shared_data, tmp_path, monkeypatch):
    """flown_as_said(stack) → the report that the command of its section gives, which is short."""
    monkeypatch.chdir(shared_data)

    def run(stack: str) -> dict:
        text = section(stack)
        assert len(text.split()) <= 150
        (command,) = [line for line in text.splitlines() if line.startswith("quadpi ")]
        words = command.split()[1:]
        words[words.index("-o") + 1] = str(tmp_path / "out")
        assert quadpi(*words).status == 0
        return read_json(tmp_path / "out" / "report.json")

    return run


def test_a_px4_log_as_the_page_says(flown_as_said):
    report = flown_as_said("PX4")
    drag = report["vehicles"][0]["drag"]
    for one in drag["per_mass"]:
        assert 0.1 < (one["high"] - one["low"]) / (2.0 * one["value"]) < 0.45
    assert "fly faster" in drag["ballistic"][0]["reason"] or "too wide" in drag["ballistic"][0]["reason"]
    assert "SDLOG_PROFILE" in {one["parameter"] for one in report["flights"][0]["settings"]}


def test_an_ardupilot_log_as_the_page_says(flown_as_said):
    (flight,) = flown_as_said("ArduPilot")["flights"]
    assert [one["thrust"]["low"] > 0.0 for one in flight["losses"]] == [True, False, False, False]
    assert flight["vibration"]["vibe"]
    assert flight["motors"]["hover"]["value"]
    assert {"LOG_BITMASK", "SERVO_BLH_AUTO"} <= {one["parameter"] for one in flight["settings"]}


def test_a_betaflight_log_as_the_page_says(flown_as_said):
    report = flown_as_said("Betaflight")
    assert 0.005 < report["vehicles"][0]["motor_model"]["error"] < 0.015
    assert report["flights"][0]["motors"]["motors"]


def test_a_crazyflie_log_as_the_page_says(flown_as_said):
    (flight,) = flown_as_said("Crazyflie")["flights"]
    thrusts = [one["thrust"] for one in flight["losses"]]
    assert max(thrusts, key=lambda one: one["value"]) is thrusts[2]
    assert thrusts[2]["low"] < 0.0


def test_a_bag_as_the_page_says(flown_as_said):
    report = flown_as_said("A ROS 2 bag")
    assert report["flights"][0]["flown"]["airborne_s"] > 2.0
    assert "motor commands" in report["flights"][0]["looked_at"]
