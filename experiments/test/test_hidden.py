# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The hidden benchmark: changes are exact, right answers known to the library, splits fair, scoring right."""

from __future__ import annotations

import sys
from dataclasses import asdict, replace

import discovery_hidden
import numpy as np
import pytest
from blind.cases import PAIR
from hidden.cases import FLEETS, HALVES, Case, all_cases, short_cases
from hidden.changes import CHANGES, PAIRS, Given, drawn
from hidden.measures import AMONG, ERROR, MISSED, PART, REFUSED, RIGHT, UNKNOWN, WRONG, Finding, figures
from page_tables import replaced

from quadpi_core.estimator.fusion import fuse
from quadpi_core.flight import OdometryStream
from quadpi_core.frames import rotation_matrix
from quadpi_core.logs import read_recording
from quadpi_core.paths import bags_directory
from quadpi_core.screening.flight_runs import cut
from quadpi_core.simulation.applied_effects import EFFECTS
from quadpi_core.vehicle import Vehicle

VEHICLE = Vehicle.load("bebop2")
SEED = 5


@pytest.fixture(scope="module")
def was():
    """Six seconds of a bundled flight, with a fused state beside its poses, a battery and a gust."""
    whole = read_recording(bags_directory() / "train_1.mcap", VEHICLE, None)
    start_ns = int(whole.imu.time_ns[0])
    part = cut(whole, start_ns + 4 * 10**9, start_ns + 10 * 10**9)
    flight = fuse(part, VEHICLE, 30.0)
    at_ns = flight.start_ns + np.rint(1e9 * flight.time).astype(np.int64)
    state = OdometryStream(at_ns, flight.position, flight.attitude, flight.velocity, flight.rates)
    time = np.arange(0.0, 4.0, 0.01)
    gust = np.stack([np.sin(2.0 * np.pi * hz * time) for hz in (0.5, 1.0, 2.0)], axis=1)
    volts = np.linspace(12.0, 11.0, 50)
    given = Given(
        VEHICLE, flight, lambda: (np.linspace(at_ns[0], at_ns[-1], 50), volts), lambda: (time, gust)
    )
    return replace(part, odometry=state), given


def changed(was, name):
    recording, given = was
    how = drawn(name, 1.0, SEED)
    return CHANGES[name].recording(recording, how, given), how


def test_a_wind_moves_the_fused_velocity_and_nothing_else(was):
    recording, how = changed(was, "wind")
    before = was[1].flight
    after = fuse(replace(recording, odometry=None), VEHICLE, 30.0)
    turned = rotation_matrix(before.attitude)
    moved = np.einsum("nij,nj->ni", turned, after.velocity - before.velocity)
    late = before.time > 1.0
    np.testing.assert_allclose(moved[late], np.tile(how.level, (late.sum(), 1)), atol=0.02)
    assert np.linalg.norm(how.level) == pytest.approx(2.0)
    state, own = recording.odometry, was[0].odometry
    seen = np.einsum("nij,nj->ni", rotation_matrix(state.attitude), state.velocity - own.velocity)
    np.testing.assert_allclose(seen, np.tile(how.level, (len(own), 1)), atol=1e-9)
    np.testing.assert_allclose(after.specific_force[late], before.specific_force[late], atol=0.02)


def test_speeds_and_stamps_change_by_the_share_and_the_delay(was):
    own = was[0].rotor_speeds
    all_fast, how = changed(was, "fast rotors")
    np.testing.assert_allclose(all_fast.rotor_speeds.speeds, own.speeds * 1.05)
    one, how = changed(was, "fast rotor")
    scale = np.ones(4)
    scale[how.rotor - 1] = 1.052
    np.testing.assert_allclose(one.rotor_speeds.speeds, own.speeds * scale)
    late, _ = changed(was, "late rotors")
    assert np.all(late.rotor_speeds.time_ns - own.time_ns == 24_000_000)
    states, _ = changed(was, "late states")
    assert np.all(states.pose.time_ns - was[0].pose.time_ns == 30_000_000)
    assert np.all(states.odometry.time_ns - was[0].odometry.time_ns == 30_000_000)
    stopped, how = changed(was, "stopped rotor")
    differ = np.any(stopped.rotor_speeds.speeds != own.speeds, axis=0)
    assert differ.tolist() == [rotor == how.rotor for rotor in (1, 2, 3, 4)]
    held = np.diff(stopped.rotor_speeds.speeds[:, how.rotor - 1]) == 0.0
    assert held.mean() == pytest.approx(0.4, abs=0.02)
    battery, _ = changed(was, "battery")
    share = battery.rotor_speeds.speeds / own.speeds - 1.0
    assert np.ptp(share, axis=1).max() < 1e-12
    assert np.all(np.diff(share[:, 0]) < 1e-12)
    assert np.abs(share).max() == pytest.approx(0.05)


