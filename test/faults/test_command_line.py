# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bad flights: every reader refuses them in one line that names the culprit, and every command makes an exit
status 2 of that and leaves no output.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.identification.prepared_flights import prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.logs.bag_writer import write_mcap
from quadpi_core.logs.bags import output_topic, read_outputs, write_bag
from quadpi_core.logs.importing import import_logs
from quadpi_core.messages import sensor_messages
from quadpi_core.results import BAD_DATA
from quadpi_core.vehicle import Vehicle

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("error::RuntimeWarning")]

SAMPLE = 123


def changed(recording, topic, column, values):
    """The recording with one array of one topic replaced by `values(array)`."""
    stream = getattr(recording, topic)
    return replace(recording, **{topic: replace(stream, **{column: values(getattr(stream, column).copy())})})


def test_flight_with_every_topic_is_good(quadpi, recording, model, bad):
    write_bag(bad, recording)
    assert quadpi("evaluate", model, bad).status == 0
    assert quadpi("replay", model, bad, "-o", bad.with_name("out.mcap")).status == 0


def test_refusal_is_the_only_line_of_a_process(bad, model):
    bad.write_bytes(b"")
    command = [sys.executable, "-m", "quadpi_core.cli", "evaluate", model, bad]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout, ran.stderr) == (2, "", f"quadpi: {bad}: the file is empty\n")


# What wants a whole flight; a replay goes on as the nodes do in flight.
OFFLINE = ("import", "prepare")
READERS = (*OFFLINE, "replay")


@pytest.mark.parametrize("command", ["import", "identify", "evaluate", "replay"])
@pytest.mark.parametrize("fault", ["file", "samples"])
def test_every_command_refuses_a_bad_flight(refused, bad, model, pool, recording, tmp_path, command, fault):
    if fault == "file" or command == "replay":
        bad.write_bytes(b"")
        message = "the file is empty"
    else:
        write_bag(bad, changed(recording, "imu", "specific_force", lambda force: np.nan * force))
        message = "topic imu: sample 0: .* not finite"
    vehicle = ("--vehicle", "neurobem")
    arguments = {
        "import": (bad, *vehicle, "-o", tmp_path / "bags"),
        "identify": (bad, *vehicle, "--candidates", pool, "-o", tmp_path / "model"),
        "evaluate": (model, bad, "--json", tmp_path / "data.json", "--html", tmp_path / "page"),
        "replay": (model, bad, "-o", tmp_path / "out.mcap", "--json", tmp_path / "data.json"),
    }
    refused(f"{re.escape(str(bad))}: {message}", command, *arguments[command])


