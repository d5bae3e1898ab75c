# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The scorer, on answers whose worth is plain."""

from __future__ import annotations

import pytest
from blind.cases import NULL, OUT, PAIR, POOR, SINGLE, Hidden
from blind.scoring import Answer, confusion, failures, figures, wilson

DRAG = Hidden(SINGLE, ("rotor_drag",), 1.0, 0)


def answer(hidden, verdict, *named, sets=(), left=0.01, **more):
    return Answer(hidden, verdict, named, sets, left, **more)


def test_wilson_interval():
    assert wilson(0, 100) == pytest.approx((0.0, 0.0370), abs=1e-4)
    assert wilson(95, 100) == pytest.approx((0.8882, 0.9785), abs=1e-4)
    assert wilson(10, 10)[1] == pytest.approx(1.0)


def test_right_in_a_set_and_wrong():
    right = answer(DRAG, "effects", "rotor_drag")
    in_set = answer(DRAG, "effects", "body_drag", sets=(("body_drag", "rotor_drag"),))
    wrong = answer(DRAG, "effects", "body_drag", sets=(("body_drag", "tether"),))
    extra = answer(DRAG, "effects", "rotor_drag", "tether")
    unknown = answer(DRAG, "unknown", "tether")
    assert (right.right, right.in_set, right.wrong) == (True, True, ())
    assert (in_set.right, in_set.in_set, in_set.wrong) == (False, True, ())
    assert (wrong.right, wrong.in_set, wrong.wrong) == (False, False, ("body_drag",))
    assert (extra.right, extra.in_set, extra.wrong) == (False, False, ("tether",))
    assert (unknown.right, unknown.in_set, unknown.wrong) == (False, False, ())
    assert in_set.words == "effects: body_drag or rotor_drag"


def test_a_null_is_right_only_with_no_verdict():
    nothing = Hidden(NULL, (), 0.0, 0)
    assert answer(nothing, "none").right
    assert not answer(nothing, "unknown").right
    assert not answer(nothing, "effects", "tether").right


def test_figures_count_what_they_are_about():
    half = Hidden(SINGLE, ("wind",), 0.5, 0)
    pair = Hidden(PAIR, ("wind", "payload"), 1.0, 0)
    answers = [
        answer(Hidden(NULL, (), 0.0, 0), "none"),
        answer(Hidden(NULL, (), 0.0, 1), "unknown"),
        answer(DRAG, "effects", "rotor_drag"),
        answer(half, "none"),
        answer(half, "effects", "tether"),
        answer(Hidden(OUT, ("magnet",), 1.0, 0), "unknown"),
        answer(pair, "effects", "payload", "wind", left=0.03),
        answer(pair, "effects", "payload", "wind", "inertia"),
        answer(Hidden(POOR, ("wind",), 1.0, 0), "effects", "tether", sets=(("tether", "wind"),)),
        answer(Hidden(POOR, ("wind",), 1.0, 1), "none"),
    ]
    found = {figure.name: (figure.hits, figure.of, figure.reached) for figure in figures(answers)}
    assert found["nulls: false alarms"] == (1, 2, False)
    assert found["single effects, full size: named"] == (1, 1, True)
    assert found["single effects, half size: named"] == (0, 2, False)
    assert found["single effects, any size: wrong name"] == (1, 3, False)
    assert found["outside the library: unknown"] == (1, 1, True)
    assert found["pairs: exactly right"] == (1, 2, False)
    assert found["pairs: a spurious extra"] == (1, 2, False)
    assert found["under-excited: the truth among what is reported"] == (1, 1, True)
    assert found["gap left by effects rightly found: at most 2 %"] == (1, 1, True)
    assert found["gap left by delay and wind rightly found: at most 5 %"] == (1, 1, True)
    assert found["additions that make flights or roll-outs worse that were not fitted"] == (0, 10, True)
    assert confusion(answers, 0.5) == {"wind": {"none": 1, "tether": 1}}
    assert len(failures(answers)) == 3


def test_parameters_are_scored_where_the_effect_is_found_and_means_the_same():
    weak = Hidden(SINGLE, ("weak_rotor",), 0.5, 3)

    def found(rotor, loss, upper=0.03, name="weak_rotor"):
        parameters = {
            "rotor": {"value": rotor, "lower": rotor, "upper": rotor},
            "loss": {"value": 0.02, "lower": 0.01, "upper": upper},
        }
        effect = {"name": name, "parameters": parameters}
        result = {"verdict": "effects", "effects": [effect], "ambiguous": []}
        return Answer.of(
            {"seal": weak.sealed(), "result": result, "left": None, "rollouts": None},
            {"weak_rotor.rotor": 2.0, "weak_rotor.loss": loss},
        )

    right, beside, sure = found(2.0, 0.025), found(2.0, 0.031), found(2.0, 0.02, 0.01)
    another, other = found(3.0, 0.025), found(2.0, 0.025, name="rotor_tilt")
    assert right.estimates == {"weak_rotor.loss": (0.025, 0.01, 0.03)}
    assert not another.estimates
    assert not other.estimates
    answers = [right, beside, sure, another, other]
    assert [answer.right for answer in answers] == [True, True, True, False, False]
    assert another.wrong == ("weak_rotor of another rotor",)
    # One without width, as of a parameter at its bound, is as wrong as any.
    shares = {figure.name: (figure.hits, figure.of) for figure in figures(answers)}
    assert shares["parameters inside their interval of 95 %"] == (1, 3)


def test_additions_that_make_flights_worse_are_failures():
    name = "additions that make flights or roll-outs worse that were not fitted"
    same = {"attitude_deg": (10.0, 10.1), "lost": (1, 1)}
    fine = answer(DRAG, "effects", "rotor_drag", rollouts=same)
    wider = answer(DRAG, "effects", "rotor_drag", left=1.03)
    turned = answer(DRAG, "effects", "rotor_drag", rollouts={**same, "attitude_deg": (10.0, 10.3)})
    lost = answer(DRAG, "unknown", "tether", rollouts={**same, "lost": (0, 1)})
    nothing = answer(DRAG, "none", left=None)
    assert (fine.worse, wider.worse, turned.worse) == ((), ("gap",), ("attitude_deg",))
    shares = {f.name: (f.hits, f.of) for f in figures([fine, wider, turned, lost, nothing])}
    assert shares[name] == (3, 4)
    failed = failures([fine, wider, turned, lost])
    assert fine not in failed
    assert len(failed) == 3
    assert wider.words == "effects: rotor_drag; worse: gap"
