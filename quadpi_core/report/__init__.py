# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Results to look at: tables for the terminal, figures, and a self-contained page."""

from pathlib import Path

# Style sheets and scripts of pages; the live page serves those that it shares with the written ones.
ASSETS = Path(__file__).with_name("assets")
SHARED_ASSETS = ("uPlot.css", "look.css", "uPlot.js", "drawing.js", "space.js")
