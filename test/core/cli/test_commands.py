# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The command line: every command on every kind of flight, its files and its JSON keys."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import quadpi_core
from quadpi_core.cli import app
from quadpi_core.cli.evaluate_command import group_bags
from quadpi_core.errors import QuadpiError
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.paths import config_directory
from test.core.evaluation.test_flight_results import EVALUATION, METRICS

COMMANDS = sorted(command.name or command.callback.__name__ for command in app.registered_commands)
SLOW_TO_IMPORT = ("numba", "scipy", "plotly", "pyarrow", "rosbags", "safetensors", "rclpy")
RECORDING = {"kind", "name", "vehicle", "source", "topics", "envelope", "findings"}
MODEL = {
    "alarm",
    "kind",
    "name",
    "identity",
    "vehicle",
    "settings",
    "cutoff_hz",
    "confidence",
    "axes",
    "flights",
    "envelope",
}
REPLAY = {
    "samples_in",
    "predictions_out",
    "dropped",
    "alarm_fraction",
    "alarm_first_s",
    "warning_first_s",
    "events",
}


@pytest.fixture
def model(quadpi, bags, pool, tmp_path):
    folder = tmp_path / "model"
    result = quadpi("identify", *bags[:2], "--vehicle", "neurobem", "--candidates", pool, "-o", folder)
    assert result.status == 0, result.errors
    return folder


def read_json(path):
    def refuse(constant):
        raise AssertionError(f"{constant} in {path}")

    return json.loads(path.read_text(), parse_constant=refuse)


def test_every_command_is_known():
    assert COMMANDS == [
        "demo",
        "discrepancy",
        "evaluate",
        "identify",
        "import",
        "info",
        "replay",
        "simulate",
        "validate",
    ]


@pytest.mark.parametrize("command", COMMANDS)
def test_help(quadpi, command):
    result = quadpi(command, "--help")
    assert (result.status, result.errors) == (0, "")
    assert f"quadpi {command}" in result.output


def test_help_lists_the_commands(quadpi):
    result = quadpi("--help")
    assert result.status == 0
    assert all(command in result.output for command in COMMANDS)


@pytest.mark.parametrize("arguments", ["--help", "identify --help", "simulate --help", "demo --help"])
def test_help_imports_nothing_slow(arguments):
    script = (
        f"import sys; sys.argv = ['quadpi', *{arguments.split()}]\n"
        "from quadpi_core.cli import main\n"
        "try: main()\n"
        f"finally: print(sorted(set({SLOW_TO_IMPORT}) & set(sys.modules)), file=sys.stderr)"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ran.stderr == "[]\n"


def test_main_path_on_simulated_flights(quadpi, bags, pool, tmp_path):
    model, result_json, page = tmp_path / "model", tmp_path / "result.json", tmp_path / "page.html"
    identified = quadpi(
        *("identify", *bags[:2], "--vehicle", "neurobem", "--candidates", pool, "-o", model),
        *("--json", result_json, "--html", page),
    )
    assert (identified.status, identified.errors) == (0, "")
    assert "omega_avg^2" in identified.output
    assert sorted(path.name for path in model.iterdir()) == ["arrays.safetensors", "model.json"]
    assert list(read_json(result_json)["groups"]) == ["identification"]
    assert page.read_text().startswith("<!DOCTYPE html>")

    groups = ("--group", f"known={bags[0]},{bags[1]}", "--group", f"new={bags[2]}")
    evaluated = quadpi("evaluate", model, *groups, "--json", result_json, "--html", page)
    assert (evaluated.status, evaluated.errors) == (0, "")
    assert "known" in evaluated.output
    evaluation = read_json(result_json)
    assert [part["flights"] for part in evaluation["groups"].values()] == [
        ["flight0", "flight1"],
        ["flight2"],
    ]
    assert evaluation["groups"]["new"]["axes"]["Fz"]["picp"] > 0.8

    adapted = quadpi("evaluate", model, bags[2], "--adaptive", "--json", result_json)
    assert (adapted.status, adapted.errors) == (0, "")
    assert "adaptive" in adapted.output
    assert read_json(result_json)["adaptive"]
    new = read_json(result_json)["groups"]["all"]["axes"]["Fz"]
    assert abs(new["picp"] - 0.95) < abs(evaluation["groups"]["new"]["axes"]["Fz"]["picp"] - 0.95)

    own, adaptive = tmp_path / "own.mcap", tmp_path / "adaptive.mcap"
    assert quadpi("replay", model, bags[2], "-o", own).status == 0
    assert quadpi("replay", model, bags[2], "-o", adaptive, "--adaptive").status == 0
    assert own.read_bytes() != adaptive.read_bytes()

    replayed = quadpi("replay", model, bags[2], "-o", tmp_path / "out.mcap", "--json", result_json)
    assert (replayed.status, replayed.errors) == (0, "")
    assert read_json(result_json) == json.loads(replayed.output)
    assert read_json(result_json)["predictions_out"] > 0
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "logs", "options"),
    [
        ("neurobem", "neurobem/bemnn2021021817*.mat", ()),
        ("crazyflie_rpm", "imrc_brushless/eckart0[0-2]", ()),
        ("nanodrone", "nanodrone/random1_*_run[12].parquet", ("--mapping", "nanodrone")),
    ],
)
def test_main_path_on_real_flights(quadpi, shared_data, tmp_path, vehicle, logs, options):
    sources = sorted(shared_data.glob(logs))
    folder, model, data = tmp_path / "bags", tmp_path / "model", tmp_path / "data.json"
    chosen = ("--vehicle", vehicle)
    assert quadpi("import", *sources, *chosen, *options, "-o", folder).status == 0
    flights = sorted(folder.iterdir())
    assert [flight.stem for flight in flights] == [source.stem for source in sources]
    for path in (sources[0], flights[0]):
        mapped = options if path is sources[0] else ()
        assert quadpi("info", path, *chosen, *mapped, "--json", data).status == 0
        assert read_json(data)["vehicle"] == vehicle
    identified = quadpi("identify", *flights, *chosen, "--axes", "Fx,Fz", "-o", model)
    assert identified.status == 0, identified.errors
    evaluated = quadpi("evaluate", model, *flights, "--json", data)
    assert evaluated.status == 0, evaluated.errors
    for axis in read_json(data)["groups"]["all"]["axes"].values():
        assert axis["picp"] > 0.9
    replayed = quadpi("replay", model, flights[0], "-o", tmp_path / "out.mcap")
    assert replayed.status == 0, replayed.errors
    assert json.loads(replayed.output)["predictions_out"] > 0


