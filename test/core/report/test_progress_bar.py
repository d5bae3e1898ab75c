# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Bars: what they show on a terminal, that they fit, and that nothing is drawn elsewhere."""

from __future__ import annotations

import io
import re
from types import SimpleNamespace

import pytest
from rich.console import Console

from quadpi_core.models.ensemble import training_progress
from quadpi_core.parallel import Progress
from quadpi_core.report.table import progress_bar

EPOCH = SimpleNamespace(stage="members", epoch=12, epochs=50, loss=0.2134, coverage=0.9412)
FIRST = SimpleNamespace(stage="noise", epoch=1, epochs=50, loss=-1.5, coverage=None)

BARS = {
    "Training members .* 12 of 50 epochs · loss 0.213 · coverage 94.1% ": [training_progress(EPOCH)],
    "Training noise .* 1 of 50 epochs · loss -1.5 ": [training_progress(EPOCH), training_progress(FIRST)],
    "Identifying Fz .* 2 of 6 ": [Progress("Identifying Fz", 2, 6)],
    "Reading flights .* 3 of 7 ": [Progress("Reading flights", 2, 7), Progress("Reading flights", 3, 7)],
    "Flying .* 4 of 5 s · 1 of 2 flights ": [Progress("Flying", 4.2, 5.0, "s", "1 of 2 flights")],
    "Simulating .* hop ": [Progress("Simulating", note="hop")],
}


class Terminal(io.StringIO):
    """What is written to a terminal of 80 characters."""

    def isatty(self):
        return True


def drawn(file, steps):
    """What a bar leaves on a file when it ends, line by line."""
    with progress_bar(Console(file=file, width=80, force_terminal=True, color_system=None)) as report:
        for step in steps:
            report(step)
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", file.getvalue()).splitlines()


@pytest.mark.parametrize("shown", BARS)
def test_a_bar_fits_a_terminal_and_shows(shown):
    lines = drawn(Terminal(), BARS[shown])
    assert any(re.search(shown, line) for line in lines), lines
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize("shown", BARS)
def test_nothing_is_drawn_where_there_is_no_terminal(shown):
    """Also where colours are forced, as continuous integration may."""
    assert drawn(io.StringIO(), BARS[shown]) == []


def test_nothing_is_drawn_on_a_dumb_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    assert drawn(Terminal(), [training_progress(EPOCH)]) == []
