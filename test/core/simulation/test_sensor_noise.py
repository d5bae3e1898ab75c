# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from dataclasses import fields, replace

import numpy as np
import pytest

from quadpi_core.errors import SimulationError
from quadpi_core.flight import Flight
from quadpi_core.frames import inverse, product, to_rotation_vector
from quadpi_core.simulation.sensor_noise import (
    Accelerometer,
    Gyro,
    InertialSensor,
    SensorSuite,
    StateNoise,
    contaminate,
    generator,
    inertial_samples,
    turned,
)
from quadpi_core.vehicle import Vehicle

STILL = np.zeros((20_000, 3))
RATE_HZ = 500.0


@pytest.fixture
def suite(tmp_path):
    """suite(text) → SensorSuite of a file that holds it."""

    def load(text):
        path = tmp_path / "own.yaml"
        path.write_text(text)
        return SensorSuite.load(path)

    return load


def test_paper_has_the_numbers_of_its_table():
    paper = SensorSuite.load("paper")
    assert (paper.rotor_speeds.rate, paper.rotor_speeds.noise) == (500.0, 5.0)
    assert (paper.imu.rate, paper.imu.gyro.noise, paper.imu.accelerometer.noise) == (500.0, 0.01, 0.03)
    assert (paper.mocap.rate, paper.mocap.attitude_noise) == (120.0, 0.01)
    assert paper.states == StateNoise(
        velocity=0.03, attitude=0.01, rates=0.01, specific_force=0.03, rotor_speeds=5.0
    )
    assert paper.imu.gyro.bias == paper.imu.accelerometer.bias == 0.0  # "mean 0"


def test_mpu6000_is_that_of_its_data_sheet():
    imu = SensorSuite.load("mpu6000").imu
    g, degree = 9.80665, np.pi / 180.0
    np.testing.assert_allclose(imu.gyro.noise_density, 0.005 * degree, rtol=1e-3)
    np.testing.assert_allclose(imu.accelerometer.noise_density, 400e-6 * g, rtol=1e-3)
    np.testing.assert_allclose(imu.gyro.range, 2000 * degree, rtol=1e-5)
    np.testing.assert_allclose(imu.accelerometer.range, 16 * g, rtol=1e-5)
    np.testing.assert_allclose(imu.gyro.resolution, degree / 16.4, rtol=1e-3)
    np.testing.assert_allclose(imu.accelerometer.resolution, g / 2048, rtol=1e-3)


def test_what_a_file_leaves_out_is_perfect(suite):
    assert suite("{}") == SensorSuite("own")
    partly = suite("imu: {gyro: {noise_rad_s: 0.1}}\nmocap: {latency_s: 0.1}")
    assert partly.imu.gyro == Gyro(noise=0.1)
    assert partly.imu.accelerometer == Accelerometer()
    assert (partly.mocap.rate, partly.mocap.latency, partly.mocap.attitude_noise) == (120.0, 0.1, 0.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gyro: {}", r"own\.yaml: unknown key `gyro`; known: source, imu, "),
        ("imu: {giro: {}}", r"own\.yaml: imu: unknown key `giro`; .*did you mean `gyro`\?"),
        (
            "imu: {gyro: {noise_m_s2: 1}}",
            r"imu\.gyro: unknown key `noise_m_s2`; .*did you mean `noise_rad_s`",
        ),
        (
            "imu: {gyro: {noise_rad_s: -1}}",
            r"imu\.gyro: `noise_rad_s` must be a number not below 0, found -1",
        ),
        (
            "imu: {gyro: {noise_rad_s: .nan}}",
            r"imu\.gyro: `noise_rad_s` must be a number not below 0, found nan",
        ),
        (
            "imu: {accelerometer: {noise_m_s2: 1, noise_density_m_s2_sqrt_hz: 1}}",
            r"imu\.accelerometer: give the noise of a sample or its density, not both",
        ),
        ("imu: {position_m: [1, 2]}", r"imu: `position_m` must be three numbers, found \[1, 2\]"),
        ("imu: 3", r"own\.yaml: imu: expected keys and values, found 3"),
        ("rotor_speeds: {rate_hz: 0}", r"rotor_speeds: `rate_hz` must be a number not below 0\.1, found 0"),
        (
            "mocap: {dropout_probability: 1.5}",
            r"`dropout_probability` must be a number from 0 to 1, found 1\.5",
        ),
        (
            "mocap: {rate_hz: 1e7}",
            r"mocap: `rate_hz` must be a number from 0\.1 to 1000, found 10000000",
        ),
        ("mocap: {latency_s: late}", r"mocap: `latency_s` must be a number from 0 to 10, found 'late'"),
        ("states: {velocity: 1}", r"states: unknown key `velocity`; .*did you mean `velocity_m_s`\?"),
        ("[1]", r"own\.yaml: expected keys and values, found \[1\]"),
    ],
)
def test_bad_settings_are_named(suite, text, message):
    with pytest.raises(SimulationError, match=message):
        suite(text)


def test_unknown_suite_names_the_nearest():
    with pytest.raises(SimulationError, match=r"papers\.yaml: no such noise file; .*did you mean `paper`\?"):
        SensorSuite.load("papers")


def test_perfect_sensor_reports_the_truth():
    ideal = generator(1, "truth").standard_normal((50, 3))
    reported = inertial_samples(ideal, InertialSensor(), RATE_HZ, generator(1, "gyro"))
    np.testing.assert_array_equal(reported, ideal)


