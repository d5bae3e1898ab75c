# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A model as parameters and in the forms of other simulators, which fly as our simulation does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from quadpi_core.errors import ModelError
from quadpi_core.field.estimates import Estimate, not_identified
from quadpi_core.field.motor_use import ThrustCurve, untold_curve
from quadpi_core.frames import rotate_body_to_world
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.small_model import SmallModel, small_model
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import load_scenario
from quadpi_core.simulation.simulated_bags import fly_plan
from quadpi_core.simulation.simulated_file import Exported, exported_text
from quadpi_core.simulation.truth import Truth
from quadpi_core.vehicle import Vehicle

SWING = """
description: one swing
vehicle: bebop2
seed: 1
flights:
  swing:
    duration_s: 8.0
    motion:
      x: [{sine: {amplitude_m: 1.5, frequency_hz: 0.25, start_s: 0.5, duration_s: 7.0, fade_s: 2.0}}]
      y: [{sine: {amplitude_m: 0.8, frequency_hz: 0.35, start_s: 0.5, duration_s: 7.0, fade_s: 2.0}}]
"""


def near(value: float, unit: str, said: str = "near hover") -> Estimate:
    return Estimate(value, 0.9 * value, 1.1 * value, unit, said)


def exported(**changes: Any) -> Exported:
    """The Bebop 2, as wind tunnel and file have it."""
    vehicle = Vehicle.load("bebop2")
    own: dict[str, Any] = {
        "vehicle": vehicle,
        "identity": "model@0123",
        "thrust": near(0.0156 * 1.225 * np.pi * 0.075**4, "N s²"),
        "torque": near(0.0113, "m"),
        "hover_speed": near(770.0, "rad/s"),
        "inertia": tuple(near(float(one), "kg m²") for one in np.diag(vehicle.inertia)),
        "momentum": near(0.118 / vehicle.mass_kg, "1/s"),
        "ballistic": (near(30.0, "kg/m²"), not_identified("kg/m²", "too slow")),
    }
    curve = ThrustCurve(near(0.6, ""), near(0.4, "of full thrust"))
    return Exported(SmallModel(**(own | changes)), curve, 0.033)


def test_px4_takes_what_is_identified_and_says_why_not() -> None:
    text = exported_text("px4", exported())
    rows = [line.split("\t") for line in text.splitlines() if not line.startswith("#")]
    assert all(row[0] == "1" and row[1] == "1" and row[4] == "9" for row in rows)
    values = {row[2]: float(row[3]) for row in rows}
    assert set(values) == {"EKF2_MCOEF", "EKF2_BCOEF_X", "THR_MDL_FAC", "MPC_THR_HOVER"}
    assert values["EKF2_BCOEF_X"] == 30.0
    assert "# EKF2_BCOEF_X: 95 % 27 to 33 kg/m²; near hover" in text
    assert "# EKF2_BCOEF_Y: not identified: too slow" in text


def test_ardupilot_has_its_own_names() -> None:
    text = exported_text("ardupilot", exported()._replace(curve=untold_curve("no log")))
    values = dict(line.split(",") for line in text.splitlines() if not line.startswith("#"))
    assert set(values) == {"EK3_DRAG_MCOEF", "EK3_DRAG_BCOEF_X"}
    assert "# MOT_THST_EXPO: not identified: no log" in text


def test_json_holds_every_number_with_its_interval() -> None:
    content = json.loads(exported_text("json", exported()))
    assert content["parameters"]["momentum_drag_1_s"]["low"] == pytest.approx(0.9 * 0.118 / 0.374)
    assert content["parameters"]["ballistic_y_kg_m2"]["value"] is None
    assert len(content["rotors"]) == 4


def test_a_simulator_needs_thrust_and_torque() -> None:
    lacking = exported(torque=not_identified("m", "no flight of the model was near hover"))
    for form in ("sdf", "mjcf"):
        with pytest.raises(ModelError, match="needs the torque of a rotor: not identified: no flight"):
            exported_text(form, lacking)


def test_moments_of_no_rigid_body_are_refused() -> None:
    thin = tuple(near(one, "kg m²") for one in (1e-3, 1e-3, 2.5e-3))
    with pytest.raises(ModelError, match=r"inertia 0\.001, 0\.001, 0\.0025 kg m² are those of no"):
        exported_text("mjcf", exported(inertia=thin))


