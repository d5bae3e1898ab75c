# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of figures: panels in a grid, and every kind of layer drawn by the page's script."""

from __future__ import annotations

import re

from quadpi_core.report import ASSETS
from quadpi_core.report.figure import DASHES, Layer, Panel, Scale, over_grid


def test_panels_fill_rows_from_the_left():
    panels = [Panel([], Scale(str(k)), Scale(), f"title {k}", [f"note {k}"]) for k in range(5)]
    placed = over_grid(panels, 2)
    assert [(panel.row, panel.column) for panel in placed] == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)]
    assert [(p.title, p.notes, p.x.title) for p in placed] == [
        (f"title {k}", [f"note {k}"], str(k)) for k in range(5)
    ]


def test_the_script_draws_every_kind_of_layer_and_dash():
    script = (ASSETS / "layers.js").read_text()
    for layer in Layer.__subclasses__():
        assert re.search(rf"^  {layer.kind}\(one, layer\) \{{", script, re.MULTILINE), layer
        assert re.search(rf"\b{layer.kind}: ", script), layer
    (dashes,) = re.findall(r"DASHES = \{(.*?)\}", script)
    assert set(re.findall(r'(\w+|""): "', dashes)) == {dash or '""' for dash in DASHES}