@pytest.mark.parametrize(
    ("sensor", "deviation"),
    [(InertialSensor(noise=0.03), 0.03), (InertialSensor(noise_density=0.004), 0.004 * np.sqrt(250.0))],
)
def test_white_noise_of_a_sample_or_of_a_density(sensor, deviation):
    white = inertial_samples(STILL, sensor, RATE_HZ, generator(2, "gyro"))
    np.testing.assert_allclose(white.std(axis=0), deviation, rtol=0.03)
    np.testing.assert_allclose(white.mean(axis=0), 0.0, atol=5.0 * deviation / np.sqrt(len(white)))
    assert abs(np.corrcoef(white[1:, 0], white[:-1, 0])[0, 1]) < 0.03
    assert np.abs(np.corrcoef(white.T) - np.eye(3)).max() < 0.03
    # All power of a density lies below half the sample rate.
    power = np.abs(np.fft.rfft(white[:, 0])) ** 2 * 2.0 / (RATE_HZ * len(white))
    np.testing.assert_allclose(np.sqrt(power.mean()), deviation / np.sqrt(250.0), rtol=0.03)


def test_bias_is_drawn_once_per_flight_and_axis():
    sensor = InertialSensor(bias=0.2)
    biases = np.array(
        [inertial_samples(STILL[:5], sensor, RATE_HZ, generator(seed, "gyro")) for seed in range(400)]
    )
    assert np.ptp(biases, axis=1).max() == 0.0
    np.testing.assert_allclose(biases[:, 0].std(axis=0), 0.2, rtol=0.12)
    assert np.abs(np.corrcoef(biases[:, 0].T) - np.eye(3)).max() < 0.2


def test_bias_walks_with_the_root_of_time():
    sensor = InertialSensor(bias_walk=0.01)
    walks = np.array(
        [inertial_samples(STILL[:2001], sensor, RATE_HZ, generator(seed, "gyro")) for seed in range(300)]
    )
    assert not walks[:, 0].any()
    np.testing.assert_allclose(walks[:, 500].std(), 0.01, rtol=0.1)
    np.testing.assert_allclose(walks[:, 2000].std(), 0.02, rtol=0.1)


def test_sensor_saturates_then_rounds():
    ramp = np.linspace(-3.0, 3.0, 300).reshape(-1, 3)
    sensor = InertialSensor(range=2.0, resolution=0.25)
    reported = inertial_samples(ramp, sensor, RATE_HZ, generator(1, "gyro"))
    assert np.abs(reported).max() == 2.0
    np.testing.assert_array_equal(reported / 0.25, np.rint(reported / 0.25))
    inside = np.abs(ramp) < 2.0
    assert np.abs(reported - ramp)[inside].max() <= 0.125


def test_streams_of_random_numbers_are_of_seed_and_name():
    names = ("gyro", "accelerometer", "wind")
    drawn = np.array([generator(seed, name).standard_normal(5000) for name in names for seed in (1, 2)])
    assert np.abs(np.corrcoef(drawn) - np.eye(6)).max() < 0.06
    np.testing.assert_array_equal(generator(2, "gyro").standard_normal(5000), drawn[1])


def test_turned_by_a_rotation_vector():
    random = generator(4, "turn")
    attitude = random.standard_normal((20, 4))
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    turn = 0.3 * random.standard_normal((20, 3))
    result = turned(attitude, turn)
    np.testing.assert_allclose(np.linalg.norm(result, axis=1), 1.0, rtol=1e-14)
    back = [to_rotation_vector(product(inverse(q), r)) for q, r in zip(attitude, result, strict=True)]
    np.testing.assert_allclose(back, turn, atol=1e-14)


@pytest.fixture(scope="module")
def flight(swing):
    return swing(20.0).flight()


def test_contaminated_flight_has_the_noise_of_the_paper(flight):
    noisy = contaminate(flight, SensorSuite.load("paper").states, seed=3)

    def deviation(name):
        return (getattr(noisy, name) - getattr(flight, name)).std(axis=0)

    np.testing.assert_allclose(deviation("velocity"), 0.03, rtol=0.03)
    np.testing.assert_allclose(deviation("rates"), 0.01, rtol=0.03)
    np.testing.assert_allclose(deviation("specific_force"), 0.03, rtol=0.03)
    np.testing.assert_allclose(deviation("rotor_speeds"), 5.0, rtol=0.03)
    turn = [
        to_rotation_vector(product(inverse(before), after))
        for before, after in zip(flight.attitude, noisy.attitude, strict=True)
    ]
    np.testing.assert_allclose(np.std(turn, axis=0), 0.01, rtol=0.03)
    for name in ("time", "position", "wind", "angular_acceleration"):
        assert getattr(noisy, name) is getattr(flight, name)


def test_contamination_draws_each_state_by_itself(flight):
    noise = StateNoise(velocity=0.03, attitude=0.01, rates=0.01)
    one = contaminate(flight, noise, seed=3)
    assert_only_differ(one, contaminate(flight, noise, seed=3), set())
    assert_only_differ(one, contaminate(flight, replace(noise, velocity=0.1), seed=3), {"velocity"})
    assert_only_differ(one, contaminate(flight, noise, seed=4), {"velocity", "attitude", "rates"})


def assert_only_differ(one: Flight, other: Flight, names: set[str]):
    different = {
        column.name
        for column in fields(Flight)
        if isinstance(getattr(one, column.name), np.ndarray)
        and not np.array_equal(getattr(one, column.name), getattr(other, column.name))
    }
    assert different == names


def test_a_model_folder_says_the_noise_of_its_vehicle(physical_folder):
    suite, stated = SensorSuite.load(physical_folder), Vehicle.load("bebop2").noise
    assert suite.imu.gyro.noise == stated.gyro_noise_rad_s
    assert suite.imu.accelerometer.noise == stated.accelerometer_noise_m_s2
    assert (suite.mocap.position_noise, suite.mocap.rate) == (
        stated.mocap_position_m,
        SensorSuite.load("paper").mocap.rate,
    )
