# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reports: alarms, airframes apart, and every real log a page or a sentence."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadpi_core.errors import LogError
from quadpi_core.field import field_report
from quadpi_core.field.drag import DragResult
from quadpi_core.field.field_log import FieldLog, Series
from quadpi_core.field.field_report import FieldReport, report_on
from quadpi_core.flight_files import NoFlightLeftError
from quadpi_core.paths import bags_directory
from quadpi_core.reading_options import ReadingOptions
from quadpi_core.vehicle import Vehicle

from .field_examples import AIRBORNE, example

OPTIONS = ReadingOptions()


@pytest.fixture
def report_of(monkeypatch: pytest.MonkeyPatch) -> Callable[..., FieldReport]:
    """report_of(log, …) → the report of field logs, without files."""

    def report(*logs: FieldLog | LogError, mass: float | None = None) -> FieldReport:
        found = {Path(f"flight{number}.log"): log for number, log in enumerate(logs)}

        def read(path: Path, *_: object) -> FieldLog:
            log = found[path]
            if isinstance(log, LogError):
                raise log
            return log

        monkeypatch.setattr(field_report, "read_field_log", read)
        return report_on(list(found), OPTIONS, mass=mass)

    return report


def test_a_sound_flight_has_no_alarm(report_of):
    report = report_of(example())
    assert not report.alarmed
    assert report.verdict().startswith("1 flight, 50 s in the air; drag 0.30 1/s along the nose; 0 warnings")


def test_json_is_whole_and_finite(report_of):
    content = report_of(example()).to_json()
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert set(content) == {
        *("format", "quadpi", "verdict", "alarm", "mass_kg", "vehicles", "flights", "left_out")
    }
    assert content["flights"][0]["topics"]["imu"]["rate_hz"] == pytest.approx(200.0)
    assert content["vehicles"][0]["drag"]["per_mass"][0]["value"] == pytest.approx(0.3, rel=0.05)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            lambda log: {"rotor_speeds": scaled(log.rotor_speeds, 1.0, 0.5)},
            "tachometer of rotor 2 reads 0.50",
        ),
        (
            lambda log: {"rotor_speeds": scaled(log.rotor_speeds, 1.0, 0.0)},
            "rotor 2 stands, or its tachometer is silent",
        ),
        (lambda log: {"commands": scaled(log.commands, 1.0, 2.2)}, "motor 2 gets +69 % of command"),
        (
            lambda log: {"commands": Series(log.commands.time, np.minimum(2.4 * log.commands.values, 1.0))},
            "full command",
        ),
    ],
    ids=["half reading", "silent", "imbalance", "saturation"],
)
def test_alarms(report_of, changes, said):
    log = example()
    report = report_of(replace(log, **changes(log)))
    assert report.alarmed
    assert any(said in remark.sentence for remark in report.flights[0].remarks), report.flights[0].remarks


def test_alarms_need_an_interval_that_lies_beyond_the_limit(report_of):
    """A motor that gets twice its command for a fifth of the time: 22 % too much, with 0 in the interval."""
    log = example()
    late = np.where(log.commands.time[:, np.newaxis] > 45.0, [1.0, 2.5, 1.0, 1.0], 1.0)
    report = report_of(replace(log, commands=replace(log.commands, values=late * log.commands.values)))
    assert report.flights[0].use.motors[1].value > 0.15
    assert report.flights[0].remarks == ()
    short = {name: own.during(10.0, 16.0) for name, own in log.series().items()}
    short |= {"commands": scaled(short["commands"], 1.0, 2.2), "rotor_speeds": None}
    remarks = report_of(replace(log, **short)).flights[0].remarks
    assert {remark.level for remark in remarks} == {"warning"}
    assert any(remark.sentence.endswith("of all (too short for an interval)") for remark in remarks)


def test_of_motors_that_answer_each_other_one_is_named(report_of):
    log = example()
    uneven = replace(log, commands=scaled(log.commands, 1.6, 0.5, 1.0, 1.0), rotor_speeds=None)
    report = report_of(uneven)
    assert [remark.sentence[:7] for remark in report.flights[0].remarks] == ["motor 1"]