class TestBatch:
    """One bad flight stops no other: each is judged, and what was left out is said last, with status 3."""

    @pytest.fixture
    def commands(self, bad, model, pool, tmp_path):
        """By command, its arguments before and after the flights, and the file with its result."""
        bad.write_bytes(b"")
        data, out = ("--json", tmp_path / "data.json"), tmp_path / "out"
        vehicle = ("--vehicle", "neurobem")
        return {
            "import": ((), (*vehicle, "-o", out, *data)),
            "identify": ((), (*vehicle, "--candidates", pool, "-o", out, *data)),
            "evaluate": ((model,), data),
            "replay": ((model,), ("-o", out, *data)),
        }

    @pytest.mark.parametrize("command", ["import", "identify", "evaluate", "replay"])
    def test_the_others_go_on(self, quadpi, commands, bags, bad, tmp_path, command):
        first, last = commands[command]
        result = quadpi(command, *first, bad, *bags, *last)
        assert (result.status, result.errors) == (3, f"quadpi: left out bad: {bad}: the file is empty\n")
        data = json.loads((tmp_path / "data.json").read_text())
        assert data["left_out"] == [
            {"flight": "bad", "path": str(bad), "reason": f"{bad}: the file is empty"}
        ]
        (tmp_path / "data.json").unlink()
        assert quadpi(command, *first, *bags, *last).status == 0
        assert json.loads((tmp_path / "data.json").read_text()) == {**data, "left_out": []}

    def test_all_bad_or_too_few_left(self, refused, commands, bags, bad, tmp_path):
        other = shutil.copy(bad, tmp_path / "other.mcap")
        for command, (first, last) in commands.items():
            message = f"none of the flights can be used: {bad}: .*; {other}: the file is empty"
            refused(message, command, *first, bad, other, *last)
        first, last = commands["identify"]
        refused("too few flights: 1 given", "identify", *first, bags[0], bad, *last, left_out=1)

    def test_a_group_ends_with_its_flights(self, quadpi, model, bags, bad):
        bad.write_bytes(b"")
        result = quadpi("evaluate", model, bags[0], "--group", f"none={bad}")
        assert result.status == 3
        assert "group none: all its flights were left out" in result.output

    def test_flights_of_one_name(self, quadpi, model, bags, tmp_path):
        """They are told apart, and a model knows its flights by what they hold, under any name."""
        seen, new = tmp_path / "seen" / "LOG00001.mcap", tmp_path / "new" / "LOG00001.mcap"
        shutil.copytree(bags[1].parent, seen.parent)
        bags_of_model = [seen.parent / bag.name for bag in bags[1:]]
        bags_of_model[0].rename(seen)
        named_as_known = tmp_path / bags[2].name
        for path in (new, named_as_known):
            path.parent.mkdir(exist_ok=True)
            shutil.copy(bags[0], path)
        new.write_bytes(bags[0].read_bytes())
        data = tmp_path / "data.json"
        groups = ("--group", f"a={seen}", "--group", f"b={new}")
        assert quadpi("evaluate", model, *groups, "--json", data).status == 0
        judged = json.loads(data.read_text())
        assert {name: flight["in_sample"] for name, flight in judged["flights"].items()} == {
            "seen_LOG00001": True,
            "new_LOG00001": False,
        }
        assert judged["groups"]["a"]["flights"] == ["seen_LOG00001"]
        page = tmp_path / "page.html"
        assert quadpi("evaluate", model, named_as_known, "--json", data, "--html", page).status == 0
        assert "in sample" not in page.read_text()

    def test_a_flight_whose_sensor_fails_is_no_training(self, quadpi, recording, bags, pool, tmp_path):
        """Whether it is one, is said by the finding and not by its words."""

        def stuck(speeds):
            speeds[400:700, 2] = 900.0
            return speeds

        flawed = tmp_path / "flawed.mcap"
        write_bag(flawed, changed(recording, "rotor_speeds", "speeds", stuck))
        options = ("--vehicle", "neurobem", "--candidates", pool, "-o", tmp_path / "model")
        data, page = tmp_path / "data.json", tmp_path / "page.html"
        files = ("--json", data, "--html", page)
        result = quadpi("identify", *bags[1:], flawed, *options, *files)
        assert result.status == 3
        assert re.fullmatch(
            rf"quadpi: left out flawed: {flawed}: topic rotor_speeds: rotor 3 reads .*\n", result.errors
        )
        assert list(json.loads(data.read_text())["flights"]) == [bag.stem for bag in bags[1:]]
        above, tables = page.read_text().split("<table>", 1)
        assert "rotor 3 reads" in above
        assert "rotor 3 reads" not in tables
        kept = quadpi("identify", *bags[1:], flawed, *options, *files, "--keep-flawed")
        assert (kept.status, kept.errors) == (0, "")
        judged = json.loads(data.read_text())
        assert judged["flights"]["flawed"]["in_sample"]
        assert judged["data_quality"]["flawed"]["findings"][0]["leave_out"]
        assert "rotor 3 reads" in page.read_text().split("<table>", 1)[0]


class TestDamagedFiles:
    def test_absent(self, refused_by):
        refused_by(READERS, "no such file or folder")

    def test_unknown_format(self, refused, tmp_path):
        (tmp_path / "notes.rtf").write_text("windy")
        message = r"notes\.rtf: not a known log format; known: ArduPilot"
        refused(message, "import", tmp_path / "notes.rtf", "--vehicle", "neurobem", "-o", tmp_path / "bags")
        refused(message, "info", tmp_path / "notes.rtf", "--json", tmp_path / "data.json")


class TestMissingTopics:
    def test_rotor_speeds(self, refused_by, bad, recording):
        write_bag(bad, replace(recording, rotor_speeds=None))
        refused_by(("prepare", "replay"), "topic rotor_speeds .*is missing")

    def test_state(self, refused_by, bad, recording):
        write_bag(bad, replace(recording, pose=None, odometry=None))
        message = "topics mocap/pose and odometry are missing: one is needed"
        refused_by(("prepare", "replay"), message)


