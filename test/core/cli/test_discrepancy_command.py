# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi discrepancy`: its tables, files and JSON keys; what it refuses, and that it then leaves nothing."""

import json
from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.flight import AXES
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.parallel import Workers
from quadpi_core.paths import bags_directory
from quadpi_core.reading_options import TimeRange
from quadpi_core.screening.flight_runs import in_range
from quadpi_core.simulation.scenario import choose_flights, load_scenario, parse_effects
from quadpi_core.simulation.simulated_bags import simulate
from quadpi_core.vehicle import Vehicle

FLIGHTS = """
description: what tells drag and yaw damping
vehicle: bebop2
noise: paper
seed: 5
duration_s: 9
height_m: 3
flights:
  ahead:
    motion:
      x: [{sine: {amplitude_m: 4, frequency_hz: 0.2, start_s: 0.3, duration_s: 8.5, fade_s: 2}}]
  aside:
    motion:
      y: [{sine: {amplitude_m: 4, frequency_hz: 0.2, start_s: 0.3, duration_s: 8.5, fade_s: 2}}]
  both:
    motion:
      x: [{sine: {amplitude_m: 2.5, frequency_hz: 0.2, start_s: 0.3, duration_s: 8.5, fade_s: 2}}]
      y: [{sine: {amplitude_m: 2.5, frequency_hz: 0.23, start_s: 0.3, duration_s: 8.5, fade_s: 2}}]
      height: [{sine: {amplitude_m: 0.5, frequency_hz: 0.3, start_s: 0.3, duration_s: 8.5, fade_s: 2}}]
      yaw: [{pulse: {amplitude_deg: 60, width_s: 1.5, rise_s: 0.8, start_s: 2}}]
"""
TRAINING = [bags_directory() / f"train_{k}.mcap" for k in (1, 2)]


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Three flights of 9 s with drag that the vehicle file does not have."""
    folder = tmp_path_factory.mktemp("dragged")
    (folder / "flights.yaml").write_text(FLIGHTS)
    effects = parse_effects(["body_drag:x_n_s2_m2=0.006,y_n_s2_m2=0.009,z_n_s2_m2=0.006"])
    plans = choose_flights(load_scenario(str(folder / "flights.yaml")), (), effects=effects)
    return [flown.bag for flown in simulate(plans, folder, workers=Workers(1))]


@pytest.fixture
def refused(refused, tmp_path):
    """refused(message, argument, …): as of every command, for a search with all kinds of output."""

    def run(message, *arguments, **before):
        written = ("-o", tmp_path / "out", "--json", tmp_path / "data.json", "--html", tmp_path / "page.html")
        refused(message, "discrepancy", *arguments, *written, **before)

    return run


@pytest.mark.slow
class TestFound:
    def test_drag_is_named_added_and_gone_in_the_next_run(self, quadpi, bags, tmp_path):
        sought = ("--effects", "body_drag,rate_damping,payload")
        data = tmp_path / "copy.json"
        first = quadpi("discrepancy", "bebop2", *bags, "-o", tmp_path / "out", *sought, "--json", data)
        assert (first.status, first.errors) == (0, "")
        found = json.loads(data.read_text())
        assert found == json.loads((tmp_path / "out" / "discrepancy.json").read_text())
        assert found["verdict"] == "effects"
        (effect,) = found["effects"]
        assert effect["name"] == "body_drag"
        drag = effect["parameters"]["x_n_s2_m2"]
        assert drag["lower"] < 0.006 < drag["upper"]
        assert found["gap"]["reduction"] > 0.9
        for axis in ("Fx", "Fy"):
            gap = found["gap"][axis]
            # Above the noise of sensors there are errors of the estimator.
            assert gap["after"] < 1.5 * gap["floor"] < 0.5 * gap["before"]
        assert {part["axis"] for part in found["where"]} <= set(AXES)
        assert any(part["variable"] in ("speed", "u") for part in found["where"] if part["axis"] == "Fx")
        rollout = found["rollout"]["velocity_m_s"]
        assert rollout["after"] < 0.5 * rollout["before"]
        assert all((tmp_path / "out" / name).is_file() for name in found["files"])
        for word in ("body_drag", "airspeed", "RMSE before", "closed"):
            assert word in first.output

        augmented = tmp_path / "out" / found["files"][0]
        second = quadpi("discrepancy", augmented, *bags, "-o", tmp_path / "again", *sought, "--json", data)
        assert (second.status, second.errors) == (0, "")
        again = json.loads(data.read_text())
        assert (again["verdict"], again["effects"], again["where"]) == ("none", [], [])
        assert "No missing effect was found" in second.output
        # Nothing to add: no vehicle file, no formula.
        assert again["files"] == []


class TestRefusals:
    def test_one_flight_only(self, refused):
        refused(
            "1 flight: what is found on some flights is tested on others; 2 are the least",
            "bebop2",
            TRAINING[0],
        )

    def test_the_same_flight_twice(self, refused, tmp_path):
        copy = tmp_path / "copy.mcap"
        copy.write_bytes(TRAINING[0].read_bytes())
        refused("1 flight: what is found on some", "bebop2", TRAINING[0], copy, left_out=1)

    def test_a_flight_shorter_than_a_rollout_alone_is_left_out(self, refused, tmp_path):
        recording = read_recording(TRAINING[0], Vehicle.load("bebop2"))
        short = tmp_path / "short.mcap"
        write_bag(short, in_range(recording, TimeRange(to_s=1.4)))
        refused("1 flight: what is found on some", "bebop2", TRAINING[0], short, left_out=1)

    def test_flights_of_another_vehicle(self, refused):
        refused("train_1.mcap: is a flight of vehicle bebop2, not of hdbeetle", "hdbeetle", *TRAINING)

    def test_what_is_no_simulation(self, refused):
        refused("bebop3: no simulation: .*did you mean `bebop2`", "bebop3", *TRAINING)

    def test_vehicle_that_cannot_be_simulated(self, refused):
        refused("crazyflie_rpm.*simulation", "crazyflie_rpm", *TRAINING)

    def test_effect_that_does_not_exist(self, refused):
        refused("unknown effect `drag`", "bebop2", *TRAINING, "--effects", "drag")

    @pytest.mark.parametrize("speeds", ["absent", "constant"])
    def test_rotor_speeds(self, refused, tmp_path, speeds):
        altered = []
        for path in TRAINING:
            recording = read_recording(path, Vehicle.load("bebop2"))
            rotors = recording.rotor_speeds
            constant = replace(rotors, speeds=np.full_like(rotors.speeds, rotors.speeds.mean()))
            altered.append(tmp_path / path.name)
            write_bag(altered[-1], replace(recording, rotor_speeds=None if speeds == "absent" else constant))
        says = "is missing" if speeds == "absent" else r"rotor 1 has the same speed throughout, .* rad/s"
        refused(f"train_1.mcap: topic rotor_speeds:? {says}", "bebop2", *altered)

    def test_code_that_a_file_names(self, refused, tmp_path):
        addition = tmp_path / "addition.json"
        addition.write_text('{"simulation": "os:getcwd", "vehicle": "bebop2"}')
        refused("addition.json: names code to run, the function os:getcwd: --allow-code", addition, *TRAINING)
        refused("os:getcwd: raised TypeError", addition, *TRAINING, "--allow-code")

    def test_output_in_the_place_of_an_input(self, quadpi):
        result = quadpi("discrepancy", "bebop2", *TRAINING, "-o", TRAINING[0])
        assert result.status == 2
        assert "would replace or alter" in result.errors