def test_sensors_turn_and_scale(was):
    turned, how = changed(was, "turned IMU")
    for name in ("specific_force", "angular_velocity"):
        before, after = (getattr(one.imu, name) for one in (was[0], turned))
        np.testing.assert_allclose(np.linalg.norm(after, axis=1), np.linalg.norm(before, axis=1))
        # To first order f × p, as docs/effects.md has it.
        first = np.cross(before, np.radians(4.0) * how.direction)
        error = np.linalg.norm(after - before - first, axis=1)
        assert np.all(error < 0.5 * np.radians(4.0) ** 2 * np.linalg.norm(before, axis=1) + 1e-9)
    low, _ = changed(was, "low accelerometer")
    np.testing.assert_allclose(low.imu.specific_force, was[0].imu.specific_force * 0.92)


def test_a_point_off_the_centre_is_fixed_in_the_body(was):
    off, _ = changed(was, "off centre")
    arm = np.linalg.norm(VEHICLE.rotor_positions[:, :2], axis=1).mean()
    for name in ("pose", "odometry"):
        before, after = getattr(was[0], name), getattr(off, name)
        moved = after.position - before.position
        seen = np.einsum("nij,ni->nj", rotation_matrix(before.attitude), moved)
        np.testing.assert_allclose(seen, np.tile(seen[0], (len(seen), 1)), atol=1e-9)
        assert np.linalg.norm(seen[0]) == pytest.approx(0.5 * arm)
    # The velocity of the state is that of the point.
    state = off.odometry
    world = np.einsum(
        "nij,nj->ni", rotation_matrix(state.attitude), state.velocity - was[0].odometry.velocity
    )
    slope = np.gradient(moved, 1e-9 * (state.time_ns - state.time_ns[0]), axis=0)
    assert np.abs(world - slope)[5:-5].max() < 0.1 * np.abs(world).max()


def test_a_gust_pushes_as_it_carries(was):
    pushed, _ = changed(was, "gust")
    at_ns, imu_ns = was[0].odometry.time_ns, was[0].imu.time_ns
    time = 1e-9 * (at_ns - at_ns[0])
    place = pushed.odometry.position - was[0].odometry.position
    attitude = rotation_matrix(was[0].odometry.attitude)
    velocity = np.einsum("nij,nj->ni", attitude, pushed.odometry.velocity - was[0].odometry.velocity)
    force = pushed.imu.specific_force - was[0].imu.specific_force
    rms = np.sqrt(np.square(force).sum(axis=1).mean())
    assert rms == pytest.approx(0.1 * VEHICLE.gravity_m_s2, rel=0.01)
    felt = np.stack([np.interp(at_ns, imu_ns, axis) for axis in force.T], axis=1)
    world = np.einsum("nij,nj->ni", attitude, felt)
    for value, slope in ((velocity, place), (world, velocity)):
        error = (value - np.gradient(slope, time, axis=0))[10:-10]
        assert np.sqrt(np.square(error).mean()) < 0.05 * np.sqrt(np.square(value).mean())


@pytest.mark.parametrize("name", ["light file", "nimble file", "wide file"])
def test_a_wrong_file_and_the_right_effect_are_the_vehicle(name):
    how = drawn(name, 1.0, SEED)
    file, truth = CHANGES[name].file(VEHICLE, how), CHANGES[name].truth(how, VEHICLE)
    if name == "wide file":
        np.testing.assert_allclose(file.rotor_positions[:, :2], 1.2 * VEHICLE.rotor_positions[:, :2])
        return
    effect = EFFECTS[truth.right[0][0]]
    values = np.array([truth.parameters[f"{effect.name}.{p.name}"] for p in effect.parameters])
    flown = effect.function(file, values)
    assert flown.mass_kg == pytest.approx(VEHICLE.mass_kg)
    np.testing.assert_allclose(flown.inertia, VEHICLE.inertia)


@pytest.mark.parametrize("case", {case.changes or case.fleet: case for case in all_cases()}.values(), ids=str)
def test_right_answers_are_in_the_library(case):
    truth = case.truth()
    assert truth.right or truth.unknown
    for name in (name for names in truth.right for name in names):
        assert EFFECTS[name].shown_by
    for key, value in truth.parameters.items():
        effect, name = key.split(".")
        assert effect in {name for names in truth.right for name in names}
        (parameter,) = (own for own in EFFECTS[effect].parameters if own.name == name)
        assert parameter.lowest <= value <= parameter.highest


