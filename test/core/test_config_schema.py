# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Configuration by declared types: what is read, and how a refusal reads."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import pytest

from quadpi_core.config_schema import (
    Flag,
    Key,
    Numbers,
    OneOf,
    Positive,
    ReadBy,
    Real,
    Section,
    Share,
    Text,
    Vector,
    Within,
    check_config,
    parse_config,
)
from quadpi_core.errors import QuadpiError
from quadpi_core.frames import Array


@dataclass(frozen=True, kw_only=True)
class Motor(Section):
    speed: Annotated[Positive, Key("speed_rad_s")]
    blades: Annotated[int, Within(2, 8)] = 2
    position_m: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Curve(Section):
    values: Annotated[Array, Numbers(3)]


def _read_curve(data: Any) -> Curve:
    curve: Curve = check_config(Curve, data)
    return curve


@dataclass(frozen=True, kw_only=True)
class Craft(Section):
    name: Text
    front: Motor
    rear: Motor | None = None
    motors: tuple[Motor, ...] = ()
    efficiency: Share = 0.5
    offset: Real = 0.0
    layout: Annotated[str, OneOf("cross", "plus")] = "cross"
    geared: Flag = False
    by_name: dict[Annotated[str, OneOf("left", "right")], Motor] = field(default_factory=dict)
    curve: Annotated[Any, ReadBy(_read_curve)] = None

    def __post_init__(self) -> None:
        if self.geared and not self.motors:
            raise ValueError("a geared craft needs `motors`")


VALID: dict[str, Any] = {"name": "a", "front": {"speed_rad_s": 1}}


def read(changes: Any) -> Craft:
    data = VALID | changes if isinstance(changes, dict) else changes
    return parse_config(Craft, data, "craft.yaml", QuadpiError)


def test_what_is_given_is_read_and_the_rest_is_default():
    craft = read({"motors": [{"speed_rad_s": 2.5, "blades": 3, "position_m": [1, 2, 3]}]})
    assert craft == Craft(
        name="a", front=Motor(speed=1.0), motors=(Motor(speed=2.5, blades=3, position_m=(1.0, 2.0, 3.0)),)
    )
    assert isinstance(craft.front.speed, float)
    np.testing.assert_array_equal(read({"curve": {"values": [1, 2, 3]}}).curve.values, [1.0, 2.0, 3.0])


def test_a_key_without_a_value_counts_as_absent_where_there_is_a_default():
    assert read({"efficiency": None, "motors": None}) == read({})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ([1], "expected keys and values, found [1]"),
        (None, "expected keys and values, found None"),
        ({"front": 3}, "front: expected keys and values, found 3"),
        ({"nane": 1}, "unknown key `nane`; known: name, front, rear, motors, efficiency, offset, layout, "),
        ({"nane": 1}, "did you mean `name`?"),
        ({7: 1}, "unknown key `7`; known: name, "),
        ({"front": {"speed": 1}}, "front: unknown key `speed`; known: speed_rad_s, blades, position_m; did "),
        # Where a type occurs again, its keys are checked again.
        ({"rear": {"speed_rad_s": 1, "blade": 3}}, "rear: unknown key `blade`; known: "),
        ({"motors": [VALID["front"], {"blade": 3}]}, "motors, entry 2: unknown key `blade`; known: "),
        ({"name": None}, "missing key `name`"),
        ({"front": {}}, "front: missing key `speed_rad_s`"),
        ({"name": ""}, "`name` must be text, found ''"),
        ({"name": 3}, "`name` must be text, found 3"),
        ({"front": {"speed_rad_s": 0}}, "front: `speed_rad_s` must be a positive number, found 0"),
        ({"front": {"speed_rad_s": True}}, "front: `speed_rad_s` must be a positive number, found True"),
        ({"front": {"speed_rad_s": "2"}}, "front: `speed_rad_s` must be a positive number, found '2'"),
        ({"offset": math.inf}, "`offset` must be a number, found inf"),
        ({"offset": math.nan}, "`offset` must be a number, found nan"),
        ({"efficiency": 1.5}, "`efficiency` must be a number from 0 to 1, found 1.5"),
        ({"efficiency": [0.5]}, "`efficiency` must be a number from 0 to 1, found [0.5]"),
        (
            {"motors": [{"speed_rad_s": 1, "blades": 2.0}]},
            "motors, entry 1: `blades` must be a whole number from 2 to 8, found 2.0",
        ),
        ({"motors": 3}, "`motors` must be a list, found 3"),
        ({"motors": [3]}, "motors, entry 1: expected keys and values, found 3"),
        (
            {"motors": [{"speed_rad_s": 1, "position_m": [1, 2]}]},
            "motors, entry 1: `position_m` must be three numbers, found [1, 2]",
        ),
        ({"layout": "plus "}, "`layout` must be one of cross, plus, found 'plus '; did you mean `plus`?"),
        ({"layout": ["plus"]}, "`layout` must be one of cross, plus, found ['plus']"),
        ({"geared": 1}, "`geared` must be true or false, found 1"),
        ({"geared": True}, "a geared craft needs `motors`"),
        ({"by_name": {"lift": VALID["front"]}}, "by_name: unknown key `lift`; known: left, right; did you "),
        ({"by_name": {"left": {}}}, "by_name.left: missing key `speed_rad_s`"),
        ({"curve": {"values": [1, 2]}}, "curve: `values` must hold 3 numbers, found [1, 2]"),
        ({"curve": {"values": [1, 2, True]}}, "curve: `values` must hold 3 numbers, found [1, 2, True]"),
        ({"curve": {"value": 1}}, "curve: unknown key `value`; known: values; did you mean `values`?"),
        ({"name": ["x"] * 999}, "`name` must be text, found ['x', 'x',"),
    ],
)
def test_refusals_name_file_and_key_and_what_was_found(changes: Any, message: str):
    with pytest.raises(QuadpiError) as caught:
        read(changes)
    text = str(caught.value)
    assert text.startswith("craft.yaml: ")
    assert message in text
    assert len(text) < 400


def test_keys_above_the_data_are_named():
    with pytest.raises(QuadpiError, match=r"^craft\.yaml: all\.front: missing key `speed_rad_s`"):
        parse_config(Motor, {}, "craft.yaml", QuadpiError, ("all", "front"))
