# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bars: what they show on a terminal, that they fit, and that nothing is drawn elsewhere."""

from __future__ import annotations

import io
import re
from functools import partial
from types import SimpleNamespace

import pytest
from rich.console import Console

from quadpi_core.identification.identify import Step
from quadpi_core.report.progress import counting, flying, identifying

EPOCHS = [
    SimpleNamespace(stage="members", epoch=12, epochs=50, loss=0.2134, coverage=0.9412),
    SimpleNamespace(stage="noise", epoch=1, epochs=50, loss=-1.5, coverage=None),
]


class Terminal(io.StringIO):
    """What is written to a terminal of 80 characters."""

    def isatty(self):
        return True


def drawn(file, bar, *steps):
    """What a bar leaves on a file when it ends, line by line."""
    with bar(Console(file=file, width=80, force_terminal=True, color_system=None)) as report:
        for step in steps:
            report(*step)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", file.getvalue()).splitlines()


BARS = {
    "Training members .* epoch 12 of 50 · loss 0.213 · coverage 94.1% ": (
        identifying,
        (Step.training(EPOCHS[0]),),
    ),
    "Training noise .* epoch 1 of 50 · loss -1.5 ": (
        identifying,
        (Step.training(EPOCHS[0]),),
        (Step.training(EPOCHS[1]),),
    ),
    "Identifying Fz .* 2 of 6 ": (identifying, (Step("Identifying Fz", 2, 6),)),
    "Reading flights .* 3 of 7 ": (partial(counting, what="Reading flights", total=7), (3,)),
    "Flying .* 4 of 5 s · 1 of 2 flights ": (
        partial(flying, durations={"hop": 2.0, "stand": 3.0}),
        ("hop", 2.0),
        ("stand", 2.0),
    ),
}


@pytest.mark.parametrize("shown", BARS)
def test_a_bar_fits_a_terminal_and_shows(shown):
    lines = drawn(Terminal(), *BARS[shown])
    assert any(re.search(shown, line) for line in lines), lines
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("shown", BARS)
def test_nothing_is_drawn_where_there_is_no_terminal(shown):
    """Also where colours are forced, as continuous integration may."""
    assert drawn(io.StringIO(), *BARS[shown]) == []


def test_nothing_is_drawn_on_a_dumb_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    assert drawn(Terminal(), identifying, (Step.training(EPOCHS[0]),)) == []


def test_words_say_the_same():
    assert [str(Step.training(state)) for state in EPOCHS] == [
        "Training members: epoch 12 of 50, loss 0.213, coverage 94.1% of what it has not seen",
        "Training noise: epoch 1 of 50, loss -1.5",
    ]
    assert str(Step("Identifying Fx", 0, 6)) == "Identifying Fx"
