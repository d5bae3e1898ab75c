# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Commands on logs: info, import and export."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.paths import bags_directory

RECORDING = {"kind", "name", "vehicle", "source", "topics", "envelope", "findings"}
MODEL = {
    "alarm",
    "change",
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
    "facts",
}


def test_info_of_a_bag(read_json, quadpi, bags, tmp_path):
    assert quadpi("info", bags[0], "--json", tmp_path / "info.json").status == 0
    info = read_json(tmp_path / "info.json")
    assert (set(info), info["kind"], info["vehicle"]) == (RECORDING, "recording", "neurobem")
    assert {topic["topic"] for topic in info["topics"]} == {"imu", "rotor_speeds", "mocap/pose"}
    assert info["findings"] == []


def test_info_of_a_replay(read_json, quadpi, model, bags, tmp_path):
    assert quadpi("replay", model, bags[0], "-o", tmp_path / "out.mcap").status == 0
    shown = quadpi("info", tmp_path / "out.mcap", "--json", tmp_path / "info.json")
    assert (shown.status, shown.errors) == (0, "")
    info = read_json(tmp_path / "info.json")
    assert set(info) == RECORDING
    counts = {topic["topic"]: topic["count"] for topic in info["topics"]}
    assert list(counts) == ["/extrapolation_alarm", "/odometry", "/prediction"]
    assert counts["/prediction"] > 0
    assert "no topic imu" in info["findings"][0]


def test_info_of_a_model(read_json, quadpi, model, tmp_path):
    assert quadpi("info", model, "--json", tmp_path / "info.json").status == 0
    info = read_json(tmp_path / "info.json")
    assert (set(info), info["kind"], info["settings"]) == (MODEL, "model", "default")
    assert list(info["envelope"]) == list(INPUT_NAMES)
    assert info["axes"]["Fx"][:2] == ["bias", "u"]


# `quadpi import`: every stream is in the bag, motion capture moved where that is asked for.


def test_import_keeps_every_stream(quadpi, bags, tmp_path):
    assert quadpi("import", *bags, "--vehicle", "neurobem", "-o", tmp_path / "again").status == 0
    for bag in bags:
        assert (tmp_path / "again" / bag.name).read_bytes()[:8] == b"\x89MCAP0\r\n"
        original, again = read_recording(bag, None), read_recording(tmp_path / "again" / bag.name, None)
        assert [len(stream) for stream in again.streams()] == [len(stream) for stream in original.streams()]


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


# `quadpi export`: a vehicle file that `simulate` flies as the folder; a flight for Rerun, or as a table.


BAG = bags_directory() / "extrapolation.mcap"
GOLDEN = Path(__file__).parents[2] / "golden" / "model"
SHORT = """
description: one swing
vehicle: bebop2
seed: 1
flights:
  swing:
    duration_s: 10.0
    motion:
      x: [{sine: {amplitude_m: 1.0, frequency_hz: 0.3, start_s: 0.5, duration_s: 9.0, fade_s: 3.0}}]
"""


def test_simulate_and_discrepancy_take_folder_and_file(physical_folder, quadpi, read_json, tmp_path):
    file, scenario, result = tmp_path / "bebop2.yaml", tmp_path / "short.yaml", tmp_path / "flown.json"
    scenario.write_text(SHORT)
    exported = quadpi("export", physical_folder, "--format", "vehicle", "-o", file)
    assert (exported.status, exported.errors) == (0, "")
    assert f"flies as {physical_folder}" in exported.output.replace("\n", "")
    flown = []
    for vehicle in (physical_folder, file):
        ran = quadpi(
            *("simulate", scenario, "--vehicle", vehicle, "--noise", physical_folder),
            *("-o", tmp_path / "bags", "--json", result),
        )
        assert (ran.status, ran.errors) == (0, "")
        (flight,) = read_json(result)["flights"]
        assert flight["vehicle"] == "bebop2"
        assert flight["beyond_identified"] is None
        flown.append(flight["tracking_rms_m"])
    assert flown[0] == flown[1]


