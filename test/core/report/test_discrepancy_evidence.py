# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence in plain words, and what would change each verdict."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from quadpi_core.discrepancy.acceptance import Verdict
from quadpi_core.discrepancy.by_condition import Profile, Residual
from quadpi_core.discrepancy.closure import Gap
from quadpi_core.discrepancy.discrepancy_result import RankedCandidate
from quadpi_core.discrepancy.result_verdicts import (
    judge_closed,
    judge_coefficients,
    judge_rollouts,
    judge_unexplained,
)
from quadpi_core.flight import AXES
from quadpi_core.report.discrepancy_evidence import (
    amount,
    closes,
    evidence_table,
    gap_figure,
    map_figure,
    mean_map,
    passed_checks,
    profile_figure,
    refusal,
    residual_figure,
    verdict_changes,
)
from quadpi_core.report.discrepancy_page import discrepancy_summary, write_discrepancy_page
from quadpi_core.simulation.applied_effects import EFFECTS

REFUSED = RankedCandidate(
    name="rotor_drag",
    label="rotor_drag",
    named=False,
    beside=(),
    gain=15500.0,
    needed=500.0,
    test="flights left out",
    reason="worst axis of flights left out grows by 0.80, 0.5 allowed",
    closes={"Fx": 0.93, "Fy": 0.004, "Mz": -0.8},
    cancels=(),
    rivals={},
)
WEAK = replace(
    REFUSED,
    name="wind",
    label="wind",
    gain=64.0,
    needed=100.0,
    test="evidence",
    reason="gains 64.0 nat, 100.0 needed",
)


def changed(study, **changes):
    return replace(study, discovery=replace(study.discovery, **changes))


@pytest.mark.parametrize(
    ("gain", "needed", "words"),
    [
        (15500.0, 500.0, "31 times what is needed"),
        (150.0, 100.0, "1.5 times what is needed"),
        (64.0, 100.0, "64 % of what is needed"),
        (-3.0, 100.0, "none"),
        (None, None, "not weighed"),
    ],
)
def test_evidence_is_told_beside_what_is_needed(gain, needed, words):
    assert amount(replace(REFUSED, gain=gain, needed=needed)) == words


def test_axes_that_get_better_and_worse_are_told_apart():
    assert closes(REFUSED) == "Fx 93 %; makes Mz by 80 % worse"
    assert closes(replace(REFUSED, closes={"Fy": 0.004})) == "nothing"
    cancelled = replace(REFUSED, closes={"Fx": 0.5, "Mx": -14.9, "My": -30.5}, cancels=("Mx", "My"))
    assert closes(cancelled) == "Fx 50 %; nothing of Mx and My but with coefficients that move against it"
    assert closes(replace(REFUSED, closes={})) == ""
    assert closes(replace(REFUSED, closes={"Fx": 0.016, "Fy": -0.016})) == "Fx 2 %; makes Fy by 2 % worse"


def test_every_test_of_a_candidate_has_plain_words(found):
    accepted = next(own for own in found.discovery.found.judgements if own.accepted)
    for verdict in accepted.verdicts:
        own = replace(REFUSED, test=verdict.test, gain=1.0, reason="REASON of_the test")
        assert refusal(own)
        assert not refusal(own).startswith("REASON")
    assert refusal(REFUSED) == f"makes flights left out worse: {REFUSED.reason}"
    assert refusal(replace(WEAK, gain=120.0)) == "replaced by a better one"


def test_a_refused_effect_with_much_evidence_is_told_with_its_veto(found):
    (change,) = (
        own
        for own in verdict_changes(changed(found, candidates=(*found.discovery.candidates[:1], REFUSED)))
        if own.now.startswith("Rotor drag")
    )
    assert "has 31 times what is needed" in change.now
    assert REFUSED.reason in change.now
    assert "more flights of the same kind" in change.then