def test_splits_are_fair():
    cases = all_cases()
    assert len({case.key for case in cases}) == len(cases)
    assert {case.key for case in short_cases()} <= {case.key for case in cases}
    vehicles = {half: set() for half in HALVES}
    for fleet in FLEETS.values():
        vehicles[fleet.half].add((fleet.others or fleet.logs).folder)
    # Flights of the load are split by their shapes; all of them together are the figure that is asked for.
    assert vehicles["tune"] & vehicles["report"] == {"imrc_payload"}
    for fleet in FLEETS.values():
        splits = [fleet.split(number) for number in range(5)]
        assert splits[0] == fleet.split(0)
        assert len({model for model, _ in splits}) > 1
        for model, searched in splits:
            assert len(model.names) == fleet.of_model
            assert len(searched.names) >= fleet.searched >= 2
            assert not set(model.paths) & set(searched.paths)
    for name in CHANGES:
        sizes = {case.size for case in cases if case.changes == (name,)}
        assert len(sizes) == 3
    assert set(PAIRS) <= {case.changes for case in cases}


def finding(verdict, *effects, ambiguous=(), name="fast rotors", seen=("Fz",), broken=(), parts=()):
    """Of a case with a change, or a pair; effects are pairs of a name and parameters."""
    names, kind = (name, PAIR) if isinstance(name, tuple) else ((name,), CHANGES[name].kind)
    case = Case("crazyflie", kind, names, 1.0, 0)
    result = {
        "verdict": verdict,
        "ambiguous": ambiguous,
        "effects": [
            {"name": n, "parameters": {p: {"value": v, "lower": v, "upper": v} for p, v in own.items()}}
            for n, own in effects
        ],
    }
    rest = {
        "left": None,
        "rollouts": None,
        "coverage": {},
        "seen": list(seen),
        "broken": [*seen, *broken],
        "parts": list(parts),
        "seconds": 1.0,
    }
    return Finding.of({"case": asdict(case), "result": result, **rest})


def test_outcomes():
    scale = ("rotor_speed_scale", {"rotor": 0, "change": 0.05})
    one = ("rotor_speed_scale", {"rotor": 2, "change": 0.05})
    thrust, load = ("thrust_coefficient", {"change": -0.09}), ("payload", {"mass_kg": 0.003})
    found = [
        (finding("effects", scale), RIGHT),
        (finding("effects", thrust), RIGHT),
        (finding("effects", load, ambiguous=[["payload", "thrust_coefficient"]]), AMONG),
        (finding("effects", load), WRONG),
        (finding("effects", one), WRONG),
        (finding("effects", scale, load), WRONG),
        (finding("none"), MISSED),
        (finding("unknown"), UNKNOWN),
        (finding("error: no flight"), ERROR),
        (finding("refused by its signals: the accelerometer reads 0.84 times"), REFUSED),
        (finding("unknown", name="gust"), RIGHT),
        (finding("effects", load, name="gust"), WRONG),
        (finding("none", name="gust"), MISSED),
        (finding("none", name="turned IMU", seen=()), RIGHT),
        (finding("unknown", name="turned IMU"), UNKNOWN),
        (finding("unknown", name="turned IMU", seen=(), broken=("Fx",)), RIGHT),
        (finding("effects", load, name="low accelerometer"), RIGHT),
        (finding("effects", scale, name=PAIRS[0], parts=(False, True)), PART),
        (finding("effects", scale, ("wind", {}), name=PAIRS[0], parts=(True, True)), RIGHT),
    ]
    findings = [one for one, _ in found]
    assert [one.outcome for one in findings] == [outcome for _, outcome in found]
    by_name = {own.name: (own.hits, own.of) for own in figures(findings)}
    assert by_name["one change, visible: right, or told among"] == (3, 9)
    assert by_name["pairs, visible: both right, or told among"] == (1, 2)
    assert by_name["… of which each change is visible by itself"] == (1, 1)
    assert by_name["an interval is broken: `none`"] == (2, 18)
    rows = discovery_hidden.changes_table(findings).splitlines()
    assert "| wind + fast rotors | 1 right, 1 in part | – | – |" in rows
    assert "| turned IMU | 1 unknown, (1 `none`, 1 `unknown`) | – | – |" in rows
    assert "| gust | 1 right, 1 wrong, 1 missed | – | – |" in rows
    failures = discovery_hidden.failures_table(findings)
    assert "| crazyflie | fast rotors × 1, split 0 | Fz | wrong: payload |" in failures
    assert failures.count("turned IMU") == 1
    assert f"{len(findings)} cases: 10 single" in discovery_hidden.summary(findings)


def test_the_program_lists_its_cases_and_says_where_flights_are_missing(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("QUADPI_DATA", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["discovery_hidden", "--short", "--list"])
    discovery_hidden.main()
    assert "crazyflie-wind-1-0" in capsys.readouterr().out.splitlines()
    sys.argv.remove("--list")
    with pytest.raises(SystemExit, match=f"no real flights in {tmp_path}/imrc_brushless: set QUADPI_DATA$"):
        discovery_hidden.main()


def test_the_page_has_a_place_for_each_table_and_says_what_is_hidden():
    page = discovery_hidden.PAGE.read_text(encoding="utf-8")
    assert page == replaced(page, "hidden", discovery_hidden.hidden_table())
    for name in ("summary", "figures", "changes", "flights", "failures"):
        assert "another" in replaced(page, name, "another")
