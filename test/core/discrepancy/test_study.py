# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Verdicts of a study: none, effects, unknown, and effects that look alike."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from quadpi_core.discrepancy.acceptance import ALLOWED, CLOSES_NOTHING, HOLDS_MORE, Verdict
from quadpi_core.discrepancy.augmented_simulation import AugmentedSimulation, augmented
from quadpi_core.discrepancy.closure import Closing
from quadpi_core.discrepancy.discrepancy_result import (
    BeforeAfter,
    ClosedLoops,
    Coverage,
    Reflights,
    Rollouts,
    discovery_json,
)
from quadpi_core.discrepancy.loading import load_simulation
from quadpi_core.discrepancy.result_verdicts import judge_closed
from quadpi_core.discrepancy.simulations import Margins
from quadpi_core.discrepancy.study import _spoiling, discover, found_and_flown, likely_cause, study
from quadpi_core.discrepancy.unexplained import Inside
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES
from quadpi_core.frames import rotate_world_to_body
from quadpi_core.simulation.applied_effects import effect_wrench

from ..conftest import DRAG, SOUGHT
from .regressions import of_sound_flights

ALIKE = ("payload", "thrust_coefficient", "body_drag")


def sure_within(margins):
    """A model of these intervals alone."""
    return SimpleNamespace(margins=margins, goes_with_air=True)


@pytest.fixture(scope="module")
def sought(simulation, dragged):
    """What the first search finds, before its roll-outs."""
    return discover(simulation, dragged, names=SOUGHT)


def test_nothing_is_missing_in_flights_of_the_simulation(simulation, flights):
    found = discover(simulation, flights)
    assert (found.verdict, found.effects, found.unexplained) == ("none", (), 0.0)
    assert np.array_equal(found.gap.after, found.gap.before)


@pytest.mark.slow
def test_what_is_missing_is_named_among_all(simulation, dragged):
    found = discover(simulation, dragged)
    assert found.verdict == "effects"
    assert [effect.name for effect in found.effects] == ["body_drag"]
    assert found.effects[0].rivals == ()
    assert found.effects[0].probability > 0.99
    assert found.gap.reduction > 0.98


def test_what_no_effect_explains_is_unknown_and_named(simulation, dragged):
    """The library without the effect that is there."""
    found = discover(simulation, dragged, names=["payload", "rate_damping"])
    assert found.verdict == "unknown"
    assert found.unexplained > 0.5
    assert {"Fx", "Fy"} <= set(found.unexplained_by)
    assert any("u" in function for function in found.unexplained_by["Fx"])
    assert (found.effects, found.gap.reduction) == ((), 0.0)


def test_effects_on_axes_that_intervals_hold_are_not_looked_for(simulation, dragged):
    """Of a model with wide intervals of the moments; drag is still named."""
    half_width = np.array([1e-3, 1e-3, 1e-3, 10.0, 10.0, 10.0])

    def margins(flight):
        bounds = np.tile(half_width, (len(flight), 1))
        return Margins(-bounds, bounds, 0.95)

    sure = replace(simulation, intervals_of=sure_within(margins))
    found = discover(sure, dragged, names=["body_drag", "rate_damping"])
    assert [effect.name for effect in found.effects] == ["body_drag"]
    assert found.within_intervals == ("rate_damping",)
    alone = discover(sure, dragged, names=["rate_damping"])
    assert (alone.effects, alone.within_intervals) == ((), ("rate_damping",))
    assert alone.verdict == "unknown"


@pytest.mark.parametrize(("half_width_nm", "rivals"), [(1e-3, ()), (10.0, ("thrust_coefficient",))])
def test_what_intervals_hold_does_not_tell_effects_apart(simulation, flights, pushed, half_width_nm, rivals):
    """Less force alone: less thrust would lower moments too, which sound flights hardly leave room for."""

    def margins(flight):
        bounds = np.tile(np.repeat([1e-3, half_width_nm], 3), (len(flight), 1))
        return Margins(-bounds, bounds, 0.95)

    weak = []
    for flight in flights:
        lost = -0.1 * simulation.wrench(flight)
        lost[:, 3:] = 0.0
        weak.append(pushed(flight, simulation.vehicle, lost))
    sure = replace(of_sound_flights(simulation), intervals_of=sure_within(margins))
    found = discover(sure, weak, names=["payload", "thrust_coefficient"])
    assert [(effect.name, effect.rivals) for effect in found.effects] == [("payload", rivals)]
    # What noise hides tells nothing apart, and is no reason to prefer another.
    assert found.effects[0].probability >= 0.5


