# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Options of `quadpi identify` that kinds of model declare; a kind of a user's own is in its guide's test."""

from __future__ import annotations

from pathlib import Path

import pytest
import typer

from quadpi_core.cli import app
from quadpi_core.cli.options import choice_of_kind
from quadpi_core.models.kind_registry import KINDS

COMMAND = ("identify", "absent.mcap", "--vehicle", "bebop2", "-o", "model")


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")


def test_help_of_a_method_shows_its_options(quadpi) -> None:
    text = quadpi("identify", "--method", "polynomial", "--help").output
    panel = text[text.index("Options of --method polynomial") :]
    assert "--stop" in panel
    assert "When to stop adding terms" in panel
    assert "--device" not in text


def test_help_says_how_to_see_them(quadpi) -> None:
    text = quadpi("identify", "--help").output
    assert "Each has options of its own" in text
    assert "--stop" not in text
    words = " ".join(text.replace("│", " ").split())
    assert "Default: the first of physical, polynomial that has all options given." in words


@pytest.mark.parametrize(
    ("words", "method", "lacking"),
    [
        ((), "physical", None),
        (("--seed", "3"), "physical", None),
        (("--stop", "pse"), "polynomial", "--stop"),
        (("--settings", "paper"), "polynomial", "--settings paper"),
        (("--candidates=quadrotor",), "polynomial", "--candidates"),
        (("--settings=paper", "--stop=pse"), "polynomial", "--settings paper, --stop"),
        (("--method", "polynomial", "--stop", "pse"), "polynomial", None),
    ],
)
def test_the_default_is_the_first_kind_that_has_all_options_given(words, method, lacking) -> None:
    command = typer.main.get_command(app).commands["identify"]
    context = command.make_context("identify", [*COMMAND[1:], *words])
    assert context.obj.name == method
    sentence = f"--method {method}: physical, the default, takes no {lacking}"
    assert choice_of_kind(context) == (lacking and sentence)


@pytest.mark.parametrize("words", [(), ("--stop", "pse")])
def test_an_option_that_no_default_has_is_refused_with_the_kinds_that_have_it(quadpi, words) -> None:
    outcome = quadpi(*COMMAND, *words, "--device", "cpu")
    assert outcome.status == 2
    refused = "quadpi: --device: an option of --method bootstrap or quality-driven, not of physical\n"
    assert outcome.errors == refused


def test_candidates_are_refused_by_a_kind_that_does_not_choose(quadpi) -> None:
    outcome = quadpi(*COMMAND, "--method", "physical", "--candidates", "quadrotor")
    assert outcome.status == 2
    assert "--candidates: an option of --method bootstrap or polynomial or quality-driven" in outcome.errors


@pytest.mark.parametrize("words", [("--stop", "pse"), ("--stop=pse",)])
@pytest.mark.parametrize("method", [("--method", "bootstrap"), ("--method=bootstrap",)])
def test_an_option_of_another_kind_is_refused(quadpi, words, method) -> None:
    outcome = quadpi(*COMMAND, *words, *method)
    assert outcome.status == 2
    assert outcome.errors == "quadpi: --stop: an option of --method polynomial, not of bootstrap\n"


def test_an_option_that_no_kind_has(quadpi) -> None:
    outcome = quadpi(*COMMAND, "--nonsense", "1")
    assert outcome.status == 2
    assert "No such option: --nonsense" in outcome.errors


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--seed", "-1"), "quadpi: method bootstrap: `seed` must be a whole number not below 0, found -1"),
        (("--seed", "x"), "Invalid value for '--seed'"),
        (("--device", "tpu"), "Invalid value for '--device'"),
    ],
)
def test_a_value_that_is_impossible(quadpi, words, message) -> None:
    outcome = quadpi(*COMMAND, "--method", "bootstrap", *words)
    assert outcome.status == 2
    assert message in outcome.errors


def test_an_unknown_method_is_refused_with_those_known(quadpi) -> None:
    outcome = quadpi(*COMMAND, "--method", "magic")
    assert outcome.status == 2
    assert all(name in outcome.errors for name in ("'magic'", *KINDS.names()))