def test_version(quadpi):
    assert quadpi("--version").output.strip() == f"quadpi {quadpi_core.__version__}"


def test_import_keeps_every_stream(quadpi, bags, tmp_path):
    assert quadpi("import", *bags, "--vehicle", "neurobem", "-o", tmp_path / "again").status == 0
    for bag in bags:
        assert (tmp_path / "again" / bag.name).read_bytes()[:8] == b"\x89MCAP0\r\n"
        original, again = read_recording(bag, None), read_recording(tmp_path / "again" / bag.name, None)
        assert [len(stream) for stream in again.streams()] == [len(stream) for stream in original.streams()]


@pytest.mark.slow
def test_a_cluster_reads_for_every_command(quadpi, bags, pool, cluster, tmp_path):
    """`--scheduler`, and the same results as without."""
    results = []
    for place, options in (("here", ()), ("there", ("--scheduler", cluster))):
        folder = tmp_path / place
        model, data = folder / "model", folder / "data.json"
        vehicle = ("--vehicle", "neurobem")
        runs = [
            ("import", *bags, *vehicle, "-o", folder / "bags"),
            ("identify", *bags, *vehicle, "--candidates", pool, "-o", model, "--json", data),
            ("evaluate", model, *bags, "--json", folder / "evaluation.json"),
            ("replay", model, *bags, "-o", folder / "replayed", "--json", folder / "replays.json"),
        ]
        for run in runs:
            result = quadpi(*run, *options)
            assert (result.status, result.errors) == (0, ""), run
        results.append({file.relative_to(folder): file.read_bytes() for file in folder.rglob("*.*")})
    assert results[0] == results[1]
    assert len(results[0]) == 2 * len(bags) + 2 + 3


def test_import_aligns_motion_capture_with_the_gyro(quadpi, fly, tmp_path):
    recording = fly(0)
    late = replace(recording.pose, time_ns=recording.pose.time_ns + 40_000_000)
    write_bag(tmp_path / "late.mcap", replace(recording, pose=late))
    run = quadpi(
        "import", tmp_path / "late.mcap", "--vehicle", "neurobem", "--align", "-o", tmp_path / "bags"
    )
    assert run.status == 0
    moved = read_recording(tmp_path / "bags" / "late.mcap", None).pose
    assert abs(int(moved.time_ns[0] - recording.pose.time_ns[0])) < 2_000_000