@pytest.mark.parametrize(("sound_flights", "rivals"), [(4, ()), (3, ("thrust_coefficient",))])
def test_a_model_of_few_flights_tells_effects_apart_by_its_intervals_alone(
    simulation, flights, pushed, sound_flights, rivals
):
    """Here by moments, of which noise leaves these."""

    def margins(flight):
        bounds = np.tile(np.repeat([1e-3, 0.1], 3), (len(flight), 1))
        return Margins(-bounds, bounds, 0.95)

    weak = []
    for flight in flights:
        lost = -0.1 * simulation.wrench(flight)
        lost[:, 3:] = 0.3 * np.sin(2.0 * np.pi * 15.0 * flight.time)[:, np.newaxis]
        weak.append(pushed(flight, simulation.vehicle, lost))
    known = of_sound_flights(simulation)
    sound = replace(known.sound, flights=sound_flights)
    sure = replace(known, sound=sound, intervals_of=sure_within(margins))
    found = discover(sure, weak, names=["payload", "thrust_coefficient"])
    assert not found.found.held[3:].any()
    assert [(effect.name, effect.rivals) for effect in found.effects] == [("payload", rivals)]


@pytest.mark.parametrize(("half_width_nm", "allowed"), [(1e-3, []), (10.0, ["rotor_tilt"])])
def test_what_explains_only_axes_that_intervals_hold_explains_nothing(
    simulation, flights, pushed, half_width_nm, allowed
):
    """More weight, and the moment of a tilted rotor, whose force is lost in what sound flights leave."""

    def margins(flight):
        bounds = np.tile(np.repeat([1e-3, half_width_nm], 3), (len(flight), 1))
        return Margins(-bounds, bounds, 0.95)

    tilt = {"rotor": 1.0, "forward_deg": 0.0, "right_deg": 2.0}
    loaded = []
    for flight in flights:
        added = effect_wrench("rotor_tilt", tilt, simulation.states(flight), simulation.record())
        added[:, :3] = -0.1 * simulation.wrench(flight)[:, :3]
        loaded.append(pushed(flight, simulation.vehicle, added))
    sure = replace(of_sound_flights(simulation), intervals_of=sure_within(margins))
    found = discover(sure, loaded, names=["payload", "rotor_tilt"])
    assert {effect.name for effect in found.effects} == {"payload", "rotor_tilt"}
    search = found.found
    assert [search.regression.candidates[index].name for index in search.allowed] == allowed


@pytest.mark.parametrize(("held", "searched_for"), [(1.0, [{}, {"body_drag": ALLOWED}]), (0.0, [{}])])
def test_what_intervals_allow_for_is_barred_unless_it_closes_what_they_do_not_hold(
    simulation, dragged, sought, monkeypatch, held, searched_for
):
    """Where another search finds nothing else, nothing is missing."""
    found, searches = sought.found, []
    (drag,) = found.chosen
    shares = np.ones((4, 6))
    shares[:, :2] = held
    inside = Inside(shares, 0.95)
    allowed = replace(sought, found=replace(found, allowed={drag: 3.0}, inside=inside))

    def searched(_, barred):
        searches.append(dict(barred))
        return replace(sought, effects=(), checks=(), found=replace(found, chosen=())) if barred else allowed

    monkeypatch.setattr("quadpi_core.discrepancy.study.discovered", searched)
    result = found_and_flown(simulation, dragged, names=SOUGHT)
    assert searches == searched_for
    assert [effect.name for effect in result.effects] == ([] if held else ["body_drag"])