@pytest.mark.parametrize(
    ("form", "name", "part"),
    [
        ("px4", "own.params", "\tEKF2_MCOEF\t"),
        ("ardupilot", "own.parm", "EK3_DRAG_MCOEF,"),
        ("sdf", "own.sdf", "<motorConstant>"),
        ("mjcf", "own.xml", "<motor name="),
        ("json", "own.json", '"thrust_n_s2"'),
    ],
)
def test_a_model_in_the_forms_of_others(physical_folder, quadpi, tmp_path, form, name, part):
    done = quadpi("export", physical_folder, "--format", form, "-o", tmp_path / name)
    assert (done.status, done.errors) == (0, "")
    assert part in (tmp_path / name).read_text()
    assert "thrust_exponent: not identified: the model knows rotor speeds alone" in done.output


def test_a_log_gives_the_thrust_of_hover(physical_folder, quadpi, refused, tmp_path, shared_data):
    output = tmp_path / "own.parm"
    logs = [shared_data / "rrc_propeller" / name for name in ("hover_good_1.BIN", "line_good_1.BIN")]
    done = quadpi("export", physical_folder, "--format", "ardupilot", "--log", logs[0], "-o", output)
    assert (done.status, done.errors) == (0, "")
    assert "MOT_THST_HOVER,0." in output.read_text()
    (unread := tmp_path / "broken.BIN").write_bytes(b"\xa3\x95")
    done = quadpi(
        *("export", physical_folder, "--format", "ardupilot", "-o", output),
        *("--log", logs[0], "--log", unread),
    )
    assert done.status == 3
    assert "left out broken" in done.errors
    other = shared_data / "crazypad" / "normal_flight_E9_log00"
    refused(
        "the logs are of 2 vehicles",
        *("export", physical_folder, "--format", "ardupilot", "-o", output),
        *("--log", logs[1], "--log", other),
    )


def test_what_cannot_be_exported(refused, tmp_path, physical_folder):
    refused("cannot be simulated", "export", GOLDEN, "-o", tmp_path / "own.yaml")
    refused("ends in .yaml", "export", physical_folder, "-o", tmp_path / "own.urdf")
    refused("cannot be simulated", "simulate", "bundled", "--vehicle", GOLDEN, "-o", tmp_path / "bags")
    refused("--model: is not for", "export", GOLDEN, "--model", GOLDEN, "-o", tmp_path / "own.yaml")
    refused("--log: is not for", "export", GOLDEN, "--log", GOLDEN, "-o", tmp_path / "own.yaml")
    refused("needs the thrust", "export", GOLDEN, "--format", "mjcf", "-o", tmp_path / "own.xml")


RERUN = ("export", BAG, "--format", "rerun")


def test_a_flight_without_results_names_the_command_that_judges_it(refused, tmp_path):
    pytest.importorskip("rerun", reason="Rerun is not installed: extra `rerun`")
    output = tmp_path / "flight.rrd"
    advice = f"judge it by a model: quadpi export {BAG} --format rerun -o {output} --model MODEL"
    refused(advice, *RERUN, "-o", output)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_exported_for_rerun(refused, tmp_path):
    output = tmp_path / "flight.rrd"
    refused("a file of the form rerun ends in .rrd", *RERUN, "-o", tmp_path / "flight.mcap")
    refused("--confidence: is that of the models", *RERUN, "--confidence", "0.9", "-o", output)
    refused(
        "is of vehicle bebop2, not neurobem", *RERUN, "--model", GOLDEN, "--vehicle", "neurobem", "-o", output
    )
    assert not list(tmp_path.iterdir())


