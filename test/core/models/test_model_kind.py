# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What every kind of model does unless it says otherwise: refuse options, store axes and read them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import pytest

import quadpi_core
from quadpi_core.config_schema import Numbers, Positive, Text
from quadpi_core.errors import ModelError
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.models import kinds
from quadpi_core.models.interval_rules import NormalRule, StoredRule, TrainedRule
from quadpi_core.models.kind_registry import default_kind, kind_named, kind_of
from quadpi_core.models.model_kind import CUTOFF_HZ, Fitted, FittedAxis, IdentifyOptions, Kind, option
from quadpi_core.plugins import names_in


@dataclass(frozen=True)
class Constant(FittedAxis):
    """An axis that is one number."""

    value: Annotated[Array, Numbers(1)]
    unit: Text
    rule: StoredRule
    terms: ClassVar[list[str]] = ["1"]


class FittedConstants(Fitted):
    """One number for each axis."""

    method = "constant"
    axis_type = Constant

    def evaluate(self, *_: Any) -> Any:
        raise NotImplementedError


class Constants(Kind):
    """A kind of model without options and without settings of the paper."""

    name = "constant"
    label = "constants"
    fitted_type = FittedConstants

    def fit(self, *_: Any) -> Any:
        raise NotImplementedError


@dataclass(frozen=True)
class Adjustable(Constants):
    """The same with options, and settings of the paper."""

    size: Positive = option(2.0, "Size of the number.")
    sign: Literal["plus", "minus"] = option("plus", "Sign of the number.")
    has_paper_settings = True


KIND = Constants()
MODEL = FittedConstants(
    {
        "Fx": Constant(np.array([1.5]), "N", NormalRule()),
        "Fxy": Constant(np.array([-2.0]), "N", TrainedRule(0.95)),
    }
)


def test_factors_are_those_of_the_rules_and_zero_for_axes_not_held() -> None:
    zero = Constant(np.zeros(1), "N", NormalRule())
    fitted = FittedConstants({"Fx": zero, "My": zero}).with_rules({"My": TrainedRule(0.95)})
    factors = fitted.factors(0.95)
    assert factors.shape == (6,)
    assert factors[AXES.index("Fx")] == pytest.approx(1.959964)
    assert factors[AXES.index("My")] == 1.0
    assert np.count_nonzero(factors) == 2
    with pytest.raises(ModelError, match=r"trained for a confidence of 0\.95, not 0\.9"):
        fitted.factors(0.9)


def test_settings_of_the_paper_are_refused_by_a_kind_without_them() -> None:
    chosen = IdentifyOptions(settings="paper")
    with pytest.raises(ModelError, match="the paper knows no constant method"):
        KIND.check(chosen, {})
    Adjustable().check(chosen, {})
    KIND.check(IdentifyOptions(), {})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"size": -1.0}, r"`size` must be a positive number, found -1\.0"),
        ({"size": float("nan")}, "`size` must be a positive number, found nan"),
        ({"sign": "both"}, "`sign` must be one of plus, minus, found 'both'"),
    ],
)
def test_a_kind_checks_its_own_options(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ModelError, match=f"^method constant: {message}$"):
        Adjustable(**options).check(IdentifyOptions(), {})
    Adjustable(size=0.1, sign="minus").check(IdentifyOptions(), {})


def test_a_kind_takes_those_of_some_options_that_it_has() -> None:
    assert Adjustable().having(size=3.0, device="cuda") == Adjustable(size=3.0)
    assert KIND.having(size=3.0) == KIND


def test_each_axis_is_stored_by_itself_and_read_again() -> None:
    """An axis takes the arrays that begin with its own name, not with one that is longer."""
    stored = MODEL.store()
    assert sorted(stored.arrays) == ["Fx.value", "Fxy.value"]
    assert stored.entries["Fx"] == {"unit": "N", "rule": {"kind": "normal"}}
    assert stored.files == {}
    assert FittedConstants.read(stored).store() == stored


