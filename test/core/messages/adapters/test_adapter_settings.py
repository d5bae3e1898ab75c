# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import re

import pytest

from quadpi_core.errors import LogError
from quadpi_core.messages.adapters import AdapterSettings
from quadpi_core.messages.adapters.adapter_settings import (
    BodySettings,
    CommandSettings,
    RotorSettings,
    StateSettings,
)
from quadpi_core.paths import config_directory
from quadpi_core.vehicle import Vehicle


def load(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    return AdapterSettings.load(path)


@pytest.mark.parametrize(
    "path", sorted((config_directory() / "adapters").glob("*.yaml")), ids=lambda p: p.stem
)
def test_bundled_settings_load_by_name(path):
    assert AdapterSettings.load(path.stem) == AdapterSettings.load(path) != AdapterSettings()


def test_every_key(tmp_path):
    text = """
rotor_speeds: {rotors: [4, 1, 2, 3], unit: erpm, topic: /fmu/out/esc_status}
mocap: {body: 17, frames: fur-eus}
odometry: {topic: /odometry}
"""
    assert load(tmp_path, text) == AdapterSettings(
        rotor_speeds=RotorSettings((4, 1, 2, 3), "erpm", "/fmu/out/esc_status"),
        mocap=BodySettings("17", "fur-eus"),
        odometry=StateSettings("/odometry"),
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", r"expected keys and values, found \[\]"),
        (
            "rotors: {}",
            "unknown key `rotors`; known: rotor_speeds, mocap, odometry, imu, motor_commands, battery, "
            "pressure, temperature, topics, namespace; did you",
        ),
        ("rotor_speeds: 4", "rotor_speeds: expected keys and values, found 4"),
        ("rotor_speeds: {rotors: quad-x}", "rotor_speeds: missing key `unit`"),
        ("rotor_speeds: {rotors: quad-x, unit: rad/s}", "`unit` must be one of rpm, erpm, found 'rad/s'"),
        ("rotor_speeds: {rotors: quad-y, unit: rpm}", "`rotors` must list numbers .* or be quad-x or"),
        ("rotor_speeds: {rotors: {quad-x: 1}, unit: rpm}", "`rotors` must list numbers .* or be quad-x or"),
        (
            "rotor_speeds: {rotors: [1, 2, 2], unit: rpm}",
            "rotor_speeds: `rotors` must be different numbers",
        ),
        ("rotor_speeds: {rotors: [0, 1, 2, 3], unit: rpm}", "different numbers"),
        ("rotor_speeds: {rotors: [1, 1, 2, 3], unit: rpm}", "different numbers"),
        ("rotor_speeds: {rotors: quad-x, unit: rpm, topic: 4}", "`topic` must be text, found 4"),
        ("mocap: {frames: flu-enu}", "mocap: missing key `body`"),
        ("mocap: {body: '', frames: flu-enu}", "`body` must be the name of a body"),
        (
            "mocap: {body: quad, frames: enu}",
            "`frames` must be one of flu-enu, frd-ned, fur-eus, found 'enu'",
        ),
        ("imu: {rate: 3}", "imu: unknown key `rate`; known: topic"),
        ("imu:", "imu: expected keys and values, such as {}, found nothing"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_key(tmp_path, text, message):
    with pytest.raises(LogError, match=rf"{re.escape(str(tmp_path))}/mine\.yaml: .*{message}"):
        load(tmp_path, text)


def test_an_order_is_of_as_many_rotors_as_the_vehicle_has():
    for settings in (RotorSettings(rotors=(1, 2, 3), unit="rpm"), CommandSettings(rotors=(1, 2, 3))):
        assert settings.order(None).controllers == (0, 1, 2)
        with pytest.raises(LogError, match="rotor order of 3 numbers; vehicle neurobem has 4 rotors"):
            settings.order(Vehicle.load("neurobem"))


def test_an_unknown_name_lists_those_there_are():
    with pytest.raises(LogError, match=r"no such adapter file; known adapters: .*mavros.*px4"):
        AdapterSettings.load("pixhawk")
