# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
import json

import numpy as np
import pytest
import yaml

from quadpi_core.config_schema import read_config
from quadpi_core.errors import SimulationError, VehicleError
from quadpi_core.paths import config_directory
from quadpi_core.simulation.rotor_local import RotorLocalModel

BEBOP = config_directory() / "vehicles" / "bebop2.yaml"
# Left and right change places: rotors front left and front right, rear right and rear left.
MIRRORED_ROTORS = [1, 0, 3, 2]


def published(coefficients, velocity, rates, rotor_speeds, arm_x=0.0875, arm_y=0.115, radius=0.075):
    """The published equations, term by term and rotor by rotor, in their own order of rotors and signs."""
    density = 1.225
    sl, sm, sn = [1, -1, -1, 1], [1, 1, -1, -1], [-1, 1, -1, 1]
    places = [(arm_x, -arm_y), (arm_x, arm_y), (-arm_x, arm_y), (-arm_x, -arm_y)]
    k4, k5 = coefficients["rotor_force_along"], coefficients["rotor_force_across"]
    k6, k7 = coefficients["rotor_moment_along"], coefficients["rotor_moment_across"]
    fx = fy = thrusts = mx = my = mz = 0.0
    for i, (x, y) in enumerate(places):
        u, v, w = velocity + np.cross(rates, [x, y, 0.0])
        speed = rotor_speeds[i]
        va = np.sqrt(u**2 + v**2 + w**2)
        m = min(va / (speed * radius), 0.6)
        a = np.arctan(w / np.sqrt(u**2 + v**2))
        basis = np.array(
            (
                *(1, m, m**2, m**3, m**4, m**5, m * a, m**2 * a, m**3 * a, m**4 * a),
                *(m * a**2, m**2 * a**2, m**3 * a**2, m * a**3, m**2 * a**3, m * a**4),
            )
        )
        disc = density * speed**2 * radius**2 * np.pi * radius**2
        thrust = basis @ coefficients["thrust"] * disc
        force_x, force_y = speed * (k4 * u + sn[i] * k5 * v), speed * (k4 * v - sn[i] * k5 * u)
        fx, fy, thrusts = fx + force_x, fy + force_y, thrusts + thrust
        mx += arm_y * sl[i] * thrust + speed * (sn[i] * k7 * u - k6 * v)
        my += arm_x * sm[i] * thrust + speed * (k6 * u + sn[i] * k7 * v)
        mz += arm_y * sl[i] * force_x + arm_x * sm[i] * force_y
        mz += sn[i] * (basis @ coefficients["torque"]) * disc * radius
    va = np.linalg.norm(velocity)
    u, v, w = velocity / va
    q = 0.5 * density * 4 * arm_x * arm_y * va**2

    def moment(name, x, y):
        return np.array([x, x**2, x * y, x**3, x * y**2, x**2 * y]) @ coefficients[name]

    fx += q * np.sign(u) * (np.array([abs(u), u**2]) @ coefficients["airframe_fx"])
    fy += q * np.sign(v) * (np.array([abs(v), v**2]) @ coefficients["airframe_fy"])
    t0 = -q * np.sign(w) * (np.array([abs(w), w**2]) @ coefficients["airframe_fz"])
    mx += q * np.sign(v) * moment("airframe_mx", abs(v), w)
    my += q * np.sign(u) * moment("airframe_my", abs(u), w)
    mz += q * np.sign(u) * np.sign(v) * moment("airframe_mz", abs(v), abs(u))
    return np.array([fx, fy, -(thrusts + t0), mx, my, mz])


def states(count, seed=1):
    rng = np.random.default_rng(seed)
    return (
        rng.normal(0.0, 6.0, (count, 3)),
        rng.normal(0.0, 3.0, (count, 3)),
        rng.uniform(100.0, 1200.0, (count, 4)),
    )


def test_equals_the_published_equations():
    coefficients = yaml.safe_load(BEBOP.read_text())["simulation"]["rotor_local"]
    velocity, rates, speeds = states(500)
    expected = np.array([published(coefficients, *row) for row in zip(velocity, rates, speeds, strict=True)])
    wrench = RotorLocalModel.load("bebop2").wrench(velocity, rates, speeds)
    assert np.all(np.abs(wrench - expected) <= 1e-9 * np.abs(expected))


def test_coefficients_are_the_published_ones(shared_data):
    source = json.loads((shared_data / "bebop2_rotor_local.json").read_text())
    own = yaml.safe_load(BEBOP.read_text())["simulation"]["rotor_local"]
    renamed = {"thrust": "ct", "torque": "cq"}
    for name, value in own.items():
        assert value == source[renamed.get(name, name)], name


def test_hover_carries_the_weight_without_moment():
    for name in ("bebop2", "hdbeetle"):
        model = RotorLocalModel.load(name)
        wrench = model.wrench(np.zeros((1, 3)), np.zeros((1, 3)), np.full((1, 4), model.hover_rotor_speed))[0]
        weight = model.vehicle.mass_kg * model.vehicle.gravity_m_s2
        assert wrench == pytest.approx([0, 0, -weight, 0, 0, 0], abs=1e-12)


def test_rotors_at_rest_and_air_at_rest_give_finite_wrenches():
    model = RotorLocalModel.load("bebop2")
    velocity = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [0.0, 0.0, 5.0], [0.0, 0.0, -5.0]])
    for speed in (0.0, 1e-6, 700.0):
        assert np.all(np.isfinite(model.wrench(velocity, np.zeros((4, 3)), np.full((4, 4), speed))))
    assert np.all(model.wrench(velocity[:1], np.zeros((1, 3)), np.zeros((1, 4))) == 0.0)


