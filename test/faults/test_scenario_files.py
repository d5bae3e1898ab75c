# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bad scenario files and effects on the command line: exit status 2, one line, no bag left behind."""

from __future__ import annotations

import pytest

SHARED = "description: x\nvehicle: bebop2\nseed: 1\nduration_s: 1\n"
STEP = "{motion: {x: [{step: {amplitude_m: %s, rise_s: %s, start_s: 0}}]}}"
FAULT = "{faults: [{kind: %s, topic: imu, at_s: %s, for_s: %s}]}"
IMPOSSIBLE = ("9" * 400, "-1e300", "1e-300")


@pytest.fixture
def refused_file(refused, tmp_path):
    """refused_file(message, content, option, …): as `refused`, for a scenario file."""

    def run(message, content, *options):
        path = tmp_path / "own.yaml"
        path.write_text(content)
        refused(message, "simulate", path, "-o", tmp_path / "bags", *options)

    return run


@pytest.fixture
def refused_flight(refused_file):
    """refused_flight(message, flight): as `refused_file`, for the one flight `a` of the file."""
    return lambda message, flight: refused_file(message, f"{SHARED}flights:\n  a: {flight}\n")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "expected keys and values, found None"),
        ("flights: {a: {motion: ", "own.yaml: not a readable YAML file"),
        ("[" * 3000, "own.yaml: not a readable YAML file: nested too deeply"),
        (SHARED + "x: 2020-13-01\n", "own.yaml: unknown key `x`"),
        (SHARED + f"x: {'9' * 5000}\n", "own.yaml: not a readable YAML file: numbers must be"),
        *(
            (SHARED + f"x: {number}\n", "numbers must be from 1e-30 to 1e\\+30, or 0")
            for number in IMPOSSIBLE
        ),
        (SHARED + 'flights: {a: {vehicle: "a\\0b"}}\n', "vehicle: expected a path"),
        (SHARED + 'flights: {a: {noise: "a\\nb"}}\n', "no such noise file"),
        (SHARED + 'flights: {"a\\nb": {}}\n', "letters, digits"),
        (SHARED + "include: [own.yaml]\n", "a scenario cannot include itself"),
    ],
)
def test_files(refused_file, content, message):
    refused_file(message, content)


@pytest.mark.parametrize("key", ["duration_s", "height_m", "head_wind_m_s", "seed", "truth_rate_hz"])
@pytest.mark.parametrize("value", ["1e999", "-1e3", ".nan", "true", "text", "[]"])
def test_keys(refused_flight, key, value):
    refused_flight(f"own.yaml: flight `a`: `{key}` must be a (whole )?number", f"{{{key}: {value}}}")


@pytest.mark.parametrize("value", ["1e999", "-.inf", "yes", "[1]"])
def test_parameters_of_effects(refused_flight, value):
    refused_flight("`mass_kg` must be a number", f"{{effects: {{payload: {{mass_kg: {value}}}}}}}")


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        (STEP % (1, 1e-6), "step: `rise_s` must be a number not below 0.001, found 1e-06"),
        pytest.param(STEP % (1e30, 1), "unreachable reference", marks=pytest.mark.filterwarnings("error")),
        (
            "{orbit: {radius_m: 1, speed_m_s: 1, start_s: 0, fade_s: 1e-6}}",
            "`fade_s` must be a number not below 0.001",
        ),
    ],
)
def test_motion(refused_flight, flight, message):
    refused_flight(message, flight)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (("frozen", 1e10, 1), "`at_s` must be a number from 0 to 1e\\+06"),
        (("frozen", 0, 1e10), "`for_s` must be a number from 0 to 1e\\+06"),
        (("stamps_backward, size_s: 1e10", 0, 1), "`size_s` must be a number from 0 to 1e\\+06"),
        (("frozen", 1.5, 1), "flight a: fault frozen of topic imu at 1.5 s: the flight lasts 1 s"),
    ],
)
def test_faults(refused_flight, fault, message):
    refused_flight(message, FAULT % fault)


def test_parameter_given_twice(refused, tmp_path):
    for options in (
        ("--effect", "payload:mass_kg=0.1,mass_kg=0.2"),
        ("--effect", "payload:mass_kg=0.1", "--effect", "payload:mass_kg=0.2"),
    ):
        refused("`mass_kg` is given twice", "simulate", "orbit", "-o", tmp_path / "bags", *options)


def test_folder_in_the_place_of_a_bag(refused, tmp_path):
    taken = tmp_path / "bags" / "centre_5.mcap"
    taken.mkdir(parents=True)
    options = ("--flight", "centre_3", "--flight", "centre_5")
    refused(
        "bags/centre_5.mcap: cannot be written: Is a directory",
        "simulate",
        "orbit",
        "-o",
        tmp_path / "bags",
        *options,
    )
