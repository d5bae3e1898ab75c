# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The page is opened where there is a display, and its address is always said."""

from __future__ import annotations

import webbrowser

import pytest

from quadpi_core.view.browser import announce

URL = "http://127.0.0.1:8710/"


@pytest.mark.parametrize(
    ("display", "wish", "opened"),
    [(None, None, False), (":0", None, True), (":0", False, False), (None, True, True)],
)
def test_page_is_opened_where_somebody_looks(monkeypatch, display, wish, opened):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    if display:
        monkeypatch.setenv("DISPLAY", display)
    shown: list[str] = []
    said: list[str] = []
    monkeypatch.setattr(webbrowser, "open", shown.append)
    announce(said.append, URL, wish)
    assert URL in said[0]
    assert shown == ([URL] if opened else [])
