# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Say where the page is, and open it where somebody sits in front of a display."""

from __future__ import annotations

import os
import webbrowser
from collections.abc import Callable


def display_is_there() -> bool:
    """Whether this session has a screen."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def announce(say: Callable[[str], None], url: str, open_page: bool | None = None) -> None:
    """Say the address of the page, and open it.

    Args:
        say: prints a line.
        url: address.
        open_page: whether to open it; None where there is a display.
    """
    say(f"Page at {url} (Ctrl-C ends it)")
    if display_is_there() if open_page is None else open_page:
        webbrowser.open(url)
