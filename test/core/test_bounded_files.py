# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""YAML and JSON of others: what a number is, what is refused, and how much may be read."""

import os

import pytest

from quadpi_core.bounded_files import CONFIG_BYTES_MAX, parse_json, read_bounded
from quadpi_core.config import read_config
from quadpi_core.errors import VehicleError


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


def test_only_files_of_bounded_size_are_read(tmp_path):
    path = tmp_path / "large.yaml"
    path.write_bytes(b"#" * CONFIG_BYTES_MAX)
    assert len(read_bounded(path, CONFIG_BYTES_MAX)) == CONFIG_BYTES_MAX
    path.write_bytes(b"#" * (CONFIG_BYTES_MAX + 1))
    with pytest.raises(ValueError, match="larger than the 256 KiB"):
        read_bounded(path, CONFIG_BYTES_MAX)
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", tmp_path):
        with pytest.raises(ValueError, match="not a file"):
            read_bounded(place, CONFIG_BYTES_MAX)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("NaN", "holds the number NaN"),
        ("[-Infinity]", "holds the number -Infinity"),
        ("1e999", "holds the number 1e999, beyond 1e\\+100"),
        ("-1e101", "beyond 1e\\+100"),
        ("1" + "0" * 400, "beyond 1e\\+100"),
        ("[" * 100_000, "nested too deeply"),
        ('{"a": 1, "a": 2}', "duplicate key `a`"),
        ("{", "Expecting property name"),
    ],
)
def test_json_that_is_refused(text, message):
    with pytest.raises(ValueError, match=message):
        parse_json(text)


def test_json_that_is_read_is_what_the_library_reads():
    text = '{"a": [1, -2.5, 1e-300, 0.1, true, null, "x"], "b": {"c": 18446744073709551616}}'
    assert parse_json(text) == {"a": [1, -2.5, 1e-300, 0.1, True, None, "x"], "b": {"c": 2**64}}