class TestJsonKeys:
    """What docs/commands.md promises."""

    def test_info_of_a_bag(self, quadpi, bags, tmp_path):
        assert quadpi("info", bags[0], "--json", tmp_path / "info.json").status == 0
        info = read_json(tmp_path / "info.json")
        assert (set(info), info["kind"], info["vehicle"]) == (RECORDING, "recording", "neurobem")
        assert {topic["topic"] for topic in info["topics"]} == {"imu", "rotor_speeds", "mocap/pose"}
        assert info["findings"] == []

    def test_info_of_a_replay(self, quadpi, model, bags, tmp_path):
        assert quadpi("replay", model, bags[0], "-o", tmp_path / "out.mcap").status == 0
        shown = quadpi("info", tmp_path / "out.mcap", "--json", tmp_path / "info.json")
        assert (shown.status, shown.errors) == (0, "")
        info = read_json(tmp_path / "info.json")
        assert set(info) == RECORDING
        counts = {topic["topic"]: topic["count"] for topic in info["topics"]}
        assert list(counts) == ["/extrapolation_alarm", "/odometry", "/prediction"]
        assert counts["/prediction"] > 0
        assert "no topic imu" in info["findings"][0]

    def test_info_of_a_model(self, quadpi, model, tmp_path):
        assert quadpi("info", model, "--json", tmp_path / "info.json").status == 0
        info = read_json(tmp_path / "info.json")
        assert (set(info), info["kind"], info["settings"]) == (MODEL, "model", "default")
        assert list(info["envelope"]) == list(INPUT_NAMES)
        assert info["axes"]["Fx"][:2] == ["bias", "u"]

    def test_evaluate(self, quadpi, model, bags, tmp_path):
        assert quadpi("evaluate", model, *bags[:2], "--json", tmp_path / "evaluation.json").status == 0
        evaluation = read_json(tmp_path / "evaluation.json")
        assert set(evaluation) == EVALUATION
        assert set(evaluation["groups"]) == {"all"}
        assert set(evaluation["groups"]["all"]) == {"flights", "axes", "alarm"}
        assert set(evaluation["flights"]) == {"flight0", "flight1"}
        for part in (evaluation["groups"]["all"], *evaluation["flights"].values()):
            assert set(part["axes"]) == {"Fx", "Fz", "Mx"}
            assert all(set(axis) == METRICS for axis in part["axes"].values())
        assert set(evaluation["flights"]["flight0"]) == {"duration_s", "axes", "alarm"}

    def test_replay(self, quadpi, model, bags, tmp_path):
        output = tmp_path / "out.mcap"
        assert quadpi("replay", model, bags[0], "-o", output, "--json", tmp_path / "replay.json").status == 0
        assert set(read_json(tmp_path / "replay.json")) == REPLAY

    def test_replay_of_several(self, quadpi, model, bags, tmp_path):
        out, data = tmp_path / "out", tmp_path / "replay.json"
        replayed = quadpi("replay", model, *bags, "-o", out, "--json", data)
        assert (replayed.status, replayed.errors) == (0, "")
        flights = read_json(data)["flights"]
        assert read_json(data) == json.loads(replayed.output) == {"flights": flights}
        assert list(flights) == ["flight0", "flight1", "flight2"]
        assert sorted(path.name for path in out.iterdir()) == [bag.name for bag in bags]
        alone = tmp_path / "alone.mcap"
        assert quadpi("replay", model, bags[1], "-o", alone, "--json", data).status == 0
        assert read_json(data) == flights["flight1"]
        assert alone.read_bytes() == (out / "flight1.mcap").read_bytes()


def test_axes_and_confidence_are_those_asked_for(quadpi, bags, pool, tmp_path):
    model, data = tmp_path / "model", tmp_path / "data.json"
    base = ("identify", *bags, "--vehicle", "neurobem", "--candidates", pool, "-o", model)
    assert quadpi(*base, "--axes", "Fz", "--confidence", "0.9", "--cutoff-hz", "12").status == 0
    assert quadpi("info", model, "--json", data).status == 0
    info = read_json(data)
    assert (list(info["axes"]), info["confidence"], info["cutoff_hz"]) == (["Fz"], 0.9, 12.0)
    widths = []
    for options in ((), ("--confidence", "0.99")):
        assert quadpi("evaluate", model, bags[0], *options, "--json", data).status == 0
        widths.append(read_json(data)["groups"]["all"]["axes"]["Fz"]["mpiw"])
    assert widths[0] < widths[1]


