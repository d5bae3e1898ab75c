# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi simulate`: its bags, files and JSON keys, what it refuses, and that it then leaves nothing."""

from __future__ import annotations

import json
import sys

import pytest

from quadpi_core.logs import read_recording
from quadpi_core.paths import config_directory
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.vehicle import Vehicle

SCENARIO = """
description: two short flights
vehicle: bebop2
seed: 3
flights:
  hop:
    duration_s: 2
    motion: {height: [{sine: {amplitude_m: 0.2, frequency_hz: 0.6, start_s: 0.1, fade_s: 0.8}}]}
  stand: {duration_s: 1.5, head_wind_m_s: 5}
"""
FLIGHT = {
    "name",
    "bag",
    "duration_s",
    "seed",
    "vehicle",
    "noise",
    "head_wind_m_s",
    "effects",
    "faults",
    "airspeed_max_m_s",
    "tracking_rms_m",
    "tracking_max_m",
    "beyond_identified",
    "tilt_max_deg",
    "rotor_speed_range_rad_s",
    "saturated_fraction",
}


@pytest.fixture
def scenario(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SCENARIO)
    return path


@pytest.fixture
def fly(quadpi, scenario, tmp_path):
    """fly(option, …) → the flights of the JSON file by name; bags go to bags/."""

    def run(*options):
        data = tmp_path / "data.json"
        result = quadpi("simulate", scenario, "-o", tmp_path / "bags", *options, "--json", data)
        assert (result.status, result.errors) == (0, "")
        return {flight["name"]: flight for flight in json.loads(data.read_text())["flights"]}

    return run


@pytest.fixture
def refused(refused, scenario, tmp_path):
    """refused(message, option, …): as of every command, for a simulation with all kinds of output."""

    def run(message, *options, file=scenario):
        written = ("--json", tmp_path / "data.json", "--html", tmp_path / "page.html")
        refused(message, "simulate", file, "-o", tmp_path / "bags", *written, *options)

    return run


def test_bags_page_and_numbers_of_every_flight(fly, tmp_path):
    flights = fly("--html", tmp_path / "page.html")
    assert list(flights) == ["hop", "stand"]
    assert all(set(flight) == FLIGHT for flight in flights.values())
    assert flights["stand"]["airspeed_max_m_s"] == pytest.approx(5.0, abs=0.5)
    assert flights["hop"]["tracking_max_m"] < 0.3
    page = (tmp_path / "page.html").read_text()
    for name, seconds in (("hop", 2.0), ("stand", 1.5)):
        assert flights[name]["bag"] == str(tmp_path / "bags" / f"{name}.mcap")
        assert flights[name]["duration_s"] == pytest.approx(seconds)
        recording = read_recording(flights[name]["bag"], Vehicle.load("bebop2"))
        assert len(recording.imu) == 500 * seconds + 1
        assert f'data-flight="{name}"' in page


def test_one_flight_is_the_same_alone(fly, tmp_path):
    fly()
    together = (tmp_path / "bags" / "stand.mcap").read_bytes()
    assert list(fly("--flight", "stand")) == ["stand"]
    assert (tmp_path / "bags" / "stand.mcap").read_bytes() == together


def test_options_hold_for_all_flights(fly):
    flights = fly("--vehicle", "hdbeetle", "--noise", "mpu6000", "--seed", 9, "--effect", "gyroscopic")
    assert {flight["vehicle"] for flight in flights.values()} == {"hdbeetle"}
    assert {flight["noise"] for flight in flights.values()} == {"mpu6000"}
    assert [list(flight["effects"]) for flight in flights.values()] == [["gyroscopic"]] * 2
    assert len({flight["seed"] for flight in flights.values()}) == 2
    assert flights["hop"]["seed"] != fly("--flight", "hop")["hop"]["seed"]


def test_effects_with_parameters(fly):
    flight = fly("--flight", "hop", "--effect", "payload:mass_kg=0.02", "--effect", "spin_up")["hop"]
    assert flight["effects"]["payload"]["mass_kg"] == 0.02
    assert set(flight["effects"]) == {"payload", "spin_up"}


def test_another_number_of_workers_gives_the_same_bytes(fly, tmp_path):
    bags = []
    for workers in (1, 2):
        fly("--workers", workers)
        bags.append([path.read_bytes() for path in sorted((tmp_path / "bags").iterdir())])
    assert bags[0] == bags[1]


def test_the_list_names_every_scenario_and_effect(quadpi):
    result = quadpi("simulate", "--list")
    assert result.status == 0
    for name in (*EFFECTS, *(path.stem for path in (config_directory() / "scenarios").glob("*.yaml"))):
        assert name in result.output


class TestRefusals:
    def test_unknown_names_with_the_nearest_known_one(self, refused):
        refused("no such scenario file; .*did you mean `training`", file="trainign")
        refused("no flight `stant`; its flights: hop, stand; did you mean `stand`", "--flight", "stant")
        refused("flight hop: .*no such vehicle file; .*did you mean `bebop2`", "--vehicle", "bebop3")
        refused("no such noise file; .*did you mean `paper`", "--noise", "papr")
        refused("--effect: unknown effect `paylod`; did you mean `payload`", "--effect", "paylod")
        refused("unknown parameter `mas_kg`; did you mean `mass_kg`", "--effect", "payload:mas_kg=1")

    @pytest.mark.parametrize("text", ["payload:", "payload:mass_kg", "payload:mass_kg=heavy", "payload:=1,"])
    def test_effects_that_are_none(self, refused, text):
        refused(f"--effect {text}: expected NAME", "--effect", text)

    def test_impossible_parameter(self, refused):
        refused("`mass_kg` must be between", "--effect", "payload:mass_kg=-1")

    def test_vehicle_that_cannot_be_simulated(self, refused):
        refused("crazyflie_rpm.*simulation", "--vehicle", "crazyflie_rpm")

    def test_unreachable_reference(self, refused, scenario):
        scenario.write_text(
            SCENARIO + "  dash: {duration_s: 10, orbit: {radius_m: 3, speed_m_s: 12, start_s: 1}}\n"
        )
        refused("flight dash: unreachable reference")

    def test_vehicle_out_of_control(self, refused):
        message = r"flight hop: .* out of control after \d+\.\d+ s: tilt"
        refused(message, "--effect", "cg_offset:x_m=0.1,y_m=0")

    def test_page_in_the_place_of_a_bag(self, quadpi, scenario, tmp_path):
        bag = tmp_path / "bags" / "hop.mcap"
        result = quadpi("simulate", scenario, "-o", tmp_path / "bags", "--html", bag)
        assert result.status == 2
        assert "would replace or alter" in result.errors
        assert not bag.exists()


# `quadpi demo`: what it refuses before it starts; test/ros/test_demo.py runs it.


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
