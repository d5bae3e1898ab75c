# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadpi_core.errors import LogError
from quadpi_core.flight import AirStream, Flight, ImuStream, Recording, TemperatureStream
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.inputs import (
    ASSUMED,
    BOARD,
    INPUT_INDEX,
    INPUT_NAMES,
    MEASURED,
    NOTICED,
    STANDARD_DENSITY,
    Air,
    aerodynamic_inputs,
    density_of,
    density_range,
    flight_inputs,
    flown_in,
)
from quadpi_core.vehicle import Vehicle
from test.core.multicopters import multicopter

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])
HOVER = Vehicle.load("bebop2").hover_induced_velocity  # m/s


@pytest.fixture(scope="module")
def bebop() -> Vehicle:
    return Vehicle.load("bebop2")


def columns(inputs: Array, *names: str) -> Array:
    return inputs[:, [INPUT_INDEX[name] for name in names]]


def inputs_of(
    vehicle: Vehicle,
    velocity: Array | None = None,
    attitude: Array | None = None,
    rates: Array | None = None,
    rotor_speeds: Array | None = None,
) -> Array:
    """Inputs with whatever is not given in level hover at 600 rad/s; N from what is given."""
    given = [values for values in (velocity, attitude, rates, rotor_speeds) if values is not None]
    count = len(given[0])
    return aerodynamic_inputs(
        np.zeros((count, 3)) if velocity is None else velocity,
        np.tile(LEVEL, (count, 1)) if attitude is None else attitude,
        np.zeros((count, 3)) if rates is None else rates,
        np.full((count, 4), 600.0) if rotor_speeds is None else rotor_speeds,
        vehicle,
    )


def induced_velocity(velocity: Array) -> Array:
    """(N,) m/s at velocities (N, 3) relative to the air, of rotors with :data:`HOVER`."""
    return inputs_of(Vehicle.load("bebop2"), velocity=velocity)[:, INPUT_INDEX["v_in"]]


def random_state(rng: np.random.Generator, count: int) -> tuple[Array, Array, Array, Array]:
    return (
        rng.normal(scale=8.0, size=(count, 3)),
        Rotation.random(count, rng=rng).as_quat(scalar_first=True),
        rng.normal(scale=5.0, size=(count, 3)),
        rng.uniform(0.0, 1200.0, size=(count, 4)),
    )


def regimes() -> dict[str, Array]:
    rng = np.random.default_rng(1)
    along = np.linspace(0.0, 30.0, 301)
    zero = np.zeros_like(along)
    near_hover = rng.normal(scale=1e-6, size=(300, 3))
    return {
        "hover": np.zeros((1, 3)),
        "near hover": near_hover,
        "climb": np.stack((zero, zero, -along), axis=1),
        "descent": np.stack((zero, zero, along), axis=1),
        "descent, slightly sideways": np.stack((zero + 1e-3, zero, along), axis=1),
        "forward": np.stack((along, zero, zero), axis=1),
        "random": rng.normal(scale=10.0, size=(3000, 3)),
    }


@pytest.mark.parametrize("regime", regimes())
def test_induced_velocity_satisfies_the_momentum_equation(regime: str) -> None:
    velocity = regimes()[regime]
    v_in = induced_velocity(velocity)
    in_plane = np.hypot(velocity[:, 0], velocity[:, 1])
    # Eq. 8 multiplied out, so that a descent at v_in = w divides by nothing; in units of v_h.
    through = np.hypot(in_plane, v_in - velocity[:, 2])
    assert np.all(np.abs(v_in * through / HOVER**2 - 1.0) <= 1e-10)


@pytest.mark.parametrize("regime", regimes())
def test_induced_velocity_is_the_largest_root(regime: str) -> None:
    velocity = regimes()[regime]
    for (u, v, w), v_in in zip(velocity, induced_velocity(velocity), strict=True):
        a, b = (u * u + v * v) / HOVER**2, w / HOVER
        roots = np.roots([1.0, -2.0 * b, a + b * b, 0.0, -1.0])
        real = roots[np.abs(roots.imag) < 1e-9].real
        assert v_in / HOVER == pytest.approx(real.max(), rel=1e-7)