def test_nearly_enough_evidence_tells_how_many_flights_would_do(found):
    changes = verdict_changes(changed(found, candidates=(WEAK,)))
    (change,) = (own for own in changes if own.now.startswith("Wind"))
    assert "64 % of what is needed" in change.now
    assert "About 60 % more such flights" in change.then
    assert EFFECTS["wind"].shown_by in change.then
    beside = replace(WEAK, beside=("body_drag",))
    (change,) = verdict_changes(changed(found, candidates=(beside,)))[-1:]
    assert "what it needs grows with the evidence of body drag" in change.then
    assert "%" not in change.then
    far = replace(WEAK, gain=10.0)
    assert verdict_changes(changed(found, candidates=(far,))) == verdict_changes(
        changed(found, candidates=())
    )


def test_the_three_that_come_nearest_are_told_from_a_third_of_the_evidence_on(found):
    near = tuple(replace(WEAK, label=f"wind_{k}", gain=40.0 - k) for k in range(5))
    told = [own.now for own in verdict_changes(changed(found, candidates=near)) if own.now.startswith("Wind")]
    assert [words.split(" has")[0] for words in told] == ["Wind 0", "Wind 1", "Wind 2"]


@pytest.mark.parametrize(
    ("check", "now", "then"),
    [
        (
            judge_unexplained(0.36),
            "36 % of what can be predicted has no name, 5 % allowed.",
            "Leave out flights",
        ),
        (judge_coefficients(1.0, 9.0, "thrust"), "Thrust would be wrong by 9.0", "Measure"),
        (judge_closed(0.2), "20 % of the gap is closed, 80 % needed.", "what else is missing"),
        (judge_rollouts({"rates": (1.0, 2.0)}), "Roll-outs of flights left out get worse", "delays"),
        (Verdict("disputed", False, 0.0, 1.0, "", "a beats b"), "A beats b.", "the one effect"),
    ],
)
def test_each_doubt_has_what_would_remove_it(found, check, now, then):
    change = verdict_changes(changed(found, checks=(check,)))[0]
    assert change.now.startswith(now)
    assert then in change.then


def test_rivals_come_with_what_to_fly(found):
    (drag,) = found.discovery.effects
    rivalled = replace(drag, rivals=("wind",), shown_by=("forward flight", "turns"))
    change = verdict_changes(changed(found, effects=(rivalled,)))[0]
    assert change == (
        "Body drag explains these flights as well as wind would.",
        "To tell them apart, fly forward flight and turns.",
    )


def test_distance_from_the_limits_is_told(found):
    assert "of the gap is closed, 80 % needed" in passed_checks(found.discovery)
    assert passed_checks(replace(found.discovery, checks=(judge_closed(0.2),))) == ""


def test_pages_hold_evidence_and_changes_of_many_candidates_with_long_names(
    found, read_page, rendered, tmp_path
):
    long_name = "a_load_on_a_cable_below_the_vehicle_that_swings"
    many = tuple(
        replace(
            WEAK, label=f"{long_name} (rotor {k})", gain=64.0 - k, rivals={long_name: 0.01}, beside=("x",)
        )
        for k in range(40)
    )
    study = changed(found, candidates=(*found.discovery.candidates[:1], *many))
    write_discrepancy_page(tmp_path / "page.html", study)
    page = read_page(tmp_path / "page.html")
    for own in many:
        assert own.label.replace("_", " ") in page.text
    assert "Further candidates" in page.text
    assert (
        page.text.index("Evidence")
        < page.text.index("What would change the verdict")
        < page.text.index("Where")
    )
    shown = " ".join(rendered(discrepancy_summary(study)).split())
    for change in verdict_changes(study):
        assert " ".join(change.now.split()) in shown


def test_named_and_refused_are_told_apart(found):
    candidates = (*found.discovery.candidates[:1], REFUSED)
    for verdict, best in {"effects": "named", "unknown": "comes closest"}.items():
        table = evidence_table(candidates, verdict)
        assert [row[1].value for row in table.cells] == [best, "refused"]


# Figures of residuals: what is drawn is what was measured more than simulated, before and after.


VARIABLES = ("u", "v", "speed", "height", "w", "rotor_speed")


def flight(u, v, wrench=None):
    """Residuals of forces that fall with the forward speed."""
    if wrench is None:
        wrench = np.zeros((u.size, 6))
        wrench[:, 0] = -0.1 * u
    rng = np.random.default_rng(0)
    others = {name: rng.uniform(0.0, 9.0, u.size) for name in VARIABLES[2:]}
    return Residual("a", np.arange(u.size) / 40.0, {"u": u, "v": v, **others}, wrench, wrench, 0.5 * wrench)


