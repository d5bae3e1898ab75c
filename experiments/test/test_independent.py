# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The independent benchmark: RotorPy's flights, physical laws of its own, and right scoring."""

from __future__ import annotations

import ast
import json
import sys

import numpy as np
import pytest
from blind.cases import NULL, OUT, SINGLE, Hidden

pytest.importorskip("rotorpy")

import discovery_independent
from independent import cases, flying, measures, recording
from independent.airframes import GRAVITY_M_S2, HERE, Blades, airframes
from independent.cases import IndependentCase, NotFlownError, benchmark_cases
from independent.hidden_effects import EFFECTS, OUTSIDE, Flown, ordinary
from independent.hidden_physics import LAWS, Moment
from independent.nominal import nominal_wrench
from independent.searching import Task, searched

from quadpi_core.simulation.applied_effects import EFFECTS as LIBRARY
from quadpi_core.vehicle import Vehicle


@pytest.fixture(scope="module", params=[0, 1], ids=["hummingbird", "crazyflie"])
def airframe(request):
    return airframes()[request.param]


@pytest.fixture
def moment(airframe):
    """moment(velocity, rates=…, height=…) → one evaluation at the rotor speeds of hover, level."""

    def of(velocity=(0.0, 0.0, 0.0), *, rates=(0.0, 0.0, 0.0), height=5.0, spin_ups=(0.0,) * 4):
        speeds = np.full(4, airframe.hover_rad_s)
        return Moment(
            airframe=airframe,
            blades=Blades.of(airframe),
            rotors=airframe.rotors,
            thrust_n=airframe.parameters["k_eta"] * speeds**2,
            time_s=0.0,
            position=np.array([0.0, 0.0, height]),
            rotation=np.eye(3),
            velocity=np.array(velocity, dtype=float),
            airspeed=np.array(velocity, dtype=float),
            rates=np.array(rates, dtype=float),
            speeds=speeds,
            spin_ups=np.array(spin_ups),
        )

    return of


def test_effects_have_names_that_the_library_looks_for():
    assert all(LIBRARY[name].shown_by for name in EFFECTS)
    assert not any(LIBRARY[name].shown_by for name in set(OUTSIDE) & set(LIBRARY))
    assert len(EFFECTS) >= 20
    assert len(OUTSIDE) >= 6


def test_laws_and_flights_owe_the_library_nothing():
    for name in cases._SOURCES:
        for node in ast.walk(ast.parse((HERE / f"{name}.py").read_text())):
            modules = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            modules += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            # What a function is given is a flight of quadpi, with its own idea of the airspeed.
            assert not [m for m in modules if m.startswith("quadpi") and m != "quadpi_core.inputs"], name


def test_seeds_kept_aside_are_no_others():
    seeds = (*cases.DEVELOPMENT, *cases.OPENED, *cases.RESERVED)
    assert len(set(seeds)) == len(seeds)
    assert len(cases.DEVELOPMENT) == len(cases.RESERVED) >= 3
    keys = [case.key for case in benchmark_cases(seeds)]
    assert len(set(keys)) == len(keys)
    for case in benchmark_cases():
        assert "wind" not in case.seal


def test_every_kind_on_both_vehicles():
    hidden = [(case.hidden.kind, case.airframe.name) for case in benchmark_cases()]
    for kind in (NULL, SINGLE, OUT):
        counts = [hidden.count((kind, airframe.name)) for airframe in airframes()]
        assert max(counts) <= 1.5 * min(counts)


def test_vehicle_files_are_those_of_rotorpy(airframe):
    assert airframe.file.read_text() == recording.describe(airframe)
    vehicle = Vehicle.load(airframe.file)
    assert vehicle.mass_kg == airframe.mass_kg
    np.testing.assert_allclose(vehicle.rotor_positions[:, 1], -airframe.rotors[:, 1], atol=1e-5)
    assert vehicle.rotor_spins.tolist() == airframe.parameters["rotor_directions"].tolist()


def test_the_simulation_is_rotorpys_model(airframe):
    from rotorpy.vehicles.multirotor import Multirotor

    vehicle, rng = Multirotor(airframe.parameters), np.random.default_rng(1)
    airspeed, rates = 3.0 * rng.standard_normal((5, 3)), 2.0 * rng.standard_normal((5, 3))
    speeds = airframe.hover_rad_s * rng.uniform(0.8, 1.2, (5, 4))
    found = nominal_wrench(airframe, airspeed, rates, speeds)
    for k in range(5):
        force, about = vehicle.compute_body_wrench(rates[k], speeds[k], airspeed[k])
        np.testing.assert_allclose(found[k], np.append(force, about), rtol=1e-9, atol=1e-12)