def test_induced_velocity_in_hover_is_that_of_momentum_theory(bebop: Vehicle) -> None:
    disc_area = 4 * np.pi * bebop.rotor_radius_m**2
    expected = np.sqrt(bebop.mass_kg * bebop.gravity_m_s2 / (2 * bebop.air_density_kg_m3 * disc_area))
    (v_in,) = inputs_of(bebop, velocity=np.zeros((1, 3)))[:, INPUT_INDEX["v_in"]]
    assert v_in == pytest.approx(expected, rel=1e-14)


def test_induced_velocity_falls_in_climb_and_with_airspeed_and_rises_in_descent() -> None:
    w = np.linspace(-15.0, 0.9 * HOVER, 200)
    axial = induced_velocity(np.stack((np.zeros(200), np.zeros(200), w), axis=1))
    assert np.all(np.diff(axial) > 0.0)
    u = np.linspace(0.0, 20.0, 200)
    forward = induced_velocity(np.stack((u, np.zeros(200), np.zeros(200)), axis=1))
    assert np.all(np.diff(forward) < 0.0)


def test_whole_flight_equals_sample_by_sample(bebop: Vehicle) -> None:
    state = random_state(np.random.default_rng(2), 50)
    together = aerodynamic_inputs(*state, bebop)
    one_by_one = [aerodynamic_inputs(*(part[i : i + 1] for part in state), bebop) for i in range(50)]
    np.testing.assert_array_equal(together, np.concatenate(one_by_one))


def test_control_moments_of_the_papers_numbering(bebop: Vehicle) -> None:
    """Rotor 1 front left, 2 front right, 3 rear right, 4 rear left (Eq. 5 to 7)."""
    rotor_speeds = np.random.default_rng(3).uniform(300.0, 1000.0, size=(20, 4))
    w1, w2, w3, w4 = rotor_speeds.T
    first_rotor = -1.0  # the Bebop's first rotor turns counterclockwise
    expected = np.stack(
        (
            (w1 + w4) - (w2 + w3),
            (w1 + w2) - (w3 + w4),
            first_rotor * ((w1 + w3) - (w2 + w4)),
        ),
        axis=1,
    )
    inputs = inputs_of(bebop, rotor_speeds=rotor_speeds)
    np.testing.assert_allclose(columns(inputs, "U_p", "U_q", "U_r"), expected, atol=1e-9)


@pytest.mark.parametrize("order", [(1, 2, 3, 0), (3, 0, 2, 1), (2, 1, 0, 3)])
def test_inputs_do_not_depend_on_the_order_of_the_rotors(bebop: Vehicle, order: tuple[int, ...]) -> None:
    rotors = list(order)
    permuted = replace(
        bebop, rotor_positions=bebop.rotor_positions[rotors], rotor_spins=bebop.rotor_spins[rotors]
    )
    velocity, attitude, rates, rotor_speeds = random_state(np.random.default_rng(4), 20)
    expected = aerodynamic_inputs(velocity, attitude, rates, rotor_speeds, bebop)
    inputs = aerodynamic_inputs(velocity, attitude, rates, rotor_speeds[:, rotors], permuted)
    np.testing.assert_allclose(inputs, expected, rtol=1e-12, atol=1e-9)