def test_what_was_not_looked_at_is_said(report_of):
    assert report_of(example()).looked_at() == (
        "looked at: motor commands, thrust over command along the flight, tachometers; not looked at: "
        "command at hover along the flight (takes 6 pieces of slow flight between climb and landing, 0 are "
        "there), order of the motors (takes commands or rotor speeds, gyro and the places of as many "
        "motors), spins of the motors (takes commands or rotor speeds, gyro and the places of as many "
        "motors), "
        "vibration (only ArduPilot's VIBE can be judged)"
    )
    slow = Series(np.arange(0.0, 60.0, 0.25), np.full((240, 4), 800.0))
    report = report_of(example(), example(seed=2, rotor_speeds=slow, imu=None))
    assert report.looked_at() == (
        "looked at: motor commands, thrust over command along the flight of 1 of 2 flights, tachometers of 1 "
        "of 2 flights; not looked at: thrust over command along the flight (the log has not both IMU and "
        "commands), command at hover along the flight (takes 6 pieces of slow flight between climb and "
        "landing, 0 are there), tachometers (commands and rotor speeds are logged at 4 Hz, slower than "
        "motors are), order of the motors (takes commands or rotor speeds, gyro and the places of as "
        "many motors), spins of the motors (takes commands or rotor speeds, gyro and the places of as many "
        "motors), "
        "vibration (only ArduPilot's VIBE can be judged)"
    )
    blind = report_of(example(commands=None, rotor_speeds=None))
    assert blind.looked_at().startswith("not looked at: motor commands (not in the log)")
    assert "no alarm, as nothing could be looked at" in blind.verdict()


@pytest.mark.parametrize(("level", "said"), [(20.0, []), (40.0, ["warning"]), (70.0, ["alarm"])])
def test_vibe_is_judged_by_ardupilots_limits(report_of, level, said):
    vibe = Series(np.arange(0.0, 60.0, 0.1), np.full((600, 3), level) * np.array([0.1, 0.1, 1.0]))
    (flight,) = report_of(example(vibe=vibe)).flights
    assert [one.level for one in flight.remarks if "VIBE along z" in one.sentence] == said


def scaled(series: Series, *factors: float) -> Series:
    """A series whose first columns are multiplied."""
    every = np.ones(series.values.shape[1])
    every[: len(factors)] = factors
    return Series(series.time, series.values * every)


def test_every_key_of_the_json_is_documented(report_of):
    page = (Path(__file__).parents[3] / "docs" / "report.md").read_text()
    content = report_of(example()).to_json()
    vehicle, flight = content["vehicles"][0], content["flights"][0]
    keys = {*vehicle["drag"], *vehicle["drag"]["momentum"], "motor_model", "drag", *content} | set(flight)
    plain = {
        "format",
        "quadpi",
        "verdict",
        "mass_kg",
        "name",
        "file",
        "stack",
        "firmware",
        "frame",
        "rotors",
    }
    assert {key for key in keys - plain if f"`{key}" not in page} == set()


def test_of_many_flights_the_longest_are_identified_together(report_of, monkeypatch):
    monkeypatch.setattr(field_report, "DRAG_FLIGHTS_MOST", 2)
    short = {name: own.during(0.0, 40.0) for name, own in example().series().items()}
    report = report_of(example(), replace(example(), **short), example(seed=2))
    assert report.vehicles[0].wind_of == ("flight0", "flight2")
    assert len(report.vehicles[0].flights) == 3


def test_what_the_logs_say_tells_vehicles_apart(report_of):
    others = [
        {"facts": {"craft": "other"}},
        {"facts": {"board": "another"}},
        {"facts": {"commands": "motor"}},
        {"parameters": {"MOT_PWM_MIN": 900.0}},
        {"frame": "hexacopter", "rotors": 6},
    ]
    altered = [example(seed=seed, **other) for seed, other in enumerate(others, 2)]
    report = report_of(example(), *altered, example(seed=7, parameters={"MOT_THST_HOVER": 0.3}))
    assert "6 airframes" in report.verdict()
    first, *apart = report.vehicles
    assert first.flights == ("flight0", "flight6")
    assert first.name == "PX4 quadcopter of flight0"
    assert first.doubt == "taken as one vehicle: nothing in the logs names it"
    assert [vehicle.flights for vehicle in apart] == [(f"flight{number}",) for number in range(1, 6)]
    assert all(vehicle.doubt == "" for vehicle in apart)


def test_motors_that_turn_otherwise_are_of_another_vehicle(report_of):
    log = example(seed=2)
    brushed = replace(log, rotor_speeds=scaled(log.rotor_speeds, *[0.7] * 4))
    report = report_of(example(), brushed, example(seed=3))
    assert [vehicle.flights for vehicle in report.vehicles] == [("flight0", "flight2"), ("flight1",)]
    assert all("sets these flights apart" in vehicle.doubt for vehicle in report.vehicles)


def test_a_log_without_a_flight_is_left_out(report_of):
    report = report_of(example(), LogError("flight1.log: no flight in it"))
    assert [one.reason for one in report.left_out] == ["flight1.log: no flight in it"]
    with pytest.raises(NoFlightLeftError, match=r"flight0\.log: no flight in it"):
        report_of(LogError("flight0.log: no flight in it"))


