# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What `quadpi info` shows of logs and models."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from quadpi_core.cli.flight_commands import not_judged_sentences, replay_table
from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, OdometryStream, Recording
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic
from quadpi_core.logs.inspect import inspect_recording
from quadpi_core.messages.sensor_messages import pack_imu, pack_odometry
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.monitor.alarm import NotJudgedReason
from quadpi_core.monitor.replay import ReplaySummary
from quadpi_core.paths import bags_directory
from quadpi_core.report.info_tables import (
    best_known_table,
    describe,
    inspection_tables,
    selection_table,
    structure_table,
)
from quadpi_core.report.table import terminal_table


def shown(tables) -> str:
    console = Console(width=80, record=True, file=io.StringIO())
    for table in tables:
        console.print(table)
    return console.export_text()


@pytest.fixture
def recording() -> Recording:
    time_ns = np.arange(10, dtype=np.int64) * 2_000_000
    time_ns[5] = time_ns[4]
    force = np.tile([0.0, 0.0, -9.81], (10, 1))
    return Recording("flight", "", "flight.mcap", ImuStream(time_ns, np.zeros((10, 3)), force))


def test_tables_fit_a_terminal_and_name_what_is_wrong(recording: Recording):
    text = shown(map(terminal_table, inspection_tables(inspect_recording(recording))))
    assert "flight · vehicle not given" in text
    assert "…" not in text
    assert "topic imu: 1 stamps repeat" in text
    assert "no rotor speeds: rules out identification, prediction and replay" in text


def test_long_topics_do_not_cut_the_numbers(recording: Recording):
    inspection = inspect_recording(recording)
    topics = tuple(replace(topic, topic=f"/{40 * 'n'}") for topic in inspection.topics)
    text = shown(map(terminal_table, inspection_tables(replace(inspection, topics=topics))))
    assert "…" not in text
    assert text.count("n") > 40


def test_a_good_log_has_nothing_suspicious(shared_data: Path):
    path = shared_data / "neurobem" / "bemnn20210223104803seg2.mat"
    tables, data = describe(path, "neurobem", None)
    assert "nothing suspicious" in shown(tables)
    assert json.loads(json.dumps(data))["findings"] == []
    assert [topic["topic"] for topic in data["topics"]] == ["imu", "rotor_speeds", "mocap/pose", "odometry"]
    assert data["topics"][0]["rate_hz"] == pytest.approx(400.0)


def test_a_log_can_be_described_without_its_vehicle(shared_data: Path):
    tables, data = describe(shared_data / "imrc_brushless" / "eckart00", None, None)
    assert data["vehicle"] == ""
    assert "mocap/pose" in shown(tables)


def test_what_is_no_log_is_one_error(tmp_path: Path):
    (tmp_path / "notes.rtf").write_text("not a log")
    with pytest.raises(LogError, match=r"notes\.rtf: not a known log format"):
        describe(tmp_path / "notes.rtf", None, None)


def test_topics_are_named_as_in_the_bag(tmp_path: Path):
    _, data = describe(bags_directory() / "interpolation.mcap", None, None)
    assert [topic["topic"] for topic in data["topics"]] == ["imu", "erpm", "mocap/pose"]

    time_ns = np.arange(200, dtype=np.int64) * 2_000_000
    force = np.tile([0.0, 0.0, -9.81], (200, 1))
    odometry = pack_odometry(
        OdometryStream(time_ns, np.zeros((200, 3)), np.tile([1.0, 0, 0, 0], (200, 1)), force, force)
    )
    imu = pack_imu(ImuStream(time_ns, np.zeros((200, 3)), force))
    topics = [
        replace(output_topic("imu", time_ns, imu), name="/uav/imu"),
        replace(output_topic("mocap/odometry", time_ns, odometry), name="/uav/mocap/odometry"),
    ]
    write_mcap(tmp_path / "uav.mcap", topics, {})
    _, data = describe(tmp_path / "uav.mcap", None, None)
    assert [topic["topic"] for topic in data["topics"]] == ["uav/imu", "uav/mocap/odometry"]
    assert any(finding.startswith("topic uav/mocap/odometry: ") for finding in data["findings"])


def test_terms_are_in_the_order_of_selection(case, markdown_cells):
    again = [
        *case.model.selection["Fx"],
        {"term": "|v|*w", "coefficient": 2.0, "r2": 0.95, "fixed": False},
        {"term": "mu_x * omega_avg", "coefficient": 1.5, "r2": 0.96, "fixed": False},
    ]
    # A term that was taken out and came back stands where it came back; one that is left out, nowhere.
    selection = case.model.selection | {"Fx": again}
    heading, *body = markdown_cells(structure_table(selection, ["Fx", "Mz"]))
    assert heading == ["Fx", "coefficient", "R²", "Mz", "coefficient", "R²"]
    assert body[0] == ["*`1`*", "-2.000e-01", "–"] * 2
    assert body[1][:3] == ["`¦v¦*w`", "2.000e+00", "0.9500"]
    assert [row[0] for row in body] == ["*`1`*", "`¦v¦*w`", "`mu_x * omega_avg`"]


def test_selection_table_shows_what_the_model_holds(case, rendered):
    text = rendered(terminal_table(selection_table(case.model.selection["Fx"], "Fx")))
    (kept,) = [line.split() for line in text.splitlines() if "mu_x" in line]
    assert kept == ["mu_x", "*", "omega_avg", "1.5000e+00", "0.9000", "0.100"]
    (out,) = [line.split() for line in text.splitlines() if line.strip().startswith("p ")]
    assert out[1] == "–"


def test_the_best_known_parameters_come_first(case, predicting):
    table = best_known_table(AerodynamicModel.load(predicting), 5)
    assert table is not None
    known = [abs(row[1]) / row[2] for row in table.rows]
    assert len(known) == 5
    assert known == sorted(known, reverse=True)
    assert "thrust" in {row[0] for row in table.rows}
    # A polynomial has terms, and no standard errors to show.
    assert best_known_table(case.model, 5) is None


# The table of a replay says for each flight when and how long the alarm stood.


QUIET = ReplaySummary(
    samples_in=6000,
    predictions_out=5990,
    dropped=0,
    alarm_fraction=0.0,
    alarm_first_s=None,
    warning_first_s=2.5,
    events=0,
    not_judged_fraction=0.1,
    not_judged_reasons=(NotJudgedReason("on the ground", 0.08), NotJudgedReason("the state settles", 0.02)),
)


def test_each_flight_with_its_alarm(markdown_cells):
    loud = replace(QUIET, alarm_fraction=0.254, alarm_first_s=3.25, events=2, dropped=4)
    head, *rows = markdown_cells(replay_table({"calm": QUIET, "fast": loud}))
    calm, fast = (dict(zip(head, row, strict=True)) for row in rows)
    assert (calm["flight"], calm["alarm"], calm["first s"]) == ("calm", "0.0 %", "none")
    assert (calm["warned s"], calm["predicted"]) == ("2.50", "99.8 %")
    assert (fast["first s"], fast["events"], fast["dropped"]) == ("3.25", "2", "**4**")
    assert "25.4 %" in fast["alarm"]
    assert calm["not judged"] == "10.0 %"


def test_what_was_not_judged_says_why():
    judged = replace(QUIET, not_judged_fraction=0.0, not_judged_reasons=())
    assert list(not_judged_sentences({"calm": QUIET, "all": judged})) == [
        "calm: not judged 10.0 % of the flight: on the ground 8.0 %, the state settles 2.0 %"
    ]