def test_steps_are_those_of_rotorpys_solver(airframe):
    flown = Flown(airframe, airframe.parameters)
    state = {
        "x": np.array([0.0, 0.0, 2.0]),
        "v": np.array([1.0, -0.5, 0.3]),
        "q": np.array([0.05, -0.02, 0.1, 0.99]) / np.linalg.norm([0.05, -0.02, 0.1, 0.99]),
        "w": np.array([0.5, -1.0, 0.3]),
        "wind": np.zeros(3),
        "rotor_speeds": airframe.hover_rad_s * np.array([1.0, 1.1, 0.9, 1.05]),
    }
    command = np.full(4, airframe.hover_rad_s)
    exact = {"method": "RK45", "rtol": 1e-9, "atol": 1e-12}
    vehicle = flying._multirotor()(airframe.parameters, initial_state=state, integrator_kwargs=exact)
    vehicle.hide(flown, {})
    _, ours = vehicle.advanced(state, command, 1.0 / flying.RATE_HZ)
    theirs = vehicle.step(state, {"cmd_motor_speeds": command}, 1.0 / flying.RATE_HZ)
    for name, tolerance in (("x", 1e-7), ("v", 1e-4), ("q", 1e-5), ("w", 1e-3), ("rotor_speeds", 0.05)):
        np.testing.assert_allclose(ours[name], theirs[name], atol=tolerance)


def test_what_brakes_brakes(moment):
    rng = np.random.default_rng(2)
    for velocity in rng.normal(0.0, 3.0, (20, 3)):
        for name, parameters in {"rotor_drag": (0.03,), "body_drag": (0.01, 0.01, 0.01)}.items():
            force, _ = LAWS[name](moment(velocity), *parameters)
            assert force @ velocity < 0.0, name
        rates = rng.normal(0.0, 2.0, 3)
        assert LAWS["rate_damping"](moment(rates=rates), 1.0, 1.0, 1.0)[1] @ rates < 0.0
        _, turned = LAWS["gyroscopic"](moment(rates=rates), 1e-5)
        assert turned @ rates == pytest.approx(0.0, abs=1e-12)


def test_thrust_in_airflow(moment, airframe):
    def lift(name, *parameters, **state):
        return LAWS[name](moment(**state), *parameters)[0][2] / airframe.weight_n

    fast = airframe.speed_m_s
    assert lift("translational_lift", 0.6, velocity=(0.5 * fast, 0, 0)) > 0.0
    assert lift("translational_lift", 0.6, velocity=(fast, 0, 0)) < 0.3
    climb = lift("inflow_damping", 0.07 * airframe.weight_n, velocity=(0, 0, 0.2))
    assert climb == pytest.approx(-0.07 * 0.2, rel=0.1)
    assert lift("inflow_damping", 0.07 * airframe.weight_n, velocity=(0, 0, -0.2)) > 0.0
    assert lift("vortex_ring", 1.0, velocity=(0, 0, 2.0)) == 0.0
    assert -0.3 < lift("vortex_ring", 1.0, velocity=(0, 0, -airframe.hover_inflow_m_s)) < -0.02
    near = [lift("ground_effect", 1.0, height=ratio * airframe.radius_m) for ratio in (1.0, 2.0, 8.0)]
    assert near[0] == pytest.approx(0.09, abs=0.02)
    assert near[0] > 2.0 * near[1] > 4.0 * near[2] > 0.0


def test_moments_turn_the_right_way(moment):
    forward = (3.0, 0.0, 0.0)
    # Forward-left-up: the nose rises with a negative moment about y.
    assert LAWS["blade_flapping"](moment(forward), 1e-3)[1][1] < 0.0
    force, about = LAWS["rotor_interaction"](moment(forward), 0.15)
    assert force[2] < 0.0
    assert about[1] < 0.0
    # The first rotor turns clockwise; speeding up it pushes the body counterclockwise, which is positive
    # here.
    assert LAWS["spin_up"](moment(spin_ups=(100.0, 0, 0, 0)), 1e-5)[1][2] == pytest.approx(1e-3)


def test_a_flight_follows_its_path_and_its_accelerations_its_rates(airframe):
    rng = np.random.default_rng(3)
    path = flying.paths(airframe, rng)[-1]
    truth = flying.fly(ordinary(airframe, rng), path, rng)
    assert np.abs(truth.position - path.sampled(truth.time)[0]).max() < 0.5
    slope = np.gradient(truth.rates, truth.time, axis=0)[50:-50]
    assert np.abs(slope - truth.turning[50:-50]).max() < 0.1 * np.abs(slope).max()
    assert np.mean(truth.acceleration[:, 2]) == pytest.approx(GRAVITY_M_S2, abs=0.5)