@pytest.mark.slow
def test_a_draught_at_one_place_is_unknown(simulation, flights, pushed):
    """Flights pass it in other directions and with other headings; no function of motion knows it."""
    drafty = []
    for flight in flights:
        away = flight.position[:, :2] - [1.5, 0.0]
        east = np.zeros((len(flight), 3))
        east[:, 1] = 0.8 * np.exp(-0.5 * np.sum(np.square(away), axis=1) / 0.7**2)
        added = np.zeros((len(flight), 6))
        added[:, :3] = rotate_world_to_body(flight.attitude, east)
        drafty.append(pushed(flight, simulation.vehicle, added))
    found = discover(simulation, drafty)
    assert found.verdict == "unknown"
    assert {functions[0] for functions in found.unexplained_by.values()} == {"place east"}


def test_effects_that_look_alike_are_one_set(simulation, flights, pushed):
    """Level hover, held: another weight and another thrust are one force along z."""
    weightless, vehicle = [], simulation.vehicle
    weight = vehicle.mass_kg * vehicle.gravity_m_s2
    for place, flight in enumerate(flights):
        rng = np.random.default_rng(place)
        load = 1.0 + 0.002 * rng.standard_normal((len(flight), 1))
        still = replace(
            flight,
            velocity=np.zeros_like(flight.velocity),
            rates=np.zeros_like(flight.rates),
            angular_acceleration=np.zeros_like(flight.rates),
            attitude=np.tile([1.0, 0.0, 0.0, 0.0], (len(flight), 1)),
            rotor_speeds=simulation.hover_rotor_speed * np.sqrt(np.repeat(load, 4, axis=1)),
        )
        wrench = simulation.wrench(still)
        still = replace(still, specific_force=wrench[:, :3] / vehicle.mass_kg)
        lost = np.zeros_like(wrench)
        lost[:, 2] = 0.15 * weight
        noise = np.array([0.05, 0.05, 0.05, 0.001, 0.001, 0.001]) * rng.standard_normal(wrench.shape)
        weightless.append(pushed(still, vehicle, lost + noise))
    found = discover(simulation, weightless, names=ALIKE)
    assert found.verdict == "effects"
    (effect,) = found.effects
    assert {"payload", "thrust_coefficient"} <= {effect.name, *effect.rivals}
    assert effect.probability < 0.9
    assert discovery_json(found)["ambiguous"] == [[effect.name, *effect.rivals]]
    assert len(effect.shown_by) > 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "true"),
    [
        ("inertia", {"x_change": -0.2, "y_change": -0.15, "z_change": -0.2}),
        ("payload", {"mass_kg": 0.1}),
    ],
)
def test_mass_and_inertia_are_distinguished_from_thrust(effect, true, flown):
    """Mass, moments of inertia and thrust of another size all together leave accelerations as they are."""
    text = ",".join(f"{name}={value}" for name, value in true.items())
    found = discover(load_simulation("bebop2"), flown(f"{effect}:{text}"))
    assert [own.name for own in found.effects] == [effect]
    for parameter in found.effects[0].parameters:
        assert parameter.lower < true[parameter.name] < parameter.upper
        assert parameter.value == pytest.approx(true[parameter.name], rel=0.1)


@pytest.mark.slow
def test_a_tether_is_found_in_hovers(flown):
    """Along one line stiffness, length and anchor do the same: steps from one such point overshoot."""
    hidden = "tether:stiffness_n_m=0.1,length_m=2,north_m=0,east_m=0,height_m=0,hook_m=0.01"
    found = discover(load_simulation("bebop2"), flown(hidden, hover=True))
    assert [effect.name for effect in found.effects] == ["tether"]
    assert found.effects[0].parameters[0].value == pytest.approx(0.1, rel=0.15)


def test_every_flight_has_to_be_of_the_vehicle(simulation, flights):
    with pytest.raises(
        DiscrepancyError, match=r"flown by vehicle other, but the simulation bebop2 is of bebop2"
    ):
        discover(simulation, [flights[0], replace(flights[1], vehicle="other")])


def test_a_strong_law_that_each_flight_shows_differently_is_kept(simulation, flights, pushed):
    """Of two flights, one in drag along x alone and one along y alone, each left out is a surprise."""
    made = []
    none = {"x_n_s2_m2": 0.0, "y_n_s2_m2": 0.0, "z_n_s2_m2": 0.0}
    for flight, name in zip(flights, ("x_n_s2_m2", "y_n_s2_m2"), strict=False):
        drag = {**none, name: 0.01}
        added = effect_wrench("body_drag", drag, simulation.states(flight), simulation.record())
        made.append(pushed(flight, simulation.vehicle, added))
    found = discover(simulation, made, names=["body_drag"])
    assert [effect.name for effect in found.effects] == ["body_drag"]


