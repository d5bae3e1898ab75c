# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Scenario files: those of the project, what they mean, how they compose, and what is refused."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from quadpi_core.errors import SimulationError
from quadpi_core.paths import config_directory
from quadpi_core.simulation.flying import SimulatedVehicle
from quadpi_core.simulation.scenario import FlightPlan, Scenario, load_scenario
from quadpi_core.simulation.simulated_bags import require_reachable
from quadpi_core.simulation.truth import Motion, Signal

SHIPPED = sorted(file.stem for file in (config_directory() / "scenarios").glob("*.yaml"))
SINE = {"amplitude_m": 2.0, "frequency_hz": 0.3, "start_s": 1.0, "duration_s": 8.0}
STEP = {"amplitude_m": 1.0, "rise_s": 1.0, "start_s": 1.0}
Load = Callable[..., Scenario]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    """load(flight, files={name: content}, **scenario) → the scenario of a file with a flight `one`."""

    def write_and_load(
        flight: Any = None, *, files: dict[str, dict[str, Any]] | None = None, **scenario: Any
    ) -> Scenario:
        data: dict[str, Any] = {"description": "a test", "vehicle": "bebop2", "seed": 1, "duration_s": 10}
        if flight is not None:
            data["flights"] = {"one": flight}
        for name, content in {"main": data | scenario, **(files or {})}.items():
            (tmp_path / f"{name}.yaml").write_text(
                yaml.safe_dump({"description": "a test"} | content, sort_keys=False)
            )
        return load_scenario(tmp_path / "main.yaml")

    return write_and_load


class TestShipped:
    def test_these_are_there(self):
        assert {"bundled", "dash", "orbit", "paper", "training", "tunnel", "validation"} <= set(SHIPPED)

    @pytest.mark.parametrize("name", SHIPPED)
    def test_every_flight_is_reachable_and_begins_and_ends_at_rest(self, name: str):
        scenario = load_scenario(name)
        assert scenario.name == name
        for plan in scenario.flights:
            vehicle = SimulatedVehicle.load(plan.vehicle)
            reference = plan.reference(100.0)
            require_reachable(plan, vehicle, reference)
            specific_force = np.linalg.norm(
                reference.acceleration - [0.0, 0.0, vehicle.vehicle.gravity_m_s2], axis=1
            )
            assert specific_force.max() < 2.0 * vehicle.vehicle.gravity_m_s2
            for instant in (0, -1):
                for rest in (reference.velocity, reference.acceleration, reference.tilt):
                    np.testing.assert_allclose(rest[instant], 0.0, atol=1e-9)
                for rest in (reference.yaw_rate, reference.thrust):
                    assert rest[instant] == pytest.approx(0.0, abs=1e-9)
            assert reference.yaw[0] == 0.0

    def test_training_moves_every_axis_alone_and_together(self):
        moved = {plan.name: set(plan.motion) for plan in load_scenario("training").flights}
        for axis in ("x", "y", "height", "yaw"):
            assert sum(axes == {axis} for axes in moved.values()) >= 2
        assert {"x", "y", "height", "yaw"} in moved.values()

    def test_validation_is_coupled_only_and_differs_from_training(self):
        def coupling(motion: Motion) -> dict[str, set[type[Signal]]]:
            return {axis: {type(signal) for signal in signals} for axis, signals in motion.items()}

        known = [plan.motion for plan in load_scenario("training").flights]
        for plan in load_scenario("validation").flights:
            assert len(plan.motion) >= 2
            signals = {axis: set(signals) for axis, signals in plan.motion.items()}
            for other in known:
                assert coupling(plan.motion) != coupling(other)
                assert not any(signals[axis] & set(other.get(axis, ())) for axis in signals)

    def test_paper_is_training_then_validation(self):
        both = load_scenario("training").flights + load_scenario("validation").flights
        assert load_scenario("paper").flights == both

    def test_speeds(self):
        def greatest_speed(name: str) -> dict[str, float]:
            return {
                plan.name: float(np.linalg.norm(plan.reference(100.0).velocity, axis=1).max())
                for plan in load_scenario(name).flights
            }

        assert greatest_speed("dash")["dash"] == pytest.approx(14.0, abs=0.2)
        assert max(greatest_speed("orbit").values()) == pytest.approx(5.0, abs=0.01)
        bundled = greatest_speed("bundled")
        fastest_training = max(speed for name, speed in bundled.items() if name.startswith("train"))
        assert bundled["interpolation"] < fastest_training < 6.5
        assert 11.0 < bundled["extrapolation"] < 13.0
        calm = next(plan for plan in load_scenario("bundled").flights if plan.name == "extrapolation")
        early = calm.reference(100.0).velocity[:800]
        assert np.linalg.norm(early, axis=1).max() < fastest_training

    def test_tunnel_winds_are_those_of_the_names(self):
        flights = {plan.name: plan for plan in load_scenario("tunnel").flights}
        assert len(flights) == 15
        for name, plan in flights.items():
            kind, wind = name.split("_")
            assert kind in {"steady", "throttle", "pitch"}
            assert plan.vehicle == "hdbeetle"
            np.testing.assert_array_equal(plan.known_wind, [-float(wind), 0.0, 0.0])