def test_a_table_tells_nothing_but_numbers(airframe):
    rng = np.random.default_rng(4)
    path = flying.paths(airframe, rng)[0]
    table = recording.table(
        Flown(airframe, airframe.parameters), flying.fly(Flown(airframe, airframe.parameters), path, rng), rng
    )
    assert {str(kind) for kind in table.schema.types} == {"double"}
    assert len(table) == flying.DURATION_S * flying.RATE_HZ


def test_a_case_that_rotorpy_cannot_fly_is_left_out_and_said(tmp_path, monkeypatch):
    def fails(*_):
        raise RuntimeError(reason)

    reason = "RotorPy loses its path after 1.00 s of turns"
    monkeypatch.setattr(flying, "fly", fails)
    case = cases.short_cases()[0]
    with pytest.raises(NotFlownError, match="of turns"):
        case.logs(tmp_path)
    assert not list(tmp_path.rglob("*.parquet"))
    task = Task(case, tmp_path, "mocap")
    assert searched(None, task) == []
    assert discovery_independent.not_searched([task], [[]]) == ["nothing × 0 of seed 5000"]
    assert discovery_independent.not_searched([task], [[{}]]) == []
    reason = "something else"
    with pytest.raises(RuntimeError, match="something else"):
        searched(None, task)


def found(hidden, verdict, effects, truth):
    named = [
        {"name": name, "probability": 0.99, "parameters": {"p": {"lower": low, "upper": high}}}
        for name, low, high in effects
    ]
    return measures.Finding.of(
        {
            "seal": hidden.sealed(),
            "vehicle": "one",
            "mapping": "mocap",
            "mode": "recorded",
            "each_coefficient": False,
            "truth": truth,
            "seconds": 1.0,
            "left": None,
            "rollouts": None,
            "result": {"verdict": verdict, "effects": named, "ambiguous": []},
        }
    )


def test_scoring():
    payload = Hidden(SINGLE, ("payload",), 1.0, 1)
    findings = [
        found(payload, "effects", [("payload", 1.0, 2.0)], {"payload.p": 1.5}),
        found(payload, "effects", [("payload", 1.0, 2.0)], {"payload.p": 2.5}),
        found(payload, "effects", [("inertia", 1.0, 2.0)], {"payload.p": 1.5}),
        found(Hidden(SINGLE, ("wind",), 1.0, 1), "unknown", [], {}),
        found(Hidden(NULL, (), 0.0, 1), "none", [], {}),
        found(Hidden(OUT, ("wall",), 1.0, 1), "unknown", [], {}),
    ]
    shares = {figure.name: (figure.hits, figure.of) for figure in measures.figures(findings)}
    assert shares["full size: named"] == (2, 4)
    assert shares["any size: `unknown`"] == (1, 4)
    assert shares["any size: wrong name"] == (1, 4)
    assert shares["parameters inside their interval of 95 %"] == (1, 2)
    assert shares["nulls: false alarms"] == (0, 1)
    assert shares["outside the library: `unknown`"] == (1, 1)
    assert shares["named with 90% or more: hidden"] == (2, 3)


@pytest.mark.slow
def test_a_few_cases_from_flights_to_figures(tmp_path, monkeypatch, capsys):
    out, store = tmp_path / "found.json", tmp_path / "store"
    arguments = ["--short", "--mappings", "mocap", "--workers", "1", "--out", str(out), "--store", str(store)]
    monkeypatch.setattr(sys, "argv", ["discovery_independent", *arguments, "--work", str(tmp_path / "work")])
    monkeypatch.setattr(discovery_independent, "fingerprint", lambda: "kept")
    discovery_independent.main()
    results = json.loads(out.read_text())["cases"]
    assert {case["mode"] for case in results} == {"recorded", "function"}
    for case in results:
        wanted = "effects" if case["hidden"] else "none"
        assert case["result"]["verdict"] == wanted, (case["hidden"], case["result"])
        if case["hidden"]:
            # On flights that were not searched, either kind of simulation flies much better with the effect.
            assert case["left"] < 0.1
            before, after = case["rollouts"]["attitude_deg"]
            assert after < 0.1 * before
    assert "nulls: false alarms" in capsys.readouterr().out
    # Flights and searches are kept: a second run has nothing to do, and one of other code flies nothing.
    assert len(list(store.iterdir())) == 3
    assert IndependentCase(discovery_independent.short_cases()[0].seal).logs(store)
    discovery_independent.main()
    assert "2 cases, 0 to search" in capsys.readouterr().out
