# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import quadpi_core
from quadpi_core.errors import ModelError
from quadpi_core.frames import Array
from quadpi_core.models.physical_terms import (
    MOTION,
    TERM_INDEX,
    TERM_NAMES,
    TERMS,
    MotionSample,
    physical_vehicle,
    regressors,
    scales,
    wrenches,
)
from quadpi_core.records import Records, record_dtype
from quadpi_core.vehicle import Vehicle
from test.core.multicopters import multicopter

VEHICLE = Vehicle.load("neurobem")
REFERENCE = 1.55e-6
CORE = Path(quadpi_core.__file__).parent.parent / "core" / "include" / "quadpi"
HEADER = CORE / "models" / "physical_regressors.hpp"
# Terms of what is not the same left and right, or of rotors that differ.
UNEVEN = (
    *("thrust_incline_y", "bias_y", "bias_roll", "bias_yaw", "incline_y", "gravity_centre_y", "imu_y"),
    *("body_y_downwash", "body_roll_downwash", "body_x_cross", "body_y_cross"),
    *(f"{kind}_rotor_{k}" for kind in ("thrust", "torque") for k in (1, 2, 3)),
)


def motions(count: int, seed: int = 0) -> Records:
    rng = np.random.default_rng(seed)
    motion = np.zeros(count, MOTION)
    for name in motion.dtype.names:
        motion[name] = rng.normal(size=motion[name].shape)
    motion["velocity"] *= 5.0
    motion["rotor_speeds"] = 1300.0 + 200.0 * motion["rotor_speeds"]
    motion["rotor_accelerations"] *= 1000.0
    return motion


def of(motion: Records, name: str, vehicle: Vehicle = VEHICLE) -> Array:
    """Regressor (N, 6) of one term."""
    return regressors(motion, physical_vehicle(vehicle, REFERENCE))[:, TERM_INDEX[name]]


@pytest.mark.skipif(not HEADER.is_file(), reason="an installed package has no sources beside it")
def test_the_struct_of_the_core_has_the_terms_in_their_order() -> None:
    body = re.search(r"struct Regressors \{(.*?)\n\};", HEADER.read_text(), re.S)
    assert body is not None
    names = [re.findall(r"\w+", line) for line in re.findall(r"Wrench ([^;]*);", body[1])]
    assert tuple(name for line in names for name in line) == TERM_NAMES


def test_every_term_pushes_or_turns() -> None:
    assert np.all(np.any(regressors(motions(20), physical_vehicle(VEHICLE, REFERENCE)) != 0.0, axis=(0, 2)))


def test_no_term_is_a_sum_of_others() -> None:
    z = regressors(motions(2000), physical_vehicle(VEHICLE, REFERENCE)) * scales(VEHICLE, REFERENCE)[:, None]
    # Forces and moments in units of weight and of weight times rotor radius, so that all count.
    weight = VEHICLE.mass_kg * VEHICLE.gravity_m_s2
    z /= weight * np.repeat([1.0, VEHICLE.rotor_radius_m], 3)
    columns = z.transpose(1, 0, 2).reshape(len(TERMS), -1)
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    assert np.linalg.svd(columns, compute_uv=False)[-1] > 1e-3


def test_the_wrench_is_the_sum_of_parameters_and_regressors() -> None:
    motion, vehicle = motions(20), physical_vehicle(VEHICLE, REFERENCE)
    parameters = np.random.default_rng(1).normal(size=len(TERMS)) * scales(VEHICLE, REFERENCE)
    expected = np.einsum("npa,p->na", regressors(motion, vehicle), parameters)
    np.testing.assert_allclose(wrenches(motion, vehicle, parameters), expected, rtol=1e-12, atol=1e-15)


def test_four_rotors_in_hover_push_up_and_turn_nothing() -> None:
    motion = np.zeros(1, MOTION)
    motion["rotor_speeds"] = 1000.0
    np.testing.assert_allclose(of(motion, "thrust"), [[0, 0, -4e6, 0, 0, 0]], atol=1e-6)
    np.testing.assert_allclose(of(motion, "torque"), 0.0, atol=1e-6)


