# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mapping files: what must be in them, and mistakes that are named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from quadpi_core.errors import LogError
from quadpi_core.logs.mapping import UNITS, Mapping
from quadpi_core.paths import config_directory


def minimal_mapping() -> dict[str, Any]:
    return {
        "time": {"columns": ["t"], "unit": "s"},
        "body": "frd",
        "world": "ned",
        "angular_velocity": {"columns": ["p", "q", "r"], "unit": "rad/s"},
        "acceleration": {
            "columns": ["ax", "ay", "az"],
            "unit": "m/s2",
            "axes": "body",
            "gravity": "included",
        },
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed": 1}, "unknown key `speed`; known: time, body"),
        ({"body": "fru"}, "`body` must be one of flu, frd, found 'fru'"),
        (
            {"time": {"columns": ["t"], "unit": "minutes"}},
            "time: `unit` must be one of s, ms, us, ns, found 'minutes'",
        ),
        ({"wind": {"columns": list("abc")}}, "wind: missing key `unit`"),
        (
            {
                "wind": {"columns": list("abc"), "unit": "m/s", "table": "vicom"},
                "tables": {"vicon": {"time": {"columns": ["t"]}}},
            },
            "wind: no table vicom under `tables`; did you mean `vicon`?",
        ),
        ({"tables": {"vicon": {"file": "a.csv"}}}, "tables.vicon: missing key `time`"),
        (
            {"time": {"columns": ["t"], "unit": "s", "zero": 0}},
            "time: unknown key `zero`; known: columns,",
        ),
        ({"time": "t"}, "time: expected keys and values, found 't'"),
        ({"wind": {"columns": ["a", "b"], "unit": "m/s"}}, "wind: `columns` must list 3 different columns"),
        (
            {"time": {"columns": ["t"], "unit": "s", "missing": 2}},
            "time: `missing` must be a number from 0 to 1, found 2",
        ),
        (
            {"wind": {"columns": list("abc"), "unit": "m/s", "zero": 0}},
            "wind: unknown key `zero`; known: columns,",
        ),
        (
            {"wind": {"columns": list("abc"), "unit": "m/s", "axes": "body"}},
            "wind: unknown key `axes`; known",
        ),
        (
            {"attitude": {"columns": ["a", "b", "c", "d"], "form": "zyx"}},
            "attitude: `form` must be one of wxyz, xyzw, roll-pitch-yaw, found 'zyx'",
        ),
    ],
)
def test_mistakes_in_a_mapping_are_named(tmp_path: Path, change: dict[str, Any], message: str):
    path = tmp_path / "mapping.yaml"
    path.write_text(yaml.safe_dump(minimal_mapping() | change))
    with pytest.raises(LogError) as caught:
        Mapping.load(path)
    assert str(path) in str(caught.value)
    assert message in str(caught.value)


@pytest.mark.parametrize("key", ["time", "body", "world", "angular_velocity", "acceleration"])
def test_required_keys(tmp_path: Path, key: str):
    mapping = minimal_mapping()
    del mapping[key]
    path = tmp_path / "mapping.yaml"
    path.write_text(yaml.safe_dump(mapping))
    with pytest.raises(LogError, match=f"missing key `{key}`"):
        Mapping.load(path)


def test_unknown_mapping_lists_the_known():
    with pytest.raises(LogError, match=r"no such mapping file; known mappings: .*nanodrone"):
        Mapping.load("nonesuch")


@pytest.mark.parametrize("name", sorted(p.stem for p in (config_directory() / "mappings").glob("*.yaml")))
def test_every_mapping_of_the_project_loads(name: str):
    assert set(Mapping.load(name).signals) <= set(UNITS)
