# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What results show in a notebook, and what is said where pandas or matplotlib is not installed."""

from __future__ import annotations

import sys

import pytest

import quadpi_core as qp
from quadpi_core.library.flight_arrays import html_table


def test_text_is_escaped_and_long_tables_are_cut():
    page = html_table("<4 flights>", ["a", "b"], [(k, "<b>") for k in range(40)])
    assert "<p>&lt;4 flights&gt;</p>" in page
    assert page.count("&lt;b&gt;") == 12
    assert "… 28 more" in page


@pytest.mark.parametrize(
    ("library", "call"),
    [
        ("pandas", lambda flights, _: flights.to_pandas()),
        ("pandas", lambda flights, model: qp.evaluate(model, flights).to_pandas()),
        ("matplotlib.pyplot", lambda flights, model: qp.evaluate(model, flights).plot()),
        ("matplotlib.pyplot", lambda flights, model: model.plot(flights)),
    ],
)
def test_without_a_library_the_extra_is_named(monkeypatch, unseen, quick, library, call):
    monkeypatch.setitem(sys.modules, library, None)
    name = library.partition(".")[0]
    with pytest.raises(qp.QuadpiError, match=f"needs {name}, which the extra `notebook` brings") as caught:
        call(unseen, quick)
    assert "\n" not in str(caught.value)