def test_the_induced_velocity_is_that_of_momentum_theory() -> None:
    motion = np.zeros(1, MOTION)
    motion["rotor_speeds"] = 1000.0
    disc = 2.0 * VEHICLE.air_density_kg_m3 * np.pi * VEHICLE.rotor_radius_m**2
    induced = np.sqrt(REFERENCE * 1000.0**2 / disc)
    assert of(motion, "thrust_induced")[0, 2] == pytest.approx(4 * 1000.0 * induced)


def test_a_rotor_that_turns_clockwise_turns_the_body_the_other_way() -> None:
    motion = np.zeros(1, MOTION)
    clockwise = VEHICLE.rotor_spins > 0
    motion["rotor_speeds"] = np.where(clockwise, 1000.0, 0.0)
    motion["rotor_accelerations"] = np.where(clockwise, 100.0, 0.0)
    assert of(motion, "torque")[0, 5] < 0.0
    assert of(motion, "rotor_inertia_spin")[0, 5] < 0.0


def test_a_centre_of_gravity_forward_and_right_of_the_rotors_lowers_nose_and_right_side() -> None:
    hover = np.zeros(1, MOTION)
    hover["rotor_speeds"] = 1000.0
    # Thrust then acts behind it and to its left: the moment about y is negative, that about x positive.
    assert of(hover, "gravity_centre_x")[0, 4] < 0.0
    assert of(hover, "gravity_centre_y")[0, 3] > 0.0


@pytest.mark.parametrize("change", ["two rotors in one quadrant", "spins that do not alternate"])
def test_rotor_layouts_whose_speeds_do_not_follow_are_refused(change: str) -> None:
    x, y, z = VEHICLE.rotor_positions.T.copy()
    spins = VEHICLE.rotor_spins
    if change == "two rotors in one quadrant":
        x[0], y[0] = x[1], y[1]
    else:
        spins = np.sign(y)
    other = replace(VEHICLE, rotor_positions=np.stack((x, y, z), axis=1), rotor_spins=spins)
    with pytest.raises(ModelError, match="neurobem: the physical model needs a rotor in each quadrant"):
        physical_vehicle(other, REFERENCE)


def test_drag_and_damping_take_energy() -> None:
    motion = motions(50)
    for name in ("drag_x", "drag_y", "drag_z", "drag_x_speed", "body_x_speed", "body_y_induced"):
        assert np.all(np.sum(of(motion, name)[:, :3] * motion["velocity"], axis=1) <= 0.0), name
    for name in ("damping_p", "damping_q", "damping_r"):
        assert np.all(np.sum(of(motion, name)[:, 3:] * motion["rates"], axis=1) <= 0.0), name
    motion["rates"] = 0.0
    assert np.all(np.sum(of(motion, "rotor_drag")[:, :3] * motion["velocity"], axis=1) <= 0.0)


def test_gyroscopic_moments_do_no_work() -> None:
    motion = motions(50)
    power = np.sum(of(motion, "rotor_inertia_gyro")[:, 3:] * motion["rates"], axis=1)
    np.testing.assert_allclose(power, 0.0, atol=1e-9)


def test_the_accelerometer_feels_the_rotation_about_the_centre_of_gravity() -> None:
    motion = motions(5)
    place = np.array([0.01, -0.02, 0.03])
    felt = sum(size * of(motion, f"imu_{axis}") for size, axis in zip(place, "xyz", strict=True))
    spin = np.cross(motion["rates"], np.cross(motion["rates"], place))
    expected = VEHICLE.mass_kg * (np.cross(motion["angular_acceleration"], place) + spin)
    np.testing.assert_allclose(felt[:, :3], expected, rtol=1e-12)


@pytest.mark.parametrize("name", [name for name in TERM_NAMES if name not in UNEVEN])
def test_a_flight_in_a_mirror_has_the_wrench_in_a_mirror(name: str) -> None:
    motion = motions(10)
    mirrored = motion.copy()
    # Rotors of the file: rear right, front right, rear left, front left.
    other_side = [2, 3, 0, 1]
    mirrored["velocity"][:, 1] *= -1.0
    mirrored["rates"][:, [0, 2]] *= -1.0
    mirrored["angular_acceleration"][:, [0, 2]] *= -1.0
    for column in ("rotor_speeds", "rotor_accelerations"):
        mirrored[column] = motion[column][:, other_side]
    sign = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    np.testing.assert_allclose(of(mirrored, name), sign * of(motion, name), rtol=1e-9, atol=1e-9)


