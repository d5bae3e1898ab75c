# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The reliability diagram: what counts as a name, how names are grouped, and what is drawn."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from blind.cases import NULL, SINGLE, Hidden
from blind.scoring import wilson
from reliability_diagram import IMAGES, Named, diagram, groups, named, write_diagram

SVG = "{http://www.w3.org/2000/svg}"


def result(hidden, verdict, **probabilities):
    effects = [{"name": n, "probability": p, "parameters": {}} for n, p in probabilities.items()]
    return {
        "seal": hidden.sealed(),
        "result": {"verdict": verdict, "effects": effects, "ambiguous": []},
        "left": None,
        "rollouts": None,
    }


DRAG = Hidden(SINGLE, ("rotor_drag",), 1.0, 0)
RESULTS = [
    result(DRAG, "effects", rotor_drag=0.95, tether=1.0),
    result(DRAG, "unknown", wind=0.99),
    result(Hidden(NULL, (), 0.0, 0), "effects", inertia=0.97),
    result(Hidden(NULL, (), 0.0, 1), "none"),
]


def test_names_of_the_verdict_effects_count_and_no_others():
    assert named(RESULTS) == [Named(0.95, True), Named(1.0, False), Named(0.97, False)]


def test_groups_hold_every_name_once():
    names = [Named(value, True) for value in (0.0, 0.3, 0.5, 0.9, 0.95, 0.99, 0.9995, 1.0)]
    found = groups(names)
    assert [group.of for group in found] == [3, 1, 2, 0, 2]
    assert found[2].said == pytest.approx(0.97)
    assert found[3].said == 0.0
    assert [group.words for group in found][-1] == "99.9 – 100 %"


def test_shares_intervals_and_counts_are_drawn(tmp_path):
    write_diagram(tmp_path / "one.svg", RESULTS, "Two hands")
    text = (tmp_path / "one.svg").read_text()
    assert text == diagram(named(RESULTS), "Two hands")
    root = ET.fromstring(text)
    texts = [element.text for element in root.iter(f"{SVG}text")]
    assert {"Two hands", "1 / 2", "0 / 1", "0 / 0"} <= set(texts)
    heights = {element.text: float(element.get("y")) - 4.5 for element in root.iter(f"{SVG}text")}
    top, bottom = heights["100 %"], heights["0 %"]
    half, none = (float(circle.get("cy")) for circle in root.iter(f"{SVG}circle"))
    assert half == pytest.approx(0.5 * (top + bottom), abs=0.1)
    assert none == pytest.approx(bottom, abs=0.1)
    bars = [line for line in root.iter(f"{SVG}line") if line.get("stroke-width") == "3"]
    low, high = wilson(1, 2)
    drawn = [(bottom - float(bars[0].get(end))) / (bottom - top) for end in ("y1", "y2")]
    assert drawn == pytest.approx([low, high], abs=1e-3)


@pytest.mark.parametrize("name", ["reliability-blind.svg", "reliability-independent.svg"])
def test_committed_diagrams_are_on_the_page(name):
    assert ET.parse(IMAGES / name).getroot().tag == f"{SVG}svg"
    assert f"(images/{name})" in (IMAGES.parent / "discovery.md").read_text(encoding="utf-8")