class TestMeaning:
    def test_axes_units_and_signs(self, load: Load):
        step = {"rise_s": 1, "start_s": 1}
        motion = {
            "x": [{"step": step | {"amplitude_m": 1}}],
            "y": [{"step": step | {"amplitude_m": 2}}],
            "height": [{"step": step | {"amplitude_m": 3}}],
            "yaw": [{"step": step | {"amplitude_deg": 90}}],
            "roll": [{"step": step | {"amplitude_deg": 10}}],
            "pitch": [{"step": step | {"amplitude_deg": 20}}],
            "thrust": [{"step": step | {"amplitude_share": 0.2}}],
        }
        plan = load({"height_m": 4, "motion": motion}).flights[0]
        reference = plan.reference(50.0)
        assert len(reference) == 501
        np.testing.assert_allclose(reference.position[0], [0.0, 0.0, -4.0])
        np.testing.assert_allclose(reference.position[-1], [1.0, 2.0, -7.0])
        assert reference.yaw[-1] == pytest.approx(np.pi / 2.0)
        np.testing.assert_allclose(reference.tilt[-1], np.radians([10.0, 20.0]))
        assert reference.thrust[-1] == pytest.approx(0.2)

    def test_signals_of_an_axis_add_up(self, load: Load):
        one = {"sine": SINE}
        two = {"pulse": {"amplitude_m": 0.5, "width_s": 1.0, "rise_s": 0.5, "start_s": 3.0}}
        both, first, second = (
            load({"motion": {"x": signals}}).flights[0].reference(100.0)
            for signals in ([one, two], [one], [two])
        )
        for column in ("position", "velocity", "acceleration"):
            total = getattr(first, column)[:, 0] + getattr(second, column)[:, 0]
            np.testing.assert_allclose(getattr(both, column)[:, 0], total, atol=1e-12)

    def test_an_orbit_with_a_climb_and_turns_of_the_nose(self, load: Load):
        orbit = {"radius_m": 2, "speed_m_s": 2, "start_s": 1, "nose": "ahead"}
        turn = {"step": {"amplitude_deg": 30, "rise_s": 1, "start_s": 4}}
        climb = {"step": {"amplitude_m": 1, "rise_s": 1, "start_s": 4}}
        plain, moved = (
            load({"orbit": orbit, "motion": motion}).flights[0].reference(100.0)
            for motion in ({}, {"yaw": [turn], "height": [climb]})
        )
        np.testing.assert_array_equal(moved.position[:, :2], plain.position[:, :2])
        np.testing.assert_allclose(moved.yaw[-1] - plain.yaw[-1], np.radians(30.0))
        assert moved.position[-1, 2] == pytest.approx(-4.0)

    def test_without_a_duration_a_signal_lasts_to_the_end(self, load: Load):
        sine = {key: value for key, value in SINE.items() if key != "duration_s"}
        plan = load({"motion": {"x": [{"sine": sine}]}}).flights[0]
        assert plan.motion["x"][0].end == pytest.approx(10.0)

    def test_a_flight_overrides_what_its_file_sets_for_all(self, load: Load):
        assert load({}, height_m=2.0).flights[0].height_m == 2.0
        plan = load({"height_m": 5, "vehicle": "hdbeetle", "seed": 77}, height_m=2.0).flights[0]
        assert (plan.height_m, plan.vehicle, plan.seed) == (5.0, "hdbeetle", 77)

    def test_wind_is_known_only_where_it_is_given(self, load: Load):
        assert load({}).flights[0].known_wind is None
        np.testing.assert_array_equal(load({"head_wind_m_s": 0}).flights[0].known_wind, 0.0)
        np.testing.assert_array_equal(load({"head_wind_m_s": 8}).flights[0].known_wind, [-8.0, 0.0, 0.0])

    def test_seeds_come_from_the_file_and_the_name_alone(self, load: Load):
        alone = load({}).flights[0]
        assert alone.seed == zlib.crc32(b"1 one")
        among = load({}, flights={"zero": {}, "one": {}}).flights
        assert among[1].seed == alone.seed != among[0].seed
        assert load({}, seed=2).flights[0].seed != alone.seed

    def test_seeds_of_a_shipped_scenario_all_differ(self):
        for name in SHIPPED:
            flights = load_scenario(name).flights
            assert len({plan.seed for plan in flights}) == len(flights)

    @pytest.mark.parametrize("name", SHIPPED)
    def test_a_plan_survives_json(self, name: str):
        for plan in load_scenario(name).flights:
            again = FlightPlan.from_dict(json.loads(json.dumps(plan.as_dict(), allow_nan=False)), "json")
            assert again == plan

    def test_overridden(self):
        plan = load_scenario("bundled").flights[-1]
        other = plan.overridden(seed=9, effects={"payload": None}, noise="mpu6000")
        assert other.seed == 9
        assert list(other.effects) == ["payload"]
        assert replace(other, seed=plan.seed, effects={}, noise=plan.noise) == plan
        with pytest.raises(SimulationError, match=r"flight faults: unknown key `sead`.* did you mean `seed`"):
            plan.overridden(sead=1)