def test_copies_of_a_log_count_once(report_of):
    late = {name: replace(own, time=own.time + 7.0) for name, own in example().series().items()}
    report = report_of(*(example(name=f"copy {number}") for number in range(5)), replace(example(), **late))
    assert [flight.name for flight in report.flights] == ["flight0"]
    assert len(report.left_out) == 5
    said = "the same flight as flight0.log; give each flight once"
    assert all(one.reason.endswith(said) for one in report.left_out)
    bare = dict.fromkeys(("imu", "attitude", "velocity", "position"))
    assert len(report_of(example(**bare), example(name="copy", **bare)).left_out) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder",
    [
        *("logs", "rrc_propeller", "rrc_sitl", "arpl", "crazypad", "imrc_brushless", "imrc_brushed"),
        *("imrc_payload", "indiflight", "nanobench", "nanodrone", "neurobem"),
    ],
)
def test_every_real_log_is_reported_or_refused_in_a_sentence(shared_data: Path, folder: str):
    refused = {}
    for path in sorted((shared_data / folder).iterdir()):
        if path.suffix == ".yaml" or path.name == "LICENSE":
            continue
        try:
            report = report_on([path], OPTIONS)
        except NoFlightLeftError as error:
            refused[path.name] = str(error)
        else:
            json.dumps(report.to_json(), allow_nan=False)
            assert report.flights[0].flown.airborne_s > 2.0
    assert all(name in sentence for name, sentence in refused.items())
    expected = {
        "ardupilot_test.BIN",
        "ardupilot_vtol.tlog",
        "betaflight_error_recovery.bbl",
        "px4_sample_small.ulg",
    }
    assert set(refused) == (expected if folder == "logs" else set())


@pytest.mark.parametrize(
    ("log", "motor", "share"),
    [
        ("crazypad/add_weight_W3_near_M3_E9_log00", 3, 0.19),
        ("rrc_propeller/hover_25mm_1.BIN", 1, 0.10),
        ("rrc_propeller/hover_good_1.BIN", 1, 0.0),
    ],
)
def test_motors_of_real_flights(shared_data: Path, log: str, motor: int, share: float):
    """A weight by a motor, or a propeller short by 25 mm, makes it work harder; sound ones scatter by 3 %."""
    (flight,) = report_on([shared_data / log], OPTIONS).flights
    assert flight.use.motors[motor - 1].value == pytest.approx(share, abs=0.03)


def test_drag_of_a_default_px4_log(shared_data: Path):
    """A GPS flight to 19.7 m/s, wind estimated: too few fast passes to tell squares from momentum."""
    report = report_on([shared_data / "logs" / "px4_ekf_failure.ulg"], OPTIONS)
    drag = report.vehicles[0].drag
    assert isinstance(drag, DragResult)
    assert all(one.value is None for one in drag.ballistic)
    assert drag.momentum.low < drag.per_mass[0].value < drag.momentum.high
    assert 0.14 < drag.per_mass[0].low < drag.per_mass[0].value < 0.3
    assert drag.per_mass[1].low > 0.1


@pytest.mark.parametrize(
    ("grows", "battery", "said"),
    [
        (0.2, True, "more command at the end, the battery at 14.93 V after 15.89 V: it sags, or"),
        (0.2, False, "more command at the end: the battery sags, whose voltage is not logged, or"),
        (-0.2, True, "less command at the end: the vehicle becomes lighter, or its motors give more"),
    ],
)
def test_a_trend_of_hover_is_told_with_what_the_battery_did(report_of, grows, battery, said):
    log = example()
    time = log.commands.time
    begin, end = AIRBORNE
    trend = 1.0 + grows * np.clip((time - begin) / (end - begin), 0.0, 1.0)
    slow = Series(log.velocity.time, 0.2 * log.velocity.values)
    changed = replace(log, velocity=slow, commands=Series(time, log.commands.values * trend[:, np.newaxis]))
    report = report_of(changed if battery else replace(changed, battery=None))
    assert any(said in remark.sentence for remark in report.flights[0].remarks), report.flights[0].remarks


@pytest.mark.parametrize(
    ("mass", "wrong"), [(None, False), (0.0285, False), (0.025, True), (0.047, False), (0.052, True)]
)
def test_a_mass_that_rotor_speeds_do_not_carry_is_said(shared_data: Path, mass: float | None, wrong: bool):
    """Of 0.037 kg, by the thrust of another vehicle's propellers of the same kind; neither set the limits."""
    same = Vehicle.load("nanodrone")
    radius = {"rotor_radius_m": same.rotor_radius_m, "thrust_coefficient": same.thrust_coefficient}
    vehicle = replace(Vehicle.load("crazyflie_rpm"), **radius)
    report = report_on([shared_data / "imrc_brushless" / "eckart12"], OPTIONS, vehicle, mass)
    said = [
        one.sentence for one in report.flights[0].remarks if "rotor speeds carry 0.037 kg" in one.sentence
    ]
    assert bool(said) == wrong


