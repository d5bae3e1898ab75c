# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The kinds of model that come with quadpi; those of other packages are in test_kind_of_model_guide.py."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import quadpi_core
from quadpi_core.errors import ModelError
from quadpi_core.models import kinds
from quadpi_core.models.kind_registry import default_kind, kind_named, kind_of
from quadpi_core.models.model_kind import IdentifyOptions
from quadpi_core.plugins import names_in

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
    page = (ROOT / "experiments" / "results" / "models.md").read_text()
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
