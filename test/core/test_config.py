# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""YAML of others: what a number is, what is refused, and how a file is found by name."""

import pytest

from quadpi_core.config_schema import nearest, read_config
from quadpi_core.errors import VehicleError
from quadpi_core.paths import config_directory


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