def test_the_sdf_is_a_model_of_the_vehicles_mass_with_a_motor_for_each_rotor() -> None:
    root = ElementTree.fromstring(exported_text("sdf", exported()))
    assert (root.tag, root.get("version")) == ("sdf", "1.9")
    (model,) = root.findall("model")
    vehicle = Vehicle.load("bebop2")
    assert sum(float(one.text) for one in model.iter("mass")) == pytest.approx(vehicle.mass_kg, rel=1e-4)
    links = {one.get("name") for one in model.findall("link")}
    joints = {one.get("name"): one for one in model.findall("joint")}
    assert {one.findtext("child") for one in joints.values()} | {"base_link"} == links
    motors = model.findall("plugin")
    assert [int(one.findtext("actuator_number")) for one in motors] == [0, 1, 2, 3]
    for motor, place, spin in zip(motors, vehicle.rotor_positions, vehicle.rotor_spins, strict=True):
        assert motor.findtext("jointName") in joints
        assert motor.findtext("turningDirection") == ("cw" if spin > 0.0 else "ccw")
        (link,) = [one for one in model.findall("link") if one.get("name") == motor.findtext("linkName")]
        pose = [float(word) for word in link.findtext("pose").split()]
        assert pose[:3] == pytest.approx(place * [1.0, -1.0, -1.0])
    base = model.find("link/inertial/inertia")
    # Forward-left-up: the product of x and z changes its sign.
    assert float(base.findtext("ixz")) == pytest.approx(-vehicle.inertia[0, 2], rel=1e-4)
    # Base and rotors together have the vehicle's inertia, about its centre of gravity.
    total, first = np.zeros((3, 3)), np.zeros(3)
    for link in model.findall("link"):
        mass = float(link.findtext("inertial/mass"))
        poses = [link.findtext("pose"), link.findtext("inertial/pose")]
        place = sum(np.array([float(word) for word in (pose or "0 0 0").split()[:3]]) for pose in poses)
        own = {key: float(link.findtext(f"inertial/inertia/{key}") or 0.0) for key in ("ixx", "iyy", "izz")}
        total += np.diag(list(own.values())) + mass * (place @ place * np.eye(3) - np.outer(place, place))
        first += mass * place
    np.testing.assert_allclose(np.diag(total), np.diag(vehicle.inertia), rtol=1e-3)
    np.testing.assert_allclose(first, 0.0, atol=1e-8)


@pytest.mark.parametrize("form", ["sdf", "mjcf"])
def test_hyphens_in_a_name_end_no_comment(form: str) -> None:
    text = exported_text(form, exported(identity="my---model--x@0123"))
    ElementTree.fromstring(text)
    assert "model my-model-x@0123" in text


def flown(tmp_path: Path) -> Truth:
    scenario = tmp_path / "swing.yaml"
    scenario.write_text(SWING)
    return fly_plan(load_scenario(scenario).flights[0], SimulatedVehicle.load("bebop2"))


def test_the_mjcf_flies_five_seconds_as_our_simulation(physical_folder: Path, tmp_path: Path) -> None:
    """By the rotor speeds of our flight, and a controller for moments by airspeed, which small models lack.

    Of thrust it has hardly to add any, and drag needs no other tilt.
    """
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")
    truth, identified = flown(tmp_path), AerodynamicModel.load(physical_folder)
    small = small_model(identified, identified.load_vehicle())
    text = exported_text("mjcf", Exported(small, untold_curve("no log"), 0.033))
    model = mujoco.MjModel.from_xml_string(text)
    assert model.body_mass.sum() == pytest.approx(0.374, rel=1e-4)
    data = mujoco.MjData(model)
    flip = np.array([1.0, -1.0, -1.0])
    position, velocity = truth.position * flip, rotate_body_to_world(truth.attitude, truth.velocity) * flip
    # North-west-up and forward-left-up are the same half turn about x from ours.
    attitude, rates = truth.attitude * np.array([1.0, 1.0, -1.0, -1.0]), truth.rates * flip
    first = int(np.searchsorted(truth.time, 1.5))
    data.qpos[:], data.qvel[:] = (
        np.concatenate([position[first], attitude[first]]),
        np.concatenate([velocity[first], rates[first]]),
    )
    squares, allocation = truth.rotor_speeds**2, np.linalg.inv(_effect(model))
    hover, errors, efforts, tilts = float(np.mean(squares[first])), [], [], []
    for step in range(round(5.0 / model.opt.timestep)):
        now = int(np.searchsorted(truth.time, truth.time[first] + step * model.opt.timestep))
        off, drift = position[now] - data.qpos[:3], velocity[now] - data.qvel[:3]
        pull = 6.0 * off + 4.0 * drift
        turned = np.zeros(3)
        mujoco.mju_subQuat(turned, attitude[now], data.qpos[3:])
        # A pull to the front is a pitch down of as many radians as it is of g.
        lean = turned + np.array([-pull[1], pull[0], 0.0]) / 9.81
        spin = rates[now] - data.qvel[3:]
        moments = model.body_inertia[1].mean() * (400.0 * lean + 40.0 * spin)
        effort = allocation @ np.array([0.374 * pull[2], *moments])
        data.ctrl[:] = squares[now] + effort
        mujoco.mj_step(model, data)
        errors.append(np.linalg.norm(off))
        efforts.append(effort / hover)
        tilts.append(np.linalg.norm(turned))
    assert max(errors) < 0.25
    # Thrust is that of hover: in motion rotors lose some hundredths.
    assert abs(np.mean(efforts)) < 0.05
    assert np.sqrt(np.mean(np.square(tilts))) < 0.05


def _effect(model: Any) -> np.ndarray:
    """Thrust and moments (4, rotors) per control, forward-left-up."""
    gear, places = model.actuator_gear, model.site_pos
    thrust, torque = gear[:, 2], gear[:, 5]
    return np.stack([thrust, places[:, 1] * thrust, -places[:, 0] * thrust, torque])