def test_mean_rotor_speed_and_advance_ratios(bebop: Vehicle) -> None:
    velocity, attitude, rates, rotor_speeds = random_state(np.random.default_rng(5), 20)
    inputs = aerodynamic_inputs(velocity, attitude, rates, rotor_speeds, bebop)
    omega_avg = np.sqrt((rotor_speeds**2).sum(axis=1) / 4)
    np.testing.assert_allclose(inputs[:, INPUT_INDEX["omega_avg"]], omega_avg, rtol=1e-14)
    tip_speed = omega_avg[:, None] * bebop.rotor_radius_m
    moving = columns(inputs, "u", "v", "w", "v_in")
    np.testing.assert_allclose(columns(inputs, "mu_x", "mu_y", "mu_z", "mu_v_in"), moving / tip_speed)
    np.testing.assert_array_equal(columns(inputs, "u", "v", "w"), velocity)
    np.testing.assert_array_equal(columns(inputs, "p", "q", "r"), rates)


def test_rotors_at_rest_have_no_advance_ratio(bebop: Vehicle) -> None:
    speeds = np.array([0.0, 0.999, 1.001])
    inputs = inputs_of(
        bebop, velocity=np.full((3, 3), 2.0), rotor_speeds=np.repeat(speeds[:, None], 4, axis=1)
    )
    ratios = columns(inputs, "mu_x", "mu_y", "mu_z", "mu_v_in")
    assert np.all(np.isfinite(inputs))
    assert np.all(ratios[:2] == 0.0)
    assert np.all(ratios[2] > 0.0)


def test_attitude_terms_are_those_of_the_rotation_matrix(bebop: Vehicle) -> None:
    attitude = Rotation.random(500, rng=np.random.default_rng(6)).as_quat(scalar_first=True)
    terms = columns(inputs_of(bebop, attitude=attitude), "sin_phi", "cos_phi", "sin_theta", "cos_theta")
    sin_phi, cos_phi, sin_theta, cos_theta = terms.T
    down_in_body = rotation_matrix(attitude)[:, 2, :]
    expected = np.stack((-sin_theta, sin_phi * cos_theta, cos_phi * cos_theta), axis=1)
    np.testing.assert_allclose(expected, down_in_body, atol=1e-12)
    assert np.all(cos_theta >= 0.0)


@pytest.mark.parametrize("pitch_deg", [-90.0, -89.999, -60.0, 0.0, 75.0, 89.9999, 90.0])
def test_attitude_terms_of_euler_angles_up_to_the_vertical(bebop: Vehicle, pitch_deg: float) -> None:
    yaw, pitch, roll = 0.7, np.radians(pitch_deg), -0.4
    attitude = Rotation.from_euler("ZYX", [[yaw, pitch, roll]]).as_quat(scalar_first=True)
    terms = columns(inputs_of(bebop, attitude=attitude), "sin_theta", "cos_theta", "sin_phi", "cos_phi")[0]
    np.testing.assert_allclose(terms[:2], [np.sin(pitch), np.cos(pitch)], atol=3e-8)
    assert np.hypot(terms[2], terms[3]) == pytest.approx(1.0, abs=1e-12)
    if abs(pitch_deg) < 89.99999:
        np.testing.assert_allclose(terms[2:], [np.sin(roll), np.cos(roll)], atol=1e-8)


def test_the_same_attitude_by_either_quaternion(bebop: Vehicle) -> None:
    attitude = Rotation.random(20, rng=np.random.default_rng(7)).as_quat(scalar_first=True)
    np.testing.assert_array_equal(inputs_of(bebop, attitude=attitude), inputs_of(bebop, attitude=-attitude))


def flight_of(vehicle: Vehicle, state: tuple[Array, Array, Array, Array], wind: Array) -> Flight:
    velocity, attitude, rates, rotor_speeds = state
    count = len(velocity)
    return Flight(
        name="flight",
        vehicle=vehicle.name,
        source="flight.csv",
        start_ns=0,
        time=np.arange(count) / 500.0,
        position=np.zeros((count, 3)),
        attitude=attitude,
        velocity=velocity,
        rates=rates,
        angular_acceleration=np.zeros((count, 3)),
        specific_force=np.zeros((count, 3)),
        rotor_speeds=rotor_speeds,
        wind=wind,
    )


