# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The command line as a whole: one flight through every command, help, wrong usage."""

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
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.paths import bags_directory, config_directory

COMMANDS = sorted(command.name or command.callback.__name__ for command in app.registered_commands)
SLOW_TO_IMPORT = (
    "scipy",
    "jinja2",
    "distributed",
    "pyarrow",
    "rosbags",
    "safetensors",
    "rclpy",
)


def test_every_command_is_known():
    assert COMMANDS == [
        "demo",
        "discrepancy",
        "evaluate",
        "export",
        "identify",
        "import",
        "info",
        "replay",
        "report",
        "rollout",
        "simulate",
        "validate",
        "view",
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


def imported(arguments, names):
    """Those of some modules that a run of the command line has imported in the end."""
    script = (
        f"import sys; sys.argv = ['quadpi', *{arguments!r}]\n"
        "from quadpi_core.cli import main\n"
        "try: main()\n"
        f"finally: print(*sorted(set({names}) & set(sys.modules)), file=sys.stderr)"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    return ran.stderr.split()


@pytest.mark.parametrize("arguments", ["--help", "identify --help", "simulate --help", "demo --help"])
def test_help_imports_nothing_slow(arguments):
    assert imported(arguments.split(), SLOW_TO_IMPORT) == []


def test_commands_import_no_module_of_scipy_that_takes_a_second(bags, tmp_path):
    slow, model = ("scipy.signal", "scipy.stats"), Path(__file__).parents[2] / "golden" / "model"
    assert (
        imported(["import", str(bags[0]), "--vehicle", "neurobem", "-o", str(tmp_path / "bags")], slow) == []
    )
    assert imported(["evaluate", str(model), str(bags_directory() / "interpolation.mcap")], slow) == []


def test_main_path_on_simulated_flights(read_json, quadpi, bags, pool, tmp_path):
    model, result_json, page = tmp_path / "model", tmp_path / "result.json", tmp_path / "page.html"
    identified = quadpi(
        *("identify", *bags[:2], "--vehicle", "neurobem", "--candidates", pool, "-o", model),
        *("--json", result_json, "--html", page, "--verbose"),
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
    assert "not judged" in replayed.output
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
def test_main_path_on_real_flights(read_json, quadpi, shared_data, tmp_path, vehicle, logs, options):
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
    replayed = quadpi("replay", model, flights[0], "-o", tmp_path / "out.mcap", "--json", data)
    assert replayed.status == 0, replayed.errors
    assert read_json(data)["predictions_out"] > 0


def test_version(quadpi):
    assert quadpi("--version").output.strip() == f"quadpi {quadpi_core.__version__}"


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


def test_vehicle_file_of_the_user(quadpi, bags, pool, tmp_path):
    """A model holds its vehicle; one of an older version names it only, and --vehicle says where it is."""
    mine = tmp_path / "mine.yaml"
    mine.write_text((config_directory() / "vehicles" / "neurobem.yaml").read_text())
    flights = [tmp_path / bag.name for bag in bags[:2]]
    for bag, flight in zip(bags, flights, strict=False):
        write_bag(flight, replace(read_recording(bag, None), vehicle="mine"))
    model = tmp_path / "model"
    identified = quadpi("identify", *flights, "--vehicle", mine, "--candidates", pool, "-o", model)
    assert identified.status == 0, identified.errors
    assert quadpi("evaluate", model, flights[0]).status == 0
    assert quadpi("replay", model, flights[0], "-o", tmp_path / "out.mcap").status == 0
    described = json.loads((model / "model.json").read_text())
    del described["vehicle_file"]
    (model / "model.json").write_text(json.dumps(described))
    without = quadpi("evaluate", model, flights[0])
    assert without.status == 2
    assert re.search(r"model \S+: its vehicle: .*mine.yaml: no such vehicle file", without.errors)
    assert quadpi("evaluate", model, flights[0], "--vehicle", mine).status == 0


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