class TestWrongUnits:
    """The live path cannot tell units, so neither does its replay: everything else refuses them."""

    @pytest.mark.parametrize(
        ("topic", "column", "factor", "message"),
        [
            ("imu", "angular_velocity", 180.0 / np.pi, "topic imu: .*looks like deg/s"),
            ("imu", "angular_velocity", np.pi / 180.0, "topic imu: .*looks like rad/s taken for deg/s"),
            ("imu", "specific_force", 1.0 / 9.80665, "topic imu: .*looks like g, m/s² expected"),
            ("imu", "specific_force", 2.0, "topic imu: .*gravity counted twice"),
            ("rotor_speeds", "speeds", 30.0 / np.pi, r"topic rotor_speeds: sample \d+: .*looks like rpm"),
            ("rotor_speeds", "speeds", 0.1, "topic rotor_speeds: thrust over Σω².*wrong unit"),
        ],
    )
    def test_units(self, refused_by, bad, recording, topic, column, factor, message):
        write_bag(bad, changed(recording, topic, column, lambda values: factor * values))
        refused_by(OFFLINE, message)

    def test_electrical_speeds_without_pole_pairs(self, refused_by, bad, recording):
        rotors = recording.rotor_speeds
        erpm = sensor_messages.pack_erpm(rotors.time_ns, rotors.speeds * 7 * 30.0 / np.pi)
        write_bag(bad, replace(recording, rotor_speeds=None), [output_topic("erpm", rotors.time_ns, erpm)])
        refused_by(READERS, "topic /erpm: vehicle neurobem: .*need `pole_pairs`")

    def test_axes(self, refused_by, bad, recording):
        flipped = changed(recording, "imu", "specific_force", lambda force: force * [1.0, -1.0, -1.0])
        write_bag(bad, flipped)
        refused_by(OFFLINE, "topic imu: specific force points down")


@pytest.fixture
def followed(quadpi, model, bad, tmp_path):
    """followed(reported): a replay goes through with finite numbers, and reports bad data if it should."""

    def run(reported):
        output = tmp_path / "out.mcap"
        assert quadpi("replay", model, bad, "-o", output).status == 0
        predictions, alarms = read_outputs(output)
        assert len(predictions.time_ns) > 1000
        for column in fields(predictions):
            assert np.isfinite(getattr(predictions, column.name)).all()
        assert bool(np.any(alarms.causes & BAD_DATA)) == reported
        output.unlink()

    return run


@pytest.fixture
def left_out(bad, tmp_path):
    """left_out(topic, limit): these samples are, by `import` and before identification, and nothing else."""

    def check(topic, limit, samples=1):
        vehicle = Vehicle.load("neurobem")
        (imported,) = import_logs([bad], vehicle, tmp_path / "bags")
        (prepared,) = prepare_flights([bad], vehicle)
        for quality in (imported.quality, prepared.quality):
            (said,) = quality.left_out
            assert (said.topic, said.limit, said.samples, said.first) == (topic, limit, samples, SAMPLE)

    return check


@pytest.mark.parametrize(
    ("topic", "name", "column"),
    [
        ("imu", "imu", "angular_velocity"),
        ("imu", "imu", "specific_force"),
        ("rotor_speeds", "rotor_speeds", "speeds"),
        ("pose", "mocap/pose", "position"),
        ("odometry", "odometry", "velocity"),
        ("wind", "wind", "velocity"),
    ],
)
def test_numbers_that_are_not_finite(left_out, followed, bad, short, topic, name, column):
    def spoil(array):
        array[SAMPLE : SAMPLE + 3, -1] = np.nan, np.inf, -np.inf
        return array

    write_bag(bad, changed(short, topic, column, spoil))
    left_out(name, f"whose {column} is not finite", samples=3)
    # The estimator still collects its first second at that sample; wind holds until the next.
    followed(reported=topic == "wind")


@pytest.mark.parametrize("topic", ["pose", "odometry"])
@pytest.mark.parametrize(
    ("factors", "message"), [([0.0, 2.0], "no unit quaternion"), ([np.nan], "not finite")]
)
def test_attitude_that_is_none(left_out, followed, bad, short, topic, factors, message):
    def change(attitude):
        for sample, factor in enumerate(factors, SAMPLE):
            attitude[sample] *= factor
        return attitude

    write_bag(bad, changed(short, topic, "attitude", change))
    left_out(getattr(short, topic).topic, f"whose attitude is {message}", samples=len(factors))
    followed(reported=False)


PACK = {
    "imu": sensor_messages.pack_imu,
    "rotor_speeds": sensor_messages.pack_rotor_speeds,
    "pose": sensor_messages.pack_pose,
    "odometry": sensor_messages.pack_odometry,
    "wind": sensor_messages.pack_wind,
}