class TestComposition:
    def test_included_flights_come_first_and_stay_the_same(self, load: Load, tmp_path: Path):
        files = {"other": {"vehicle": "hdbeetle", "seed": 5, "duration_s": 3, "flights": {"two": None}}}
        included, own = load({}, include=["other.yaml"], files=files).flights
        assert (included.name, own.name) == ("two", "one")
        assert included == load_scenario(tmp_path / "other.yaml").flights[0]
        assert (included.scenario, included.vehicle, included.duration_s) == ("other", "hdbeetle", 3.0)

    def test_a_scenario_of_the_project_is_included_by_name(self, load: Load):
        assert load(include=["dash"]).flights == load_scenario("dash").flights

    def test_effects_hold_for_included_flights_and_yield_to_their_own(self, load: Load):
        own = {"payload": {"mass_kg": 0.02}}
        files = {
            "other": {"vehicle": "bebop2", "seed": 5, "duration_s": 3, "effects": own, "flights": {"two": {}}}
        }
        included, flight = load(
            {"effects": {"weak_rotor": None}},
            include=["other.yaml"],
            files=files,
            effects={"payload": {"mass_kg": 0.05}, "body_drag": None},
        ).flights
        assert included.effects["payload"]["mass_kg"] == 0.02
        assert set(included.effects) == {"payload", "body_drag"}
        assert flight.effects["payload"]["mass_kg"] == 0.05
        assert set(flight.effects) == {"payload", "body_drag", "weak_rotor"}

    def test_own_files_are_found_beside_the_scenario(self, load: Load, tmp_path: Path):
        (tmp_path / "mine.yaml").write_text((config_directory() / "vehicles" / "bebop2.yaml").read_text())
        plan = load({}, vehicle="mine.yaml").flights[0]
        assert SimulatedVehicle.load(plan.vehicle).vehicle.name == "mine"

    def test_a_circle_of_files_is_refused(self, load: Load):
        files = {"other": {"include": ["main.yaml"]}}
        with pytest.raises(SimulationError, match=r"main\.yaml includes .*other\.yaml includes .*main\.yaml"):
            load({}, include=["other.yaml"], files=files)

    def test_flights_of_one_name_are_refused(self, load: Load):
        files = {"other": {"vehicle": "bebop2", "seed": 5, "duration_s": 3, "flights": {"one": {}}}}
        with pytest.raises(
            SimulationError, match=r"main\.yaml: two flights are named `one`: of other and of main"
        ):
            load({}, include=["other.yaml"], files=files)

    def test_a_duplicate_name_in_a_file_is_refused(self, tmp_path: Path):
        path = tmp_path / "twice.yaml"
        path.write_text("description: a test\nflights:\n  one: {}\n  one: {}\n")
        with pytest.raises(SimulationError, match=r"twice\.yaml: .*duplicate key `one`.* line 4"):
            load_scenario(path)


