# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What commands share: where outputs may go, remarks on the data, names printed as they are."""

from __future__ import annotations

import inspect
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console
from typer.models import CommandInfo

from quadpi_core.cli import app, flight_commands
from quadpi_core.cli.flight_commands import report_vehicle
from quadpi_core.cli.options import (
    check_outputs,
    open_console,
    print_quality,
    reading_options,
    several_topics,
    write_result,
)
from quadpi_core.errors import OutputError, QuadpiError, VehicleError
from quadpi_core.findings import DataQuality, Finding
from quadpi_core.reading_options import ReadingOptions

from .test_report_command import raw


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with an input file and an input folder."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flight.mcap").touch()
    (tmp_path / "model").mkdir()
    return tmp_path


INPUTS = [Path("flight.mcap"), Path("model")]


def test_outputs_beside_the_inputs_are_accepted_and_nothing_is_written(place: Path):
    before = sorted(place.rglob("*"))
    check_outputs(INPUTS, Path("data.json"), None, Path("new/page.html"), folders=[Path("bags"), None])
    check_outputs(INPUTS)
    assert sorted(place.rglob("*")) == before


@pytest.mark.parametrize(
    ("files", "folders"),
    [
        (["flight.mcap"], []),
        (["model"], []),
        (["model/data.json"], []),
        ([], ["model/bags"]),
        (["model/../flight.mcap"], []),
        (["link"], []),
        (["same", "same"], []),
        (["bags/data.json"], ["bags"]),
        (["bags"], ["bags"]),
        ([], ["bags", "bags/deeper"]),
    ],
)
def test_an_output_in_the_place_of_an_input_or_another_output_is_refused(place: Path, files, folders):
    (place / "link").symlink_to(place / "flight.mcap")
    taken = (files or folders)[-1]
    with pytest.raises(QuadpiError, match=rf"^{taken}: would replace or alter an input or another output"):
        check_outputs(INPUTS, *map(Path, files), folders=list(map(Path, folders)))


def test_an_output_that_cannot_be_written_is_refused(place: Path):
    (place / "bags").mkdir()
    with pytest.raises(OutputError, match=r"^bags: cannot be written: Is a directory"):
        check_outputs([], Path("bags"))
    with pytest.raises(OutputError, match=r"^flight\.mcap: cannot be written: Not a directory"):
        check_outputs([], folders=[Path("flight.mcap")])


def test_remarks_name_the_flight_and_are_no_markup():
    console = Console(file=StringIO(), width=40)
    quality = DataQuality(
        findings=(Finding("units", "imu", "looks like [red]g[/red], m/s² expected " + "x" * 50),)
    )
    print_quality(console, [("[bold]flight.mcap", quality), ("other.mcap", DataQuality())])
    assert console.file.getvalue() == (
        "[bold]flight.mcap: topic imu: looks like [red]g[/red], m/s² expected " + "x" * 50 + "\n"
    )


def test_the_terminal_prints_names_as_they_are(capsys: pytest.CaptureFixture[str]):
    open_console().print("[red]wind[/red] :smile:")
    assert capsys.readouterr().out == "[red]wind[/red] :smile:\n"


def test_a_result_is_written_where_it_is_asked_for(tmp_path: Path):
    write_result(None, {"picp": 0.95})
    write_result(tmp_path / "data.json", {"picp": 0.95})
    assert (tmp_path / "data.json").read_text() == '{\n "picp": 0.95\n}\n'
    assert len(list(tmp_path.iterdir())) == 1


def test_any_number_of_topics_follows_one_option():
    given = ["import", "a.mcap", "--topics", "imu=/a/imu", "mocap/pose=/b", "c.mcap", "-o", "x=y", "erpm=/d"]
    assert several_topics(given) == [
        *("import", "a.mcap", "--topics", "imu=/a/imu", "--topics", "mocap/pose=/b", "c.mcap"),
        *("-o", "x=y", "erpm=/d"),
    ]
    assert several_topics(["--topics", "imu=/a", "--topics", "erpm=/b"]) == [
        *("--topics", "imu=/a", "--topics", "erpm=/b"),
    ]
    options = reading_options(["imu=/a/imu", "mocap/pose=/b"], "/a", "file.yaml")
    assert options == ReadingOptions("file.yaml", {"imu": "/a/imu", "mocap/pose": "/b"}, "/a")


@pytest.mark.parametrize(
    ("topics", "refusal"),
    [
        (["imu"], "--topics imu: expected NAME=TOPIC"),
        (["imu=/"], "--topics imu=/: expected NAME=TOPIC"),
        (["imus=/a"], "--topics imus=/a: unknown name imus; known: imu, rotor_speeds.*imu"),
        (["imu=/a", "imu=/b"], "--topics imu=/b: imu is named twice, before as /a"),
    ],
)
def test_a_topic_that_names_nothing_is_refused(topics: list[str], refusal: str):
    with pytest.raises(QuadpiError, match=refusal):
        reading_options(topics, "")


@pytest.mark.parametrize(
    "command",
    ["import", "info", "identify", "evaluate", "rollout", "replay", "view", "discrepancy", "export"],
)
def test_every_command_that_reads_bags_takes_topics(command: str):
    (found,) = (one for one in app.registered_commands if command_name(one) == command)
    parameters = inspect.signature(found.callback).parameters
    assert {"topics", "namespace"} <= set(parameters)


def command_name(command: CommandInfo) -> str:
    return command.name or command.callback.__name__


# A vehicle file of a report: asked for once on a terminal, refused in a sentence without one.


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
