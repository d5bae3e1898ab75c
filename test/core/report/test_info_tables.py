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

from quadpi_core.errors import LogError
from quadpi_core.flight import ImuStream, OdometryStream, Recording
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic
from quadpi_core.logs.inspect import inspect_recording
from quadpi_core.messages.sensor_messages import pack_imu, pack_odometry
from quadpi_core.paths import bags_directory
from quadpi_core.report.info_tables import describe, inspection_tables
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