def pulse(**changes: Any) -> dict[str, Any]:
    return {
        "motion": {"x": [{"pulse": {"amplitude_m": 1, "width_s": 2, "rise_s": 1, "start_s": 1} | changes}]}
    }


def sine(**changes: Any) -> dict[str, Any]:
    return {"motion": {"x": [{"sine": SINE | changes}]}}


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        ({"hight_m": 3}, "unknown key `hight_m`; known: "),
        ({"name": "two"}, "unknown key `name`"),
        ({"duration_s": 0}, "`duration_s` must be a number from 0.1 to 3600, found 0"),
        ({"duration_s": "long"}, "`duration_s` must be a number"),
        ({"seed": 1.5}, "`seed` must be a whole number"),
        ({"seed": -1}, "`seed` must be a whole number"),
        ({"head_wind_m_s": float("inf")}, "`head_wind_m_s` must be a number"),
        ({"truth_rate_hz": 0}, "`truth_rate_hz` must be a whole number from 1 to 500, found 0"),
        ({"truth_rate_hz": 150}, "`truth_rate_hz` must divide 500, found 150"),
        ({"effects": {"paylod": None}}, "unknown effect `paylod`; did you mean `payload`?"),
        ({"faults": [{"kind": "droput"}]}, "did you mean `dropout`?"),
        ({"motion": {"z": []}}, "motion: unknown key `z`"),
        ({"motion": {"x": {"sine": SINE}}}, "motion: `x` must be a list, found {'sine'"),
        ({"motion": {"x": [{"sin": SINE}]}}, "motion.x, entry 1: unknown key `sin`; known: "),
        ({"motion": {"x": [{"sine": SINE, "step": STEP}]}}, "motion.x, entry 1: expected one of sine, pulse"),
        ({"motion": {"x": [{}]}}, "motion.x, entry 1: expected one of sine, pulse"),
        ({"motion": {"x": [{"sine": SINE}, {"sine": None}]}}, "motion.x, entry 2: expected one of sine"),
        (
            sine(amplitude_deg=1),
            "motion.x, entry 1: sine: unknown key `amplitude_deg`; the amplitude is `amplitude_m`",
        ),
        (sine(frequency=1), "did you mean `frequency_hz`?"),
        (sine(duration_s=-2), "sine: `duration_s` must be a positive number, found -2"),
        (sine(frequency_hz=0), "sine: `frequency_hz` must be a positive number, found 0"),
        (sine(amplitude_m="2"), "sine: `amplitude_m` must be a number, found '2'"),
        (sine(duration_s=9.5), "motion.x, entry 1: ends at 10.5 s, after the flight, which lasts 10 s"),
        (pulse(count=4, period_s=3), "motion.x, entry 1: ends at 13 s, after the flight"),
        (pulse(count=2.0), "pulse: `count` must be a positive whole number"),
        (pulse(alternate=1), "pulse: `alternate` must be true or false, found 1"),
        (
            {"motion": {"x": [{"multisine": {"amplitude_m": 1, "frequencies_hz": 2, "start_s": 1}}]}},
            "multisine: `frequencies_hz` must be a list of positive numbers, found 2",
        ),
        ({"motion": {"x": [{"step": {"amplitude_m": 1, "rise_s": 1}}]}}, "step: missing key `start_s`"),
        ({"motion": {"x": [{"sine": {"amplitude_m": 1, "frequency_hz": 1}}]}}, "sine: missing key `start_s`"),
        (
            {"orbit": {"radius_m": 2, "speed_m_s": 2, "start_s": 1, "nose": "up"}},
            "orbit: `nose` must be one of north, centre, ahead, found 'up'",
        ),
        ({"orbit": {"radius_m": 2, "start_s": 1}}, "orbit: missing key `speed_m_s`"),
        (
            {"orbit": {"radius_m": 2, "speed_m_s": 2, "start_s": 1}} | sine(),
            "`orbit` and motion along x exclude each other",
        ),
        ({"height_m": 0}, "at 0.00 s its height is 0.00 m"),
        (
            {"motion": {"height": [{"step": {"amplitude_m": -3.5, "rise_s": 1, "start_s": 4}}]}},
            "comes down to the ground: at 5.00 s its height is -0.50 m",
        ),
    ],
)
def test_impossible_flights_are_refused(load: Load, flight: dict[str, Any], message: str):
    with pytest.raises(SimulationError) as caught:
        load(flight)
    assert "main.yaml: flight `one`: " in str(caught.value)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        ({"flites": {}}, "did you mean `flights`?"),
        ({"description": None}, "missing key `description`"),
        ({"flights": ["one"]}, "`flights` must be flights by name, found ['one']"),
        ({"flights": {}}, "holds no flights"),
        ({"flights": {"../one": {}}}, "a flight's name has letters, digits, _ and - only"),
        ({"flights": {"one": 3}}, "flight `one`: expected keys and values, found 3"),
        ({"include": "training"}, "`include` must be a list of names or paths, found 'training'"),
        ({"include": ["trainin"]}, "no such scenario file; known scenarios: bundled, "),
        ({"effects": {"gusts": None}}, "unknown effect `gusts`; did you mean `gust`?"),
        ({"seed": None, "flights": {"one": {}}}, "missing key `seed`"),
        ({"vehicle": None, "flights": {"one": {}}}, "flight `one`: missing key `vehicle`"),
    ],
)
def test_impossible_scenarios_are_refused(load: Load, scenario: dict[str, Any], message: str):
    with pytest.raises(SimulationError) as caught:
        load(**scenario)
    assert message in str(caught.value)