@pytest.mark.parametrize(
    ("entry", "arrays", "message"),
    [
        ({"unit": ""}, {}, "`unit` must be text, found ''"),
        ({"rule": {"kind": "magic"}}, {}, "unknown kind of interval rule 'magic'"),
        ({}, {"Fx.value": np.zeros(2)}, r"`value` must hold 1 numbers, is of shape \(2,\)"),
    ],
)
def test_an_axis_that_cannot_be_read_is_named(entry: Any, arrays: Any, message: str) -> None:
    stored = MODEL.store()
    entries = {**stored.entries, "Fx": {**stored.entries["Fx"], **entry}}
    with pytest.raises(ModelError, match=f"^Fx: .*{message}$"):
        FittedConstants.read(replace(stored, entries=entries, arrays={**stored.arrays, **arrays}))


def test_an_axis_without_its_array_is_named() -> None:
    with pytest.raises(ModelError, match=r"^Fx: constant: missing key `value`$"):
        FittedConstants.read(replace(MODEL.store(), arrays={}))


def test_options_that_nobody_gave() -> None:
    """The low-pass keeps the band where rotor speeds and moments are coherent; the paper's is its own."""
    options = IdentifyOptions()
    assert (options.cutoff_hz, options.confidence, options.false_alarms_per_hour) == (30.0, 0.95, 1.0)
    assert CUTOFF_HZ == {"default": 30.0, "paper": 100.0}


# The kinds of model that come with quadpi; those of other packages are in test_kind_of_model_guide.py.


ROOT = Path(quadpi_core.__file__).parents[1]
PACKAGES = [ROOT / name for name in ("quadpi_core", "quadpi_ros")]


def test_a_kind_has_the_name_of_its_file() -> None:
    assert names_in(kinds) == ("bootstrap", "physical", "polynomial", "quality-driven")
    for name in names_in(kinds):
        kind = kind_named(name)
        assert kind.name == kind.fitted_type.method == name
        assert kind.label


def test_no_two_kinds_share_a_colour() -> None:
    colours = [kind_named(name).colour for name in names_in(kinds)]
    assert len(set(colours)) == len(colours)


@pytest.mark.parametrize("name", ["magic", "", "../kinds/polynomial", "quality_driven"])
def test_another_name_is_refused(name: str) -> None:
    with pytest.raises(
        ModelError, match=r"is not known to this version \(bootstrap, physical, polynomial, quality-driven\)"
    ):
        kind_named(name)


def test_the_default_is_the_best_on_flights_that_it_has_not_seen() -> None:
    """That of `make models`; see also test_kind_options.py for the command line."""
    page = (Path(__file__).parents[3] / "experiments" / "results" / "models.md").read_text()
    (best,) = re.findall(r"^Best: \*\*(\S+)\*\*\.$", page, re.MULTILINE)
    assert kind_of(IdentifyOptions()) is kind_named(best)


def test_settings_choose_a_default_that_has_them() -> None:
    assert kind_of(IdentifyOptions(settings="paper")) is kind_named("polynomial")
    assert kind_of(IdentifyOptions(settings="paper", method="bootstrap")) is kind_named("bootstrap")
    own = kind_named("polynomial").having(stop="pse")
    assert kind_of(IdentifyOptions(method=own)) is own


def test_a_default_is_the_first_that_has_what_is_asked_for() -> None:
    first, second = kinds.DEFAULTS
    assert default_kind(lambda _: True).name == first
    assert default_kind(lambda kind: kind.name != first).name == second
    assert default_kind(lambda _: False).name == first


def test_no_condition_names_a_kind_outside_its_file() -> None:
    """House rule 7: what makes a kind special is an attribute of it."""
    named = [
        f"{path.name}:{node.lineno}"
        for package in PACKAGES
        for path in package.rglob("*.py")
        if path.parent.name != "kinds"
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, (ast.Compare, ast.MatchValue)) and set(texts(node)) & set(names_in(kinds))
    ]
    assert named == []


def texts(node: ast.AST) -> Iterator[str]:
    return (
        part.value
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
    )