def test_vehicle_file_of_the_user(quadpi, bags, pool, tmp_path):
    """A model names its vehicle only: where that is none of config/vehicles, --vehicle says where it is."""
    mine = tmp_path / "mine.yaml"
    mine.write_text((config_directory() / "vehicles" / "neurobem.yaml").read_text())
    flights = [tmp_path / bag.name for bag in bags[:2]]
    for bag, flight in zip(bags, flights, strict=False):
        write_bag(flight, replace(read_recording(bag, None), vehicle="mine"))
    model = tmp_path / "model"
    identified = quadpi("identify", *flights, "--vehicle", mine, "--candidates", pool, "-o", model)
    assert identified.status == 0, identified.errors
    without = quadpi("evaluate", model, flights[0])
    assert without.status == 2
    assert re.search(r"model \S+: its vehicle: .*mine.yaml: no such vehicle file", without.errors)
    assert quadpi("evaluate", model, flights[0], "--vehicle", mine).status == 0
    assert quadpi("replay", model, flights[0], "--vehicle", mine, "-o", tmp_path / "out.mcap").status == 0


class TestGroups:
    A, B, C = Path("a.mcap"), Path("b.mcap"), Path("c.mcap")

    def test_positional_flights_are_the_group_all(self):
        assert group_bags([self.A, self.B], []) == {"all": [self.A, self.B]}

    def test_commas_and_repeats_add_up(self):
        assert group_bags([], ["slow=a.mcap,b.mcap", "fast=b.mcap", "slow=c.mcap"]) == {
            "slow": [self.A, self.B, self.C],
            "fast": [self.B],
        }

    def test_a_path_may_hold_the_sign(self):
        assert group_bags([self.A], ["x=run=1/b.mcap"]) == {"all": [self.A], "x": [Path("run=1/b.mcap")]}

    @pytest.mark.parametrize("text", ["a.mcap", "=a.mcap", "slow=", "", "slow=a.mcap,", "slow=,a.mcap"])
    def test_what_is_no_group_is_refused(self, text):
        with pytest.raises(QuadpiError, match=r"--group .*: expected NAME=BAG"):
            group_bags([self.A], [text])

    def test_no_flight_is_refused(self):
        with pytest.raises(QuadpiError, match="no flights given"):
            group_bags([], [])

    def test_a_flight_may_be_in_two_groups(self, quadpi, model, bags, tmp_path):
        groups = ("--group", f"one={bags[0]}", "--group", f"both={bags[0]},{bags[1]}")
        assert quadpi("evaluate", model, *groups, "--json", tmp_path / "data.json").status == 0
        evaluation = read_json(tmp_path / "data.json")
        assert evaluation["groups"]["both"]["flights"] == ["flight0", "flight1"]
        assert evaluation["groups"]["one"]["axes"] == evaluation["flights"]["flight0"]["axes"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["identify", "{bag}", "-o", "m"], "--vehicle"),
        (["identify", "{bag}", "--vehicle", "neurobem"], "--output"),
        (["identify", "{bag}", "--vehicle", "neurobem", "-o", "m", "--settings", "best"], "--settings"),
        (["identify", "{bag}", "--vehicle", "neurobem", "-o", "m", "--method", "magic"], "--method"),
        (["info", "{bag}", "--colour"], "--colour"),
        (["fly"], "fly"),
    ],
)
def test_wrong_usage(quadpi, bags, arguments, message):
    result = quadpi(*(argument.format(bag=bags[0]) for argument in arguments))
    assert (result.status, result.output) == (2, "")
    assert message in result.errors
    assert "Traceback" not in result.errors


def test_demo_without_ros_says_what_is_missing(quadpi, monkeypatch):
    monkeypatch.setitem(sys.modules, "quadpi_ros.demo", None)
    result = quadpi("demo")
    assert result.status == 2
    assert "needs ROS 2" in result.errors


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf"])
def test_demo_refuses_a_rate_before_it_starts(quadpi, tmp_path, rate):
    pytest.importorskip("rclpy")
    result = quadpi("demo", "--rate", rate, "-o", tmp_path / "out")
    assert result.status == 2
    assert "--rate must be positive" in result.errors
    assert list(tmp_path.iterdir()) == []


def test_demo_without_data_says_what_to_provide(quadpi, tmp_path):
    pytest.importorskip("rclpy")
    result = quadpi("demo", "--data", tmp_path, "-o", tmp_path / "out")
    assert result.status == 2
    assert "NeuroBEM" in result.errors
    assert list(tmp_path.iterdir()) == []
