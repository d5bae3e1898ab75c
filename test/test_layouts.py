# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Layouts of other tools: every topic and field that they name is one that the nodes publish."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from rosbags.interfaces import Nodetype

from quadpi_core.messages.definitions import typestore
from quadpi_core.messages.topics import TOPIC_TYPES
from quadpi_core.paths import config_directory
from quadpi_core.results import LEVEL_ALARM, LEVEL_OK, LEVEL_WARNING

LAYOUTS = config_directory() / "layouts"
TYPES = {f"/{topic}": name for topic, name in TOPIC_TYPES.items()} | {
    "/markers": "visualization_msgs/msg/MarkerArray"
}
WRENCHES = {
    ("/prediction", f"{member}/{kind}/{axis}")
    for member in ("measured", "predicted", "lower", "upper")
    for kind in ("force", "torque")
    for axis in "xyz"
}
WIDTHS = {("/prediction", f"relative_width[{axis}]") for axis in range(6)}
ALARM = {
    ("/extrapolation_alarm", path)
    for path in (
        "level",
        "cause_level[0]",
        "cause_level[1]",
        "cause_level[2]",
        "cause_level[3]",
        "envelope_distance",
    )
}


def kind_of(type_name: str, path: str) -> str:
    """Primitive type at a path such as `predicted/force/x` or `cause_level[2]` of a message.

    Raises:
        AssertionError: naming what the message does not have.
    """
    description: Any = (Nodetype.NAME, type_name)
    for part in path.split("/"):
        name, _, index = part.rstrip("]").partition("[")
        assert description[0] == Nodetype.NAME, f"{type_name}: {path}: nothing below {name}"
        members = dict(typestore().fielddefs[description[1]][1])
        assert name in members, f"{type_name}: {path}: {description[1]} has no {name}"
        description = members[name]
        if index:
            kind, content = description
            assert kind in (Nodetype.ARRAY, Nodetype.SEQUENCE), f"{type_name}: {path}: {name} is no array"
            description, length = content
            assert kind == Nodetype.SEQUENCE or int(index) < length, f"{type_name}: {path}: too few"
    assert description[0] == Nodetype.BASE, f"{type_name}: {path}: is no number"
    return str(description[1][0])


def foxglove() -> dict[str, Any]:
    layout: dict[str, Any] = json.loads((LAYOUTS / "foxglove.json").read_text())
    return layout


def foxglove_paths(*panels: str) -> Iterator[tuple[str, str]]:
    """Topic and field of every message path in the panels of some kinds."""
    for name, panel in foxglove()["configById"].items():
        if name.partition("!")[0] in panels:
            for path in [series["value"] for series in panel.get("paths", ())] or [panel["path"]]:
                topic, _, field = path.partition(".")
                yield topic, field.replace(".", "/")


def plotjuggler_curves() -> set[tuple[str, str]]:
    root = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()
    curves = set()
    for curve in root.iter("curve"):
        topic = max((topic for topic in TYPES if curve.attrib["name"].startswith(f"{topic}/")), key=len)
        curves.add((topic, curve.attrib["name"][len(topic) + 1 :]))
    return curves


def test_foxglove_shows_bands_alarm_and_envelope_by_fields_that_exist() -> None:
    found = set(foxglove_paths("Plot", "StateTransitions", "Indicator"))
    for topic, path in found:
        assert kind_of(TYPES[topic], path) in ("float64", "uint8")
    assert found == WRENCHES | WIDTHS | ALARM
    panels = foxglove()["configById"]
    topic, _, field = panels["RawMessages!reasons"]["topicPath"].partition(".")
    assert dict(typestore().fielddefs[TYPES[topic]][1])[field][0] == Nodetype.SEQUENCE
    assert panels["3D!flight"]["topics"].keys() <= TYPES.keys()


def test_foxglove_names_each_level_of_the_alarm() -> None:
    rules = {
        int(rule["rawValue"]): rule["label"] for rule in foxglove()["configById"]["Indicator!level"]["rules"]
    }
    assert rules == {LEVEL_OK: "OK", LEVEL_WARNING: "WARNING", LEVEL_ALARM: "ALARM"}


def test_foxglove_places_each_panel_once() -> None:
    def placed(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
            return
        assert node.keys() == {"direction", "first", "second", "splitPercentage"}
        yield from placed(node["first"])
        yield from placed(node["second"])

    layout = foxglove()
    assert sorted(placed(layout["layout"])) == sorted(layout["configById"])


def test_plotjuggler_draws_and_subscribes_to_what_exists() -> None:
    found = plotjuggler_curves()
    for topic, path in found:
        assert kind_of(TYPES[topic], path) in ("float64", "uint8")
    assert found == WRENCHES | WIDTHS | ALARM
    root = ElementTree.parse(LAYOUTS / "plotjuggler.xml").getroot()
    (selected,) = root.iter("selected_topics")
    assert set(selected.attrib["value"].split(";")) == {topic for topic, _ in found}
    for splitter in root.iter("DockSplitter"):
        assert len(splitter.attrib["sizes"].split(";")) == int(splitter.attrib["count"]) == len(splitter)


def test_rviz_displays_are_of_the_types_of_their_topics() -> None:
    manager = yaml.safe_load((LAYOUTS / "quadpi.rviz").read_text())["Visualization Manager"]
    of_display = {
        "rviz_default_plugins/Odometry": "nav_msgs/msg/Odometry",
        "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
    }
    displays = {one["Class"]: one["Topic"]["Value"] for one in manager["Displays"] if "Topic" in one}
    assert {name: TYPES[topic] for name, topic in displays.items()} == of_display
    assert manager["Global Options"]["Fixed Frame"] == "map"


@pytest.mark.parametrize(
    ("path", "complaint"),
    [
        ("predicted/force/w", "geometry_msgs/msg/Vector3 has no w"),
        ("predicted_fx", "has no predicted_fx"),
        ("relative_width[6]", "too few"),
        ("predicted[0]", "is no array"),
        ("predicted/force", "is no number"),
    ],
)
def test_a_field_that_is_gone_would_be_noticed(path: str, complaint: str) -> None:
    with pytest.raises(AssertionError, match=re.escape(complaint)):
        kind_of(TYPES["/prediction"], path)