def widths(effect):
    """Half of the width of the interval of each parameter."""
    for own in effect.parameters:
        assert own.upper - own.value == pytest.approx(own.value - own.lower, rel=1e-6)
    return [own.upper - own.value for own in effect.parameters]


def of_the_fit(found):
    """Standard deviation of each parameter of the one effect in the fit to all flights."""
    (index,) = found.chosen
    return found.regression.deviation(index, found.fit) * found.regression.candidates[index].scale


def test_an_interval_is_that_of_95_percent_and_wider_where_flights_disagree(dragged, simulation, monkeypatch):
    """1.96 standard deviations to either side: of the fit, times what flights differ by, or of the law."""
    for most in (0.9, 200.0):
        monkeypatch.setattr(Closing, "disagreement", lambda *_, most=most: np.array([0.5, most, 0.0]))
        discovery = discover(simulation, dragged, names=["body_drag"])
        (effect,) = discovery.effects
        ratios = np.array(widths(effect)) / (1.96 * of_the_fit(discovery.found))
        if most > 1.0:
            # One law for all: what flights dispute of one parameter makes the others no surer.
            np.testing.assert_allclose(ratios, most, rtol=1e-4)
        else:
            assert ratios.min() > 0.999
            assert ratios.max() > 1.2


def test_what_a_law_may_be_off_by_is_in_the_interval_even_where_flights_follow_it(simulation, dragged):
    """An aerodynamic law of each axis is known to 15 % alone, however little the noise."""
    for parameter in discover(simulation, dragged, names=["body_drag"]).effects[0].parameters[:2]:
        half = parameter.upper - parameter.value
        assert 0.15 < half / parameter.value < 0.6
        assert parameter.lower < DRAG[parameter.name] < parameter.upper


@pytest.mark.slow
def test_an_effect_is_measured_in_what_coefficients_truly_are(simulation, flown):
    """Speeds read too large by 2 % beside a simulation whose thrust is off: products of the two count."""
    off = simulation.with_coefficients({"thrust": 1.5, "thrust in airflow": 2.5})
    found = discover(off, flown("rotor_speed_scale:change=0.02"), names=["rotor_speed_scale"])
    _, change = found.effects[0].parameters
    assert change.lower < 0.02 < change.upper
    assert change.upper - change.lower < 0.002


@pytest.mark.slow
def test_a_model_of_flights_names_what_later_flights_have_more(physical_folder, dragged):
    """The physical model of the vehicle as the simulation: drag of the airframe was added since."""
    found = study(load_simulation(str(physical_folder)), dragged, names=SOUGHT)
    assert [effect.name for effect in found.discovery.effects] == ["body_drag"]
    (drag,) = found.discovery.effects
    *sideways, along_z = drag.parameters
    for parameter in sideways:
        # The model knows the drag of its own flights to about as much as was added along x.
        assert 0.5 < parameter.value / DRAG[parameter.name] < 2.0
    # Its intervals hold Fz, which so says nothing: drag along z may be there or not.
    assert along_z.lower < 0.0 < DRAG[along_z.name] < along_z.upper
    assert set(found.discovery.flown.coverage) == {"Fx", "Fy", "Fz", "Mx", "My", "Mz"}


BARRED = "intervals hold 10 % of Fx with it, 99 % before"


def test_a_barred_effect_is_not_named_and_the_page_says_why(simulation, dragged):
    found = discover(simulation, dragged, names=SOUGHT, barred={"body_drag": BARRED})
    assert "body_drag" not in [effect.name for effect in found.effects]
    (own,) = (candidate for candidate in found.candidates if candidate.name == "body_drag")
    assert (own.named, own.test, own.reason) == (False, "barred", BARRED)


