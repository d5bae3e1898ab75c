# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A vehicle file of a report: asked for once on a terminal, refused in a sentence without one."""

from __future__ import annotations

import pytest

from quadpi_core.cli import flight_commands
from quadpi_core.cli.flight_commands import report_vehicle
from quadpi_core.errors import VehicleError

from .test_report_command import raw


@pytest.fixture
def answered(monkeypatch):
    """answered(*answers): a terminal at which somebody types these; returns what was asked."""

    def answer(*answers: str) -> list[str]:
        asked, left = [], list(answers)

        def prompt(text, **_):
            asked.append(text.partition(":")[0])
            return left.pop(0)

        for stream in (flight_commands.sys.stdin, flight_commands.sys.stdout):
            monkeypatch.setattr(stream, "isatty", lambda: True)
        monkeypatch.setattr(flight_commands.typer, "prompt", prompt)
        return asked

    return answer


def test_values_are_asked_for_once_by_name_and_kept(answered, tmp_path):
    file = tmp_path / "my-quad.yaml"
    asked = answered("1.25", "7")
    assert report_vehicle(str(file)) == (7, 1.25)
    assert asked == ["mass_kg", "pole_pairs"]
    assert file.read_text() == "mass_kg: 1.25\npole_pairs: 7\n"
    assert report_vehicle(str(file)) == (7, 1.25)
    assert len(asked) == 2


def test_what_is_not_known_is_not_asked_for_again(answered, tmp_path):
    asked = answered("", "")
    for _ in range(2):
        assert report_vehicle(str(tmp_path / "my-quad.yaml")) == (None, None)
    assert len(asked) == 2


@pytest.mark.parametrize(("answer", "said"), [("-1", "mass_kg"), ("heavy", "mass_kg"), ("[1.2", "mass_kg")])
def test_no_answer_that_is_impossible_is_kept(answered, tmp_path, answer, said):
    answered(answer, "")
    with pytest.raises(VehicleError, match=said):
        report_vehicle(str(tmp_path / "my-quad.yaml"))
    assert not list(tmp_path.iterdir())


def test_a_whole_vehicle_file_gives_its_mass():
    vehicle, mass = report_vehicle("neurobem")
    assert (vehicle.name, mass) == ("neurobem", 0.772)


def test_without_a_terminal_it_is_a_sentence(refused, quadpi, read_json, tmp_path):
    log, file, out = raw(tmp_path / "log00"), tmp_path / "my-quad.yaml", tmp_path / "out"
    said = "my-quad.yaml: does not exist; write mass_kg and pole_pairs into it"
    refused(said, "report", log, "--vehicle", file, "-o", out)
    file.write_text("mass_kg: 0.5\n")
    assert quadpi("report", log, "--vehicle", file, "-o", out).status == 0
    assert read_json(out / "report.json")["mass_kg"] == 0.5