def test_wind_is_subtracted_in_body_axes(bebop: Vehicle) -> None:
    rng = np.random.default_rng(8)
    velocity, attitude, rates, rotor_speeds = random_state(rng, 30)
    wind = rng.normal(scale=5.0, size=(30, 3))
    wind_in_body = Rotation.from_quat(attitude, scalar_first=True).apply(wind, inverse=True)
    expected = aerodynamic_inputs(velocity - wind_in_body, attitude, rates, rotor_speeds, bebop)
    flight = flight_of(bebop, (velocity, attitude, rates, rotor_speeds), wind)
    np.testing.assert_allclose(flight_inputs(flight, bebop), expected, rtol=1e-9, atol=1e-9)


def test_a_vehicle_that_drifts_with_the_wind_feels_none(bebop: Vehicle) -> None:
    _, attitude, rates, rotor_speeds = random_state(np.random.default_rng(9), 10)
    wind = np.tile([3.0, -2.0, 0.5], (10, 1))
    drifting = Rotation.from_quat(attitude, scalar_first=True).apply(wind, inverse=True)
    inputs = flight_inputs(flight_of(bebop, (drifting, attitude, rates, rotor_speeds), wind), bebop)
    np.testing.assert_allclose(columns(inputs, "u", "v", "w", "mu_x", "mu_y", "mu_z"), 0.0, atol=1e-12)
    np.testing.assert_allclose(inputs[:, INPUT_INDEX["v_in"]], bebop.hover_induced_velocity, rtol=1e-12)


@pytest.mark.parametrize("scale", [1e-12, 1e-3, 1.0, 1e3, 1e6])
def test_finite_state_gives_finite_inputs(bebop: Vehicle, scale: float) -> None:
    rng = np.random.default_rng(10)
    velocity, attitude, rates, rotor_speeds = random_state(rng, 2000)
    inputs = aerodynamic_inputs(velocity * scale, attitude, rates * scale, rotor_speeds * scale, bebop)
    assert inputs.shape == (2000, len(INPUT_NAMES))
    assert np.all(np.isfinite(inputs))


@pytest.mark.parametrize("rotors", [1, 6, 8, 12])
def test_inputs_of_any_number_of_rotors(tmp_path: Path, rotors: int) -> None:
    vehicle = multicopter(tmp_path, rotors)
    velocity, attitude, rates, _ = random_state(np.random.default_rng(rotors), 50)
    speeds = np.random.default_rng(1).uniform(300.0, 900.0, (50, rotors))
    found = inputs_of(vehicle, velocity, attitude, rates, speeds)
    x, y, _ = vehicle.rotor_positions.T
    mean = np.sqrt(np.mean(np.square(speeds), axis=1))
    moments = np.stack((-np.sign(y), np.sign(x), vehicle.rotor_spins)) @ speeds.T
    np.testing.assert_allclose(columns(found, "omega_avg")[:, 0], mean, rtol=1e-14)
    np.testing.assert_allclose(columns(found, "U_p", "U_q", "U_r"), moments.T, atol=1e-10)
    advance = velocity / (mean * vehicle.rotor_radius_m)[:, np.newaxis]
    np.testing.assert_allclose(columns(found, "mu_x", "mu_y", "mu_z"), advance, rtol=1e-12)


def test_a_flight_with_another_number_of_rotors_than_the_vehicle_is_refused(
    bebop: Vehicle, tmp_path: Path
) -> None:
    flown = flight_of(bebop, random_state(np.random.default_rng(0), 5), np.zeros((5, 3)))
    with pytest.raises(LogError, match="rotor_speeds: 4 rotors, vehicle rotors_6 has 6"):
        flight_inputs(flown, multicopter(tmp_path, 6))


IMU = ImuStream(np.arange(10) * 10**7, np.zeros((10, 3)), np.zeros((10, 3)))
PLAIN = Recording("flight", "bebop2", "flight.mcap", IMU)