@pytest.fixture
def square():
    u, v = np.meshgrid(np.linspace(-3.9, 3.9, 60), np.linspace(-3.9, 3.9, 60))
    return flight(u.ravel(), v.ravel())


def test_maps_hold_the_mean_of_what_was_measured_more_than_simulated(square):
    x, y, table = mean_map([square], 0, "u", "v")
    assert table.shape == (len(y) - 1, len(x) - 1)
    centres = 0.5 * (x[:-1] + x[1:])
    assert np.nanmean(table, axis=0) == pytest.approx(-0.1 * centres, abs=0.02)
    assert max(table.shape) <= 12
    # 14 values in an extent of 13 do not fit into bins of one: bins of two do.
    steps = np.arange(14.0).repeat(30)
    assert len(mean_map([flight(steps, steps)], 0, "u", "v")[0]) - 1 == 7


def test_a_cell_needs_twenty_samples_to_be_drawn():
    """Of several flights together."""
    here, there = np.array([0.5] * 19), np.array([8.5] * 20)
    few = flight(np.concatenate((here, there)), np.concatenate((here, there)))
    x, _, table = mean_map([few], 0, "u", "v")
    assert np.isnan(table[0, 0])
    assert table[-1, -1] == pytest.approx(-0.85)
    assert np.isfinite(table).sum() == 1
    one = flight(np.array([0.5]), np.array([0.5]))
    np.testing.assert_array_equal(mean_map([few, one], 0, "u", "v")[0], x)
    assert np.isfinite(mean_map([few, one], 0, "u", "v")[2]).sum() == 2


def test_colours_of_an_axis_have_one_scale_about_zero(square):
    figure = map_figure([square], ("Fx", "Mz"))
    assert len(figure.panels) == 3 * figure.columns == 6
    for column in range(2):
        own = [panel.layers[0] for panel in figure.panels[column::2]]
        largest = max(np.nanmax(np.abs(cell.values)) for cell in own)
        assert [cell.largest for cell in own] == pytest.approx([largest] * 3)
        assert all(len(cell.values) == (len(cell.x) - 1) * (len(cell.y) - 1) for cell in own)


def test_a_profile_is_drawn_to_the_end_of_its_last_bin():
    profile = Profile("Fx", "u", np.array([0.0, 2.0, 4.0]), *np.array([[3.0, 4.0], [1.0, 2.0], [0.5, 0.6]]))
    figure = profile_figure([profile] * 4)
    drawn = {line.name: line for line in figure.panels[0].layers}
    assert drawn["as it is"].y.tolist() == [3.0, 4.0, 4.0]
    assert drawn["with what was found"].y.tolist() == [1.0, 2.0, 2.0]
    assert all(line.stepped for line in drawn.values())
    assert len({line.dash for line in drawn.values()}) == 3
    assert figure.panels[0].x.title == "forward airspeed [m/s]"


def test_a_gap_is_drawn_before_after_and_as_the_floor():
    before, after, floor = np.arange(18.0).reshape(3, 6)
    figure = gap_figure(Gap(before, after, floor, 0.5))
    for k, panel in enumerate(figure.panels):
        own = slice(3 * k, 3 * k + 3)
        assert tuple(label for _, label in panel.x.ticks) == AXES[own]
        left, right, noise = panel.layers
        assert (left.name, right.name, noise.name) == ("before", "after", "floor")
        np.testing.assert_array_equal(left.top, before[own])
        np.testing.assert_array_equal(right.top, after[own])
        np.testing.assert_array_equal(noise.y, floor[own])
        assert np.all(left.right <= right.left)


def test_residuals_over_time_have_a_band_of_twice_the_floor(square):
    figure = residual_figure(square, np.full(6, 0.25))
    assert len(figure.panels) == 6
    for panel in figure.panels:
        noise, before, after = panel.layers
        assert (noise.bottom.tolist(), noise.top.tolist()) == ([-0.5], [0.5])
        assert (before.name, after.name) == ("before", "after")
    _, before, after = figure.panels[0].layers
    assert after.y.max() == pytest.approx(0.5 * before.y.max(), rel=1e-6)