@pytest.mark.parametrize("topic", PACK)
@pytest.mark.parametrize(("shift_ns", "kind"), [(0, "repeats"), (-50_000, "runs backward")])
def test_stamps_that_do_not_rise(left_out, followed, bad, short, topic, shift_ns, kind):
    """Header stamps, that is: a recorder logs the messages as they come."""

    def shift(stamps):
        stamps[SAMPLE] = stamps[SAMPLE - 1] + shift_ns
        return stamps

    wrong = changed(short, topic, "time_ns", shift)
    topics = []
    for name, pack in PACK.items():
        good = getattr(short, name)
        topics.append(output_topic(good.topic, good.time_ns, pack(getattr(wrong, name))))
    write_mcap(bad, topics, {})
    left_out(getattr(short, topic).topic, f"whose stamp {kind}")
    followed(reported=False)


class TestTheSameFlightTwice:
    @pytest.mark.parametrize("command", ["import", "identify", "evaluate"])
    def test_copy(self, quadpi, bags, model, pool, tmp_path, command):
        copy = shutil.copy(bags[0], tmp_path / "copy.mcap")
        options = {
            "import": ("--vehicle", "neurobem", "-o", tmp_path / "out"),
            "identify": ("--vehicle", "neurobem", "--candidates", pool, "-o", tmp_path / "out"),
            "evaluate": ("--json", tmp_path / "data.json"),
        }
        first = (model,) if command == "evaluate" else ()
        result = quadpi(command, *first, bags[0], bags[1], copy, *options[command])
        message = f"quadpi: left out copy: {copy}: the same flight as {bags[0]}; give each flight once\n"
        assert (result.status, result.errors) == (3, message)

    def test_same_file(self, refused, bags, model, pool, tmp_path):
        options = ("--vehicle", "neurobem", "--candidates", pool, "-o", tmp_path / "out")
        refused("too few flights: 1 given", "identify", bags[0], bags[0], *options, left_out=1)
        refused("group all: a flight is present twice", "evaluate", model, bags[0], bags[0])

    def test_log_and_its_bag(self, refused, quadpi, shared_data, tmp_path):
        log = shared_data / "neurobem" / "bemnn20210223104803seg2.mat"
        vehicle = ("--vehicle", "neurobem")
        assert quadpi("import", log, *vehicle, "-o", tmp_path / "bags").status == 0
        bag = tmp_path / "bags" / f"{log.stem}.mcap"
        refused("too few flights", "identify", log, bag, *vehicle, "-o", tmp_path / "model", left_out=1)


class TestFlightsThatDoNotExciteTheModel:
    @pytest.mark.parametrize(
        ("method", "message"),
        [
            ((), "short0.mcap: 0.* s in the air, of 1 s that this kind of model needs"),
            (
                ("--method", "polynomial"),
                r"Fx: \d+ samples are too few for a pool of \d+ regressors",
            ),
        ],
    )
    def test_too_few_samples(self, refused, fly, tmp_path, method, message):
        flights = [tmp_path / f"short{seed}.mcap" for seed in range(2)]
        for seed, path in enumerate(flights):
            write_bag(path, fly(seed, seconds=1.4))
        refused(message, "identify", *flights, "--vehicle", "neurobem", *method, "-o", tmp_path / "model")

    def test_too_short_for_the_estimator(self, refused_by, bad, fly):
        write_bag(bad, fly(0, seconds=0.5))
        refused_by(("prepare", "replay"), ".*")

    def test_constant_rotor_speeds(self, refused, bags, pool, tmp_path):
        flights = [tmp_path / bag.name for bag in bags]
        for bag, path in zip(bags, flights, strict=True):
            steady = changed(read_recording(bag, None), "rotor_speeds", "speeds", lambda s: 0.0 * s + 1100.0)
            write_bag(path, steady)
        message = "Mx: regressor `U_p` is constant or a combination of the other fixed ones on these flights"
        options = ("--vehicle", "neurobem", "--candidates", pool, "-o", tmp_path / "model", "--keep-flawed")
        refused(message, "identify", *flights, *options, finding="two columns of one channel")

    def test_rotors_at_rest(self, refused_by, bad, recording):
        write_bag(bad, changed(recording, "rotor_speeds", "speeds", lambda speeds: 0.0 * speeds))
        refused_by(("prepare",), "topic rotor_speeds: ")

    def test_one_flight_cannot_calibrate(self, refused, bags, tmp_path):
        refused(
            "too few flights: 1 given, 2 or more needed to calibrate; --settings paper takes one",
            "identify",
            bags[0],
            "--vehicle",
            "neurobem",
            "-o",
            tmp_path / "m",
        )