def test_rotors_at_rest_give_finite_numbers() -> None:
    motion = motions(5)
    motion["rotor_speeds"] = 0.0
    assert np.all(np.isfinite(regressors(motion, physical_vehicle(VEHICLE, REFERENCE))))


@pytest.mark.parametrize("rotors", [2, 6, 8, 12])
def test_terms_of_any_number_of_rotors(tmp_path: Path, rotors: int) -> None:
    vehicle, rng = multicopter(tmp_path, rotors), np.random.default_rng(rotors)
    motion = np.zeros(20, record_dtype(MotionSample, rotors))
    motion["velocity"] = rng.normal(0.0, 5.0, (20, 3))
    motion["rates"] = rng.normal(size=(20, 3))
    motion["rotor_speeds"] = speeds = rng.uniform(900.0, 1500.0, (20, rotors))
    motion["rotor_accelerations"] = changes = rng.normal(0.0, 1000.0, (20, rotors))
    (x, y, _), spins = vehicle.rotor_positions.T, vehicle.rotor_spins
    hubs = motion["velocity"][:, np.newaxis] + np.cross(
        motion["rates"][:, np.newaxis], vehicle.rotor_positions
    )
    u, v = hubs[:, :, 0], hubs[:, :, 1]
    zero, square = np.zeros(20), np.square(speeds)
    one = square[:, 0] - square[:, -1]
    for name, expected in {
        "thrust": (zero, zero, -square.sum(1), -square @ y, square @ x, zero),
        "torque": (zero, zero, zero, zero, zero, -square @ spins),
        "rotor_drag": (
            *(-(speeds * u).sum(1), -(speeds * v).sum(1), zero, zero, zero),
            (-x * speeds * v + y * speeds * u).sum(1),
        ),
        "rotor_inertia_spin": (zero, zero, zero, zero, zero, -changes @ spins),
        "body_x_speed": (-speeds.mean(1) * motion["velocity"][:, 0], zero, zero, zero, zero, zero),
        "thrust_rotor_1": (
            *(zero, zero, -one, y[-1] * square[:, -1] - y[0] * square[:, 0]),
            *(x[0] * square[:, 0] - x[-1] * square[:, -1], zero),
        ),
    }.items():
        scale = np.abs(np.stack(expected)).max()
        np.testing.assert_allclose(of(motion, name, vehicle), np.stack(expected, axis=1), atol=1e-12 * scale)
    parameters = rng.normal(size=len(TERMS))
    record = physical_vehicle(vehicle, REFERENCE)
    total = np.einsum("p,npa->na", parameters, regressors(motion, record))
    np.testing.assert_allclose(wrenches(motion, record, parameters), total, rtol=1e-9)
    joined = np.concatenate((motion, motion))
    np.testing.assert_array_equal(regressors(joined, record)[20:], regressors(motion, record))


def test_terms_have_names_of_their_own_and_spreads() -> None:
    assert len(set(TERM_NAMES)) == len(TERMS)
    assert all(term.spread > 0.0 for term in TERMS)
    assert all(term.mean >= 0.0 for term in TERMS if term.positive)


def test_scales_are_those_of_the_vehicle() -> None:
    vehicle, reference = Vehicle.load("neurobem"), 1.55e-6
    scale = dict(zip(TERM_NAMES, scales(vehicle, reference), strict=True))
    assert scale["thrust"] == reference
    assert scale["torque"] == pytest.approx(reference * vehicle.rotor_radius_m)
    assert scale["imu_x"] == vehicle.rotor_radius_m
    assert scale["bias_z"] == pytest.approx(vehicle.mass_kg * vehicle.gravity_m_s2)
    half_length, half_width = np.abs(vehicle.rotor_positions).mean(axis=0)[:2]
    area = 4.0 * half_length * half_width
    assert scale["drag_x"] == pytest.approx(0.5 * vehicle.air_density_kg_m3 * area)
    assert TERM_INDEX["thrust"] == 0
