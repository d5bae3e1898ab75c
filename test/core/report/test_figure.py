# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Records of figures: every kind of layer and of dash is drawn by the page's scripts."""

from __future__ import annotations

import re

from quadpi_core.report import ASSETS
from quadpi_core.report.page import DASHES, Layer


def test_the_scripts_draw_every_kind_of_layer_and_dash():
    script = (ASSETS / "figures.js").read_text()
    for layer in Layer.__subclasses__():
        painted = re.search(rf"^  {layer.kind}\(c, layer\) \{{", script, re.MULTILINE)
        assert painted or f'layer.kind === "{layer.kind}"' in script, layer
        assert re.search(rf"\b{layer.kind}: ", script), layer
    (dashes,) = re.findall(r"DASHES = \{(.*?)\}", (ASSETS / "drawing.js").read_text())
    assert set(re.findall(r'(\w+|""): \[', dashes)) == {dash or '""' for dash in DASHES}