def test_a_mass_that_nothing_judges_is_said(report_of):
    for mass, is_said in ((None, False), (1.2, True)):
        notes = report_of(example(), mass=mass).flights[0].log.notes
        assert any(note.startswith("mass: as given") for note in notes) == is_said


@pytest.mark.parametrize(("mass", "wrong"), [(None, False), (0.08, True), (0.01, False), (0.005, True)])
def test_without_a_thrust_coefficient_a_mass_that_no_propeller_carries_is_said(
    shared_data: Path, mass: float | None, wrong: bool
):
    vehicle = Vehicle.load("crazyflie_rpm")
    (flight,) = report_on([shared_data / "imrc_brushless" / "eckart12"], OPTIONS, vehicle, mass).flights
    assert any("by any usual propeller" in one.sentence for one in flight.remarks) == wrong
    assert "thrust_coefficient" in {one.parameter for one in flight.log.settings}


def test_one_mass_is_not_given_to_two_airframes(shared_data: Path):
    logs = [shared_data / "imrc_brushless" / "eckart12", shared_data / "rrc_propeller" / "line_good_1.BIN"]
    for given in ({"mass": 0.037}, {"vehicle": Vehicle.load("crazyflie_rpm")}):
        with pytest.raises(LogError, match=r"one airframe, the logs of Crazyflie .*, ArduPilot"):
            report_on(logs, OPTIONS, **given)


def test_permuted_motors_without_tachometers_are_said(shared_data: Path):
    """A log without its rotor speeds, as the report has it, and with two of its commands exchanged."""
    (found,) = report_on([shared_data / "indiflight" / "LOG00340.BFL"], OPTIONS).flights
    looked_at = found.looked_at()
    assert (found.turning.order, looked_at["order of the motors"]) == ((), "")
    # Betaflight's log does not say which way its propellers turn.
    assert looked_at["spins of the motors"].startswith("not known")
    permuted = Series(found.log.commands.time, found.log.commands.values[:, [0, 2, 1, 3]])
    said = field_report._flight_report(replace(found.log, commands=permuted, rotor_speeds=None)).remarks
    assert any("commands 1 to 4 turn the vehicle as motors 1, 3, 2, 4 would" in one.sentence for one in said)


@pytest.mark.parametrize("is_reversed", [False, True])
def test_spins_of_a_vehicle_file_that_turn_the_other_way_are_said(shared_data: Path, is_reversed: bool):
    vehicle = Vehicle.load("indiflight")
    given = replace(vehicle, rotor_spins=vehicle.rotor_spins * (-1.0 if is_reversed else 1.0))
    (found,) = report_on([shared_data / "indiflight" / "LOG00340.BFL"], OPTIONS, given).flights
    said = [one.sentence for one in found.remarks if "each rotor turned the other way" in one.sentence]
    assert (bool(said), found.turning.order) == (is_reversed, ())


def test_rotor_speeds_of_a_bag_that_names_its_vehicle_are_held_against_its_rotors():
    bag = bags_directory() / "train_1.mcap"
    vehicle = Vehicle.load("bebop2")
    for given, words in (
        (None, ""),
        (replace(vehicle, rotor_positions=vehicle.rotor_positions * [1.0, -1.0, 1.0]), "speeds 1 to 4 turn"),
        (replace(vehicle, rotor_spins=-vehicle.rotor_spins), "rotor speeds yaw the vehicle as if"),
    ):
        (found,) = report_on([bag], OPTIONS, given).flights
        said = [one.sentence for one in found.remarks]
        assert bool(said) == bool(words)
        assert words in " ".join(said)
        assert found.looked_at()["order of the motors"] == ""
    assert found.log.motor(1) == "motor 1 (front left)"


@pytest.mark.parametrize("by_speed", [True, False])
def test_inertia_of_real_flights_holds_that_of_the_vehicle_file(
    shared_data: Path, by_speed: bool, monkeypatch
):
    """By commands least squares over all frequencies gave 2.1 times that about y, 1.5 at the least."""
    read = field_report.read_field_log
    if not by_speed:
        monkeypatch.setattr(
            field_report, "read_field_log", lambda *given: replace(read(*given), rotor_speeds=None)
        )
    vehicle = Vehicle.load("indiflight")
    report = report_on(sorted((shared_data / "indiflight").iterdir()), OPTIONS, vehicle)
    for axis, one in enumerate(report.vehicles[0].body.inertia):
        assert one.low < vehicle.inertia[axis, axis] < one.high < 1.6 * vehicle.inertia[axis, axis]
        assert one.reason.endswith("of rotor speed" if by_speed else "of command")