def test_an_unknown_scenario_is_refused_with_the_nearest():
    with pytest.raises(SimulationError, match=r"no such scenario file.*did you mean `training`"):
        load_scenario("trainin")


@pytest.mark.parametrize(
    ("flight", "message"),
    [
        (
            sine(amplitude_m=1.0, frequency_hz=1.0),
            r"at \d+\.\d\d s it demands \d+\.\d m/s² of specific force, and bebop2 has 29\.3",
        ),
        (
            {"motion": {"x": [{"step": {"amplitude_m": 100, "rise_s": 9, "start_s": 0.5}}]}},
            r"at 5\.00 s it demands 20\.8 m/s of airspeed, and bebop2 has 16\.0",
        ),
        (
            sine(amplitude_m=1.9, frequency_hz=0.25, fade_s=3) | {"head_wind_m_s": 14},
            r"demands 17\.\d m/s of airspeed, and bebop2 has 16\.0",
        ),
        (
            {"motion": {"roll": [{"step": {"amplitude_deg": 80, "rise_s": 1, "start_s": 1}}]}},
            r"80\.0 degrees of tilt, and bebop2 has 75\.0",
        ),
        (
            {"motion": {"x": [{"step": {"amplitude_m": 10, "rise_s": 1.6, "start_s": 1}}]}},
            r"degrees of tilt along the path, and bebop2 has 65\.0",
        ),
        (
            {"motion": {"yaw": [{"step": {"amplitude_deg": 360, "rise_s": 1, "start_s": 1}}]}},
            r"at 1\.50 s it demands 675\.0 degrees/s of yaw rate, and bebop2 has 360\.0",
        ),
        (
            {"motion": {"thrust": [{"step": {"amplitude_share": 3, "rise_s": 1, "start_s": 1}}]}},
            r"39\.2 m/s² of specific force, and bebop2 has 29\.3",
        ),
        (
            {"motion": {"thrust": [{"step": {"amplitude_share": -3, "rise_s": 1, "start_s": 1}}]}},
            r"19\.6 m/s² of specific force downward, and bebop2 has 0\.0",
        ),
    ],
)
def test_unreachable_references_are_refused(load: Load, flight: dict[str, Any], message: str):
    plan = load(flight).flights[0]
    with pytest.raises(SimulationError, match=rf"flight one: unreachable reference: .*{message}"):
        require_reachable(plan, SimulatedVehicle.load("bebop2"), plan.reference(1000.0))