def test_drag_of_the_rotors_is_the_catalogue_size():
    """0.11 N per m/s at hover speed, of the rotors alone: the airframe's force is small at 1 m/s."""
    model = RotorLocalModel.load("bebop2")
    slow = model.wrench(
        np.array([[1.0, 0.0, 0.0]]), np.zeros((1, 3)), np.full((1, 4), model.hover_rotor_speed)
    )
    assert slow[0, 0] == pytest.approx(-0.11, rel=0.1)
    assert slow[0, 4] == pytest.approx(0.0129, rel=0.3)


def test_left_right_mirror():
    model = RotorLocalModel.load("bebop2")
    velocity, rates, speeds = states(50)
    wrench = model.wrench(velocity, rates, speeds)
    mirrored = model.wrench(velocity * [1, -1, 1], rates * [-1, 1, -1], speeds[:, MIRRORED_ROTORS])
    np.testing.assert_allclose(mirrored, wrench * [1, -1, 1, -1, 1, -1], rtol=1e-12, atol=1e-12)


def test_order_of_rotors_in_the_vehicle_file_does_not_matter(tmp_path):
    order = [2, 0, 3, 1]
    data = yaml.safe_load(BEBOP.read_text())
    data["rotors"] = [data["rotors"][index] for index in order]
    (tmp_path / "reordered.yaml").write_text(yaml.safe_dump(data))
    velocity, rates, speeds = states(20)
    reordered = RotorLocalModel.load(tmp_path / "reordered.yaml").wrench(velocity, rates, speeds[:, order])
    expected = RotorLocalModel.load("bebop2").wrench(velocity, rates, speeds)
    np.testing.assert_allclose(reordered, expected, rtol=1e-12, atol=1e-14)


def test_scaled_vehicle_has_the_same_wrench_without_dimension():
    """Lengths halved at the same advance ratio and tip speed: ¼ of the force, ⅛ of the moment."""
    bebop = RotorLocalModel.load("bebop2")
    _, data = read_config("vehicle", "bebop2", VehicleError)
    small = bebop.vehicle.__class__(
        name="small",
        mass_kg=1.0,
        inertia=bebop.vehicle.inertia,
        rotor_radius_m=0.5 * bebop.vehicle.rotor_radius_m,
        rotor_positions=0.5 * bebop.vehicle.rotor_positions,
        rotor_spins=bebop.vehicle.rotor_spins,
        pole_pairs=1,
        gravity_m_s2=bebop.vehicle.gravity_m_s2,
    )
    scaled = RotorLocalModel(small, bebop.coefficients.scaled(bebop.vehicle, small))
    velocity, rates, speeds = states(50)
    wrench = scaled.wrench(velocity, 2.0 * rates, 2.0 * speeds)
    expected = bebop.wrench(velocity, rates, speeds) * np.repeat([0.25, 0.125], 3)
    np.testing.assert_allclose(wrench, expected, rtol=1e-11, atol=1e-14)
    assert data["simulation"]["rotor_local"]["rotor_force_along"] != scaled.coefficients.rotor_force_along


def test_wrong_shapes_and_values_are_refused():
    model = RotorLocalModel.load("bebop2")
    velocity, rates, speeds = states(3)
    with pytest.raises(SimulationError, match=r"rotor_speeds: expected shape \(3, 4\), found \(3, 3\)"):
        model.wrench(velocity, rates, speeds[:, :3])
    velocity[1, 1] = np.nan
    with pytest.raises(SimulationError, match="velocity_air: holds values that are not finite"):
        model.wrench(velocity, rates, speeds)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: s["rotor_local"].pop("torque"), r"simulation.rotor_local: missing key `torque`"),
        (
            lambda s: s["rotor_local"].update(thrust=[1.0]),
            r"simulation.rotor_local: `thrust` must hold 16 numbers",
        ),
        (
            lambda s: s["rotor_local"].update(thrusts=[1.0]),
            r"simulation.rotor_local: unknown key `thrusts`; .*did you mean `thrust`\?",
        ),
        (lambda s: s.pop("rotor_local"), r"cannot be simulated: `simulation.rotor_local` is missing"),
        (
            lambda s: s.update(rotor_local={"scaled_from": "bebop"}),
            r"bad.yaml: `simulation.rotor_local.scaled_from`: .*no such vehicle file.*did you mean `bebop2`",
        ),
        (
            lambda s: s.update(rotor_local={"scaled_from": "hdbeetle"}),
            r"hdbeetle.yaml: `simulation.rotor_local",
        ),
        (
            lambda s: s["rotor_local"].update(scaled_from="bebop2"),
            r"simulation.rotor_local: unknown key `\w+`; known: scaled_from",
        ),
        (
            lambda s: s.update(rotor_local={"scaled_from": 3}),
            r"simulation.rotor_local: `scaled_from` must be text, found 3",
        ),
        (
            lambda s: s.update(rotor_local=3),
            r"simulation: `rotor_local` must be coefficients, or `scaled_from`",
        ),
    ],
)
def test_bad_vehicle_files(tmp_path, change, message):
    data = yaml.safe_load(BEBOP.read_text())
    change(data["simulation"])
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(data))
    with pytest.raises(VehicleError, match=message):
        RotorLocalModel.load(tmp_path / "bad.yaml")
