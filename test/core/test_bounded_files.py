# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Files of others: how much of one is read, and which JSON is refused."""

import os

import pytest

from quadpi_core.paths import CONFIG_BYTES_MAX, parse_json, read_bounded


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
