# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One name for each quantity, everywhere."""

from __future__ import annotations

from quadpi_core.flight import AXES
from quadpi_core.inputs import INPUT_NAMES
from quadpi_core.monitor.alarm_log import AXIS_WORDS, INPUT_WORDS, piloted_first
from quadpi_core.view.view_server import PAGE_FOLDER


def test_every_input_and_axis_has_a_name_of_its_own():
    assert tuple(INPUT_WORDS) == INPUT_NAMES
    assert tuple(AXIS_WORDS) == AXES
    assert len({(words.name, words.angle) for words in INPUT_WORDS.values()}) == len(INPUT_NAMES)


def test_the_page_calls_axes_the_same():
    script = (PAGE_FOLDER / "view.js").read_text()
    for axis, words in AXIS_WORDS.items():
        assert f'["{axis}", "{words}", ' in script


def test_what_a_pilot_controls_comes_first():
    assert piloted_first(["mu_x", "v_in", "p", "u"]) == ["p", "mu_x", "v_in", "u"]
    assert piloted_first(["mu_x", "v_in"]) == ["mu_x", "v_in"]