@pytest.mark.parametrize(
    ("held", "failed", "barred"),
    [
        # By the one it is out of its intervals; needed for one axis; for none.
        (0.9, ("coverage",), True),
        (0.9, ("coverage", "closed"), False),
        (0.17, (), False),
        (0.19, (), True),
    ],
)
def test_what_intervals_hold_as_much_without_is_barred_from_another_search(
    simulation, dragged, sought, monkeypatch, held, failed, barred
):
    """Only where nothing else speaks against the first result; a fiftieth of the samples counts."""
    drag, searches = sought.effects[0], []
    coverage = {axis: Coverage(0.1, 0.2) for axis in AXES}
    two = replace(sought, effects=(drag, replace(drag, name="wind")))
    both = AugmentedSimulation(simulation, {"body_drag": DRAG, "wind": {}})

    def searched(_, barred):
        searches.append(dict(barred))
        return replace(two, effects=(drag,)) if barred else two

    def flown(discovery):
        checks = [Verdict(test, False, 0.0, 1.0, "", test) for test in failed]
        of = replace(discovery, flown=SimpleNamespace(coverage=coverage))
        return of if searches[-1] else replace(of, checks=tuple(checks))

    def covered(_, after):
        without_wind = {axis: Coverage(0.1, held if axis == "Mz" else 0.9) for axis in AXES}
        without_drag = {axis: Coverage(0.1, 0.1) for axis in AXES}
        return without_drag if "wind" in after[0].effects else without_wind

    for name, made in (("discovered", searched), ("flown_again", flown), ("coverages", covered)):
        monkeypatch.setattr(f"quadpi_core.discrepancy.study.{name}", made)
    monkeypatch.setattr("quadpi_core.discrepancy.study.augmented", lambda *_, **__: both)
    monkeypatch.setattr("quadpi_core.discrepancy.study._doubtful", lambda _: {})
    result = found_and_flown(simulation, dragged, names=SOUGHT)
    assert searches == ([{}, {"wind": "intervals hold as much without it"}] if barred else [{}])
    assert result.verdict == ("unknown" if len(failed) > 1 else "effects")


@pytest.mark.parametrize(
    ("held", "barred"),
    [
        ({"Fx": 0.91, "Fy": 0.9}, False),
        ({"Fx": 0.93, "Fy": 0.89}, True),
        ({"Fx": 0.99, "Fy": 0.87}, False),
    ],
)
def test_what_flights_have_of_their_own_is_barred_where_intervals_hold_more_without(
    monkeypatch, held, barred
):
    """As a turned IMU that explains moments and worsens a force: a fiftieth of the samples counts."""
    both = AugmentedSimulation(None, {"payload": {}, "imu_misalignment": {}})
    monkeypatch.setattr("quadpi_core.discrepancy.study.augmented", lambda *_, **__: both)
    coverage = {axis: Coverage(0.1, share) for axis, share in held.items()}
    monkeypatch.setattr("quadpi_core.discrepancy.study.coverages", lambda *_: coverage)
    known = [SimpleNamespace(name=name) for name in both.effects]
    regression = SimpleNamespace(flights=[None], candidates=known, conditions=[SimpleNamespace(index=1)])
    found = SimpleNamespace(
        found=SimpleNamespace(regression=regression),
        flown=SimpleNamespace(coverage={axis: Coverage(0.1, 0.9) for axis in held}),
        effects=known[:1],
        checks=(),
    )
    assert _spoiling(found) == ({"imu_misalignment": HOLDS_MORE} if barred else {})


@pytest.mark.parametrize("again", ["effects", "unknown"])
def test_what_closes_nothing_beside_another_effect_is_barred_from_another_search(
    simulation, dragged, sought, monkeypatch, again
):
    """Drag is there, damping of rates beside it is not; both are doubted if no search does without."""
    searches, regression = [], sought.found.regression
    chosen = tuple(
        i for i, own in enumerate(regression.candidates) if own.name in ("body_drag", "rate_damping")
    )
    closing = Closing.from_regression(regression, chosen)
    whole = replace(sought.found, chosen=chosen, closing=closing)
    two = replace(sought, effects=(sought.effects[0],) * 2, found=whole)

    def searched(_, barred):
        searches.append(dict(barred))
        return replace(sought, checks=(judge_closed(0.5 + (again == "effects")),)) if barred else two

    monkeypatch.setattr("quadpi_core.discrepancy.study.discovered", searched)
    monkeypatch.setattr("quadpi_core.discrepancy.study.flown_again", lambda discovery: discovery)
    result = found_and_flown(simulation, dragged, names=SOUGHT)
    assert searches == [{}, {"rate_damping": CLOSES_NOTHING}]
    assert (result.verdict, len(result.effects)) == (("effects", 1) if again == "effects" else ("unknown", 2))
    assert ("closes" in [check.test for check in result.checks if not check.passed]) == (again == "unknown")


