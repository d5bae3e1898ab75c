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
    nearest,
    parse_config,
    read_config,
)
from quadpi_core.errors import QuadpiError, VehicleError
from quadpi_core.frames import Array
from quadpi_core.paths import config_directory


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


# YAML of others: what a number is, what is refused, and how a file is found by name.


@pytest.fixture
def yaml(tmp_path):
    """yaml(text): what such a file holds."""

    def read(text):
        (tmp_path / "file.yaml").write_text(text)
        return read_config("vehicle", tmp_path / "file.yaml", VehicleError)[1]

    return read


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-17", -17),
        ("010", 10),
        ("1.5", 1.5),
        ("1e-3", 1e-3),
        (".5", 0.5),
        ("+2.", 2.0),
        ("!!float 3", 3.0),
        ("true", True),
        ("Off", False),
        ("~", None),
        ("", None),
        ("1:30", "1:30"),
        ("0x10", "0x10"),
        ("1_000", "1_000"),
        ("2024-01-01", "2024-01-01"),
        ("<<", "<<"),
        ("=", "="),
        ("'1'", "1"),
        ("!!str 1", "1"),
    ],
)
def test_values_of_yaml(yaml, text, value):
    found = yaml(f"a: {text}\n")["a"]
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    "text",
    [
        'a: !!int ""',
        'a: !!float ""',
        "a: !!int 1:30",
        "a: !!bool x",
        "a: !!int [1]",
        "a: !!map [1]",
        "a: !!timestamp 2024-01-01",
        "a: !!python/object:os.system x",
        "a: !!binary x",
        "a: &a [*a]",
        "a: 1e31",
        "a: " + "9" * 33,
        "a: 1\na: 2",
        "[1]: 2",
        "- " * 5000,
        "a: \x07",
    ],
)
def test_what_is_no_plain_yaml_is_refused(yaml, text):
    with pytest.raises(VehicleError, match=r"file\.yaml: not a readable YAML file: ") as refused:
        yaml(text)
    assert len(str(refused.value)) < 2000


def test_aliases_may_repeat_but_not_explode(yaml):
    assert yaml("a: &a {x: 1}\nb: *a\nc: [*a, *a]")["c"] == [{"x": 1}, {"x": 1}]
    layers = "".join(f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]\n" for n in range(1, 9))
    with pytest.raises(VehicleError, match="more than 100000 entries, with every alias expanded"):
        yaml(f"l0: &l0 [x]\n{layers}")


@pytest.mark.parametrize("number", ["1e30", "-1e30", "1e-30", "0", "1" + "0" * 30])
def test_numbers_up_to_the_largest_physical_one_are_read(yaml, number):
    assert float(yaml(f"a: {number}")["a"]) == float(number)


@pytest.mark.parametrize(
    "number", ["1.01e30", "0.99e-30", "-1.01e30", "2" + "0" * 30, "9" * 400, "-" + "9" * 5000]
)
def test_numbers_beyond_any_physical_one_are_refused(yaml, number):
    with pytest.raises(VehicleError, match=r"numbers must be from 1e-30 to 1e\+30, or 0"):
        yaml(f"a: {number}")


def test_as_many_entries_as_any_file_needs_are_read(yaml):
    """A list of 998 numbers, 98 aliases of it, and numbers up to 100 000 entries, keys and lists included."""

    def text(more):
        ones = ("1," * 998, "*a," * 98, "1," * more)
        return "a: &a [{}]\nb: [{}]\nc: [{}]\n".format(*ones)

    assert len(yaml(text(1093))["c"]) == 1093
    with pytest.raises(VehicleError, match="more than 100000 entries"):
        yaml(text(1094))


def test_a_file_is_found_by_name_or_path(tmp_path):
    own, data = read_config("vehicle", "bebop2", VehicleError)
    assert own == config_directory() / "vehicles" / "bebop2.yaml"
    (tmp_path / "bebop2.yml").write_bytes(own.read_bytes())
    assert read_config("vehicle", tmp_path / "bebop2.yml", VehicleError) == (tmp_path / "bebop2.yml", data)
    assert read_config("noise", "paper", VehicleError)[0] == config_directory() / "noise" / "paper.yaml"


def test_an_unknown_name_lists_the_known_and_asks_for_the_nearest():
    expected = r"bebop3\.yaml: no such vehicle file; known vehicles: bebop2, .*; did you mean `bebop2`\?$"
    with pytest.raises(VehicleError, match=expected):
        read_config("vehicle", "bebop3", VehicleError)
    with pytest.raises(VehicleError, match=r"or the path of a \.yaml file$"):
        read_config("vehicle", "submarine", VehicleError)


@pytest.mark.parametrize(("name", "found"), [("payload", "payload"), ("xyz", ""), ("paylod", "payload")])
def test_the_nearest_name(name, found):
    known = ("payload", "wind", "spin_up")
    assert nearest(name, known) == (f"; did you mean `{found}`?" if found else "")