def test_without_rerun_the_extra_is_named(refused, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    refused(r"pip install quadpi-monitor\[rerun\]", *RERUN, "--model", GOLDEN, "-o", tmp_path / "flight.rrd")
    assert not list(tmp_path.iterdir())


def test_a_bag_that_is_cut_off_is_exported_up_to_the_cut_which_is_said(quadpi, tmp_path):
    pytest.importorskip("rerun", reason="Rerun is not installed: extra `rerun`")
    bag, content = tmp_path / "flight.mcap", BAG.read_bytes()
    bag.write_bytes(content[: len(content) // 2])
    outcome = quadpi("export", bag, "--format", "rerun", "--model", GOLDEN, "-o", tmp_path / "flight.rrd")
    assert outcome.status == 0
    assert f"{bag}: bag: the file is cut off, what comes before is shown" in outcome.output


def test_recorded_results_and_those_of_a_model_are_the_same_recording(quadpi, tmp_path):
    """As `quadpi replay` judges the flight and as the export does: the wrench and its bands are equal."""
    pytest.importorskip("rerun", reason="Rerun is not installed: extra `rerun`")
    chunk = pytest.importorskip("rerun.chunk", reason="this Rerun does not read its files")
    replayed, files = tmp_path / "replayed.mcap", [tmp_path / "judged.rrd", tmp_path / "recorded.rrd"]
    assert quadpi("replay", GOLDEN, BAG, "-o", replayed).status == 0
    for bag, more, file in ((BAG, ("--model", GOLDEN), files[0]), (replayed, (), files[1])):
        outcome = quadpi("export", bag, "--format", "rerun", *more, "--rate", 1000, "-o", file)
        assert (outcome.status, outcome.errors) == (0, "")
        assert f"rerun {file}" in outcome.output.replace("\n", "")

    def wrench(file):
        rows = {}
        for one in chunk.RrdReader(str(file)).stream():
            if one.entity_path == "/wrench/Fx" and not one.is_static:
                batch = one.to_record_batch()
                (name,) = [name for name in batch.schema.names if name.endswith(":scalars")]
                rows |= zip(batch["stamp"].cast("int64").to_pylist(), batch[name].to_pylist(), strict=True)
        return rows

    of_model, of_bag = map(wrench, files)
    assert len(of_model) > 9000
    assert of_model == of_bag
    few = tmp_path / "few.rrd"
    assert quadpi("export", replayed, "--format", "rerun", "-o", few).status == 0
    fewer = wrench(few)
    assert len(fewer) < 1100, "50 rows a second of 19 s"
    for column in range(4):
        every, kept = ([row[column] for row in rows.values()] for rows in (of_bag, fewer))
        assert (min(kept), max(kept)) == (min(every), max(every))


def test_a_flight_is_exported_and_imported_again(quadpi, read_json, tmp_path):
    bag, table = bags_directory() / "interpolation.mcap", tmp_path / "flown.csv"
    exported = quadpi("export", bag, "--format", "flight", "-o", table)
    assert (exported.status, exported.errors) == (0, "")
    assert "vehicle bebop2" in exported.output.replace("\n", "")
    out = tmp_path / "bags"
    imported = quadpi("import", table, "--vehicle", "bebop2", "--mapping", "flight", "-o", out)
    assert (imported.status, imported.errors) == (0, "")
    assert quadpi("info", out / "flown.mcap", "--json", tmp_path / "info.json").status == 0
    topics = {topic["topic"] for topic in read_json(tmp_path / "info.json")["topics"]}
    assert {"odometry", "imu", "rotor_speeds", "wind"} <= topics


def test_flights_that_cannot_be_exported(refused, tmp_path):
    bag, flown = bags_directory() / "interpolation.mcap", tmp_path / "flown.csv"
    refused("--model: is not for", "export", bag, "--format", "flight", "--model", GOLDEN, "-o", flown)
    refused("ends in .csv or .parquet", "export", bag, "--format", "flight", "-o", tmp_path / "flown.mat")
    table = tmp_path / "log.csv"
    table.write_text("t,x\n0,1\n")
    refused("state the one that flew", "export", table, "--format", "flight", "-o", flown)