@pytest.mark.parametrize(("without", "named"), [("effects", 1), ("none", 2), ("unknown", 2)])
def test_of_several_effects_that_do_not_hold_the_weakest_is_left_out(
    simulation, dragged, sought, monkeypatch, without, named
):
    """Drag is there, and what single flights have passed for another effect beside it."""
    searches, regression = [], sought.found.regression
    chosen = tuple(
        i for i, own in enumerate(regression.candidates) if own.name in ("body_drag", "rate_damping")
    )
    whole = replace(sought.found, chosen=chosen, fit=regression.fit(chosen))
    failed = Verdict("agreement", False, 8.5, 3.0, "", "flights differ")
    both = (sought.effects[0], replace(sought.effects[0], name="rate_damping"))
    two = replace(sought, effects=both, found=whole, checks=(failed,))
    nothing = replace(sought, effects=(), found=replace(sought.found, chosen=()))
    alone = nothing if without == "none" else sought
    fewer = replace(alone, checks=(failed,) if without == "unknown" else ())

    def searched(_, barred):
        searches.append(dict(barred))
        return fewer if barred else two

    for name, made in (("discovered", searched), ("flown_again", lambda own: own)):
        monkeypatch.setattr(f"quadpi_core.discrepancy.study.{name}", made)
    monkeypatch.setattr("quadpi_core.discrepancy.study._explaining_nothing", lambda _: {})
    result = found_and_flown(simulation, dragged, names=SOUGHT)
    assert searches == [{}, {"rate_damping": "flights differ"}]
    assert (result.verdict, len(result.effects)) == ("effects" if named == 1 else "unknown", named)


def turned_over(discovery):
    """Roll-outs that moved coefficients, and nothing else, make worse."""
    after = 50.0 if discovery.adjusted else 4.0
    rollouts = Rollouts(0.5, 10, {"attitude_deg": BeforeAfter(10.0, after, 1.0)})
    return Reflights(rollouts, ClosedLoops(0, missing="none"), {})


def test_coefficients_that_spoil_roll_outs_stay_as_stated(simulation, dragged, monkeypatch):
    """The effect alone is added then, and its gap is that without them."""
    monkeypatch.setattr("quadpi_core.discrepancy.study.reflights", turned_over)
    result = study(simulation, dragged, names=SOUGHT)
    discovery = result.discovery
    assert (discovery.adjusted, discovery.verdict) == (False, "effects")
    stated = discovery.found.gap(adjusted=False)
    np.testing.assert_array_equal(discovery.gap.after, stated.after)
    tests = [check.test for check in discovery.checks]
    anew = judge_closed(stated.reduction)
    assert tests.count(anew.test) == 1
    assert discovery.checks[tests.index(anew.test)] == anew
    assert discovery.flown.rollout.errors["attitude_deg"].after == 4.0
    base, flight = augmented(discovery).base, dragged[0]
    np.testing.assert_array_equal(base.wrench(flight), simulation.wrench(flight))


def test_what_spoils_roll_outs_without_coefficients_too_is_rejected(simulation, dragged, monkeypatch):
    monkeypatch.setattr(
        "quadpi_core.discrepancy.study.reflights", lambda own: turned_over(replace(own, adjusted=True))
    )
    discovery = study(simulation, dragged, names=SOUGHT).discovery
    assert (discovery.adjusted, discovery.verdict) == (True, "unknown")


def test_a_pull_to_the_side_may_be_markers_that_are_turned():
    assert likely_cause("a pull", "y_n", 0.05) == "a pull, or markers turned by 2.9°"
    assert likely_cause("a pull", "z_n", 0.05) == "a pull"