def air(*rows: tuple[int, float, float]) -> AirStream:
    time_ns, pressure, celsius = zip(*rows, strict=True)
    return AirStream(np.array(time_ns) * 10**7, np.array(pressure), np.array(celsius))


def test_density_of_the_standard_atmosphere() -> None:
    assert density_of(np.array([101325.0]), np.array([15.0])) == pytest.approx(STANDARD_DENSITY, abs=1e-3)


def test_a_flight_has_the_median_of_both_and_none_of_one_alone() -> None:
    assert flown_in(PLAIN) is None
    pressure = air((0, 90000.0, np.nan), (1, 90000.0, np.nan), (2, 5.0, np.nan))
    assert flown_in(replace(PLAIN, pressure=pressure)) is None
    warm = TemperatureStream(np.array([0]), np.array([np.nan]), np.array([25.0]))
    density, told_by = flown_in(replace(PLAIN, pressure=pressure, temperature=warm))
    assert density == pytest.approx(90000.0 / (287.053 * 298.15))
    assert told_by == MEASURED
    both = air((0, 90000.0, 25.0))
    assert flown_in(replace(PLAIN, pressure=both, board_air=True)) == (density, BOARD)
    # In hPa, in K, or of a dead sensor.
    for wrong in ((900.0, 25.0), (90000.0, 298.15), (0.0, -300.0)):
        assert flown_in(replace(PLAIN, pressure=air((0, *wrong)))) is None


def test_density_follows_both_in_steps() -> None:
    now = Air()
    assert not now.hear(101325.0, np.nan)
    assert now.density == 0.0
    assert now.hear(np.nan, 15.0)
    assert now.density == pytest.approx(STANDARD_DENSITY, abs=1e-3)
    before = now.density
    assert not now.hear(101325.0 * (1.0 + 0.9 * NOTICED.value), np.nan)
    assert now.density == before
    assert now.hear(101325.0 * (1.0 + 1.1 * NOTICED.value), np.nan)
    for nonsense in (0.0, -5.0, 1e9):
        assert not now.hear(nonsense, np.nan)
    for nonsense in (-300.0, 293.15):
        assert not now.hear(np.nan, nonsense)
    # One wrong number does not keep the sensor from being heard.
    assert now.hear(90000.0, np.nan)
    assert now.density == pytest.approx(float(density_of(np.array(90000.0), np.array(15.0))))


def test_changes_are_told_by_the_imu_samples_that_arrived_before() -> None:
    block = replace(PLAIN, pressure=air((2, 101325.0, 15.0), (5, 101330.0, 15.0), (8, 90000.0, 15.0)))
    changes = list(Air().changes(block))
    assert [count for count, _ in changes] == [3, 9]
    assert changes[1][1] / changes[0][1] == pytest.approx(90000.0 / 101325.0)


@pytest.mark.parametrize(
    ("told_by", "file_density", "expected"),
    [
        (MEASURED, STANDARD_DENSITY, (1.0, 1.0)),
        (BOARD, STANDARD_DENSITY, (1.0, 1.1)),
        (ASSUMED, STANDARD_DENSITY, (0.62, 1.15)),
        (ASSUMED, 1.1, (0.95, 1.05)),
    ],
)
def test_what_is_left_open(told_by: str, file_density: float, expected: tuple[float, float]) -> None:
    assert density_range(told_by, file_density) == expected


def test_a_temperature_told_alone_counts_before_that_of_a_barometer() -> None:
    board, outside = (
        air((0, 95000.0, 45.0)),
        TemperatureStream(np.array([5]), np.array([np.nan]), np.array([15.0])),
    )
    density, _ = flown_in(replace(PLAIN, pressure=board, temperature=outside))
    assert density == pytest.approx(density_of(95000.0, 15.0))
    now = Air()
    assert now.hear(95000.0, 45.0)
    assert now.hear(np.nan, 15.0)
    assert now.density == pytest.approx(density)
    assert not now.hear(95000.0, 45.0)
    assert now.density == pytest.approx(density)
