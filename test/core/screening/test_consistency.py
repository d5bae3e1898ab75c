# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The consistency check names the mistakes that people make, and says nothing of sound flights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from quadpi_core.config import read_config
from quadpi_core.errors import LogError, VehicleError
from quadpi_core.logs import read_recording
from quadpi_core.logs.bags import write_bag
from quadpi_core.logs.inspect import inspect_recording
from quadpi_core.paths import bags_directory
from quadpi_core.screening.consistency import checked, findings
from quadpi_core.vehicle import Vehicle
from test.core.mistakes import MISTAKES
from test.core.screening.conftest import RECORDINGS

BAGS = bags_directory()
# Files of each real data set, and the vehicle and mapping that they take.
REAL = {
    "neurobem": ("*.mat", "neurobem", None),
    "imrc_brushless": ("eckart*[048]", "crazyflie_rpm", None),
    "imrc_payload": ("eckart*[14689]", "crazyflie_rpm", None),
    "imrc_brushed": ("jana0?", "crazyflie_rpm", None),
    "nanodrone": ("*run[23].parquet", "nanodrone", "nanodrone"),
    "nanodrone_benchmark": ("*run2.parquet", "nanodrone", "nanodrone"),
    "indiflight": ("LOG00264*", None, None),
    "arpl": ("log10", "crazyflie_rpm", None),
    "logs": ("*.[Bu]*", None, None),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_named(flown, vehicle, name):
    recording = flown[RECORDINGS[list(MISTAKES).index(name) % len(RECORDINGS)]]
    mistake = MISTAKES[name]
    found = list(findings(*mistake.done(recording, vehicle)))
    assert mistake.named in [finding.mistake for finding in found], found


@pytest.mark.parametrize("bag", sorted(BAGS.glob("*.mcap")), ids=lambda bag: bag.stem)
def test_nothing_is_said_of_the_bundled_bags(vehicle, bag):
    assert list(findings(read_recording(bag, vehicle), vehicle)) == []


@pytest.mark.parametrize("name", REAL)
def test_nothing_is_said_of_real_flights(shared_data, name):
    pattern, vehicle_name, mapping = REAL[name]
    vehicle = None if vehicle_name is None else Vehicle.load(vehicle_name)
    logs = sorted((shared_data / name).glob(pattern))[:2]
    assert logs
    for log in logs:
        assert list(findings(read_recording(log, vehicle, mapping), vehicle)) == [], log


@pytest.mark.parametrize(
    ("log", "rotor"), [("imrc_brushed/jana20", 1), ("imrc_payload/eckart52", 3)], ids=["zeros", "half"]
)
def test_real_rotor_sensors_that_fail_are_named(shared_data, log, rotor):
    vehicle = Vehicle.load("crazyflie_rpm")
    found = list(findings(read_recording(shared_data / log, vehicle), vehicle))
    assert [finding.mistake for finding in found] == ["one rotor"]
    assert f"rotor {rotor} looks as if" in found[0].text


def test_a_certain_mistake_is_refused_and_another_one_said(flown, vehicle):
    recording = flown["train_2"]
    with pytest.raises(
        LogError,
        match=r"train_2\.mcap: topic mocap/pose: the attitude of mocap/pose looks conjugated .*: inverting "
        r"it lowers the innovation of the attitude from [\d.]+ to 0\.\d+ rad/s",
    ):
        checked(*MISTAKES["quaternion conjugated"].done(recording, vehicle))
    warned = checked(*MISTAKES["mocap yawed by 20"].done(recording, vehicle))
    (sentence,) = warned.quality.sentences()
    assert "turned against each other by 20°" in sentence
    assert warned.quality.to_json()["findings"][0]["mistake"] == "body yawed"
    assert checked(recording, vehicle).quality.findings == ()


def test_the_rotor_speeds_tell_which_of_imu_and_mocap_is_turned(flown, vehicle):
    recording = flown["train_2"]
    for name, right in (("imu yawed by 90", "mocap/pose"), ("mocap yawed by 90", "the IMU")):
        (finding,) = findings(*MISTAKES[name].done(recording, vehicle))
        assert finding.text.endswith(f"the rotor speeds agree with {right}")


def test_info_shows_what_import_says(flown, vehicle, tmp_path):
    recording, _ = MISTAKES["neighbours swapped"].done(flown["train_2"], vehicle)
    write_bag(tmp_path / "swapped.mcap", recording)
    shown = inspect_recording(read_recording(tmp_path / "swapped.mcap", vehicle), vehicle).findings
    assert any("rotors 1 and 2 look swapped" in text for text in shown)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position_m": [0.0875, -0.115, 0.0]}, "must lie one in each quadrant"),
        ({"spin": "clockwise"}, "opposite rotors must turn the same way"),
    ],
)
def test_vehicles_that_cannot_fly_are_refused(tmp_path, change, message):
    _, data = read_config("vehicle", "bebop2", VehicleError)
    data["rotors"] = [{**rotor, **change} for rotor in data["rotors"]]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(VehicleError, match=message):
        Vehicle.load(path)


def test_an_inertia_in_another_unit_is_refused(tmp_path):
    _, data = read_config("vehicle", "neurobem", VehicleError)
    data["inertia_kg_m2"] = [1e3 * moment for moment in data["inertia_kg_m2"]]
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(data))
    with pytest.raises(VehicleError, match="wrong unit"):
        Vehicle.load(path)


@pytest.mark.parametrize("noise_m", [0.05, 0.3, 2.0])
def test_noise_is_no_other_unit(flown, vehicle, noise_m):
    for recording in flown.values():
        noise = np.random.default_rng(1).standard_normal(recording.pose.position.shape)
        noisy = replace(recording.pose, position=recording.pose.position + noise_m * noise)
        assert list(findings(replace(recording, pose=noisy), vehicle)) == []
