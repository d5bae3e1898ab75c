# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where files may lie, and temporary folders that end with the block that asked for them."""

from __future__ import annotations

import os
from contextlib import nullcontext

import numpy as np
import pytest

from quadpi_core.paths import (
    CONFIG_BYTES_MAX,
    finite_json,
    parse_json,
    read_bounded,
    resolved_below,
    scratch_folder,
    whole_output,
)


@pytest.fixture
def place(tmp_path, monkeypatch):
    """models/mine, models/link → outside, outside, linked → models; the working folder is models."""
    for name in ("models/mine", "outside", "models-of-others"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "models" / "link").symlink_to(tmp_path / "outside")
    (tmp_path / "linked").symlink_to(tmp_path / "models")
    monkeypatch.chdir(tmp_path / "models")
    return tmp_path


@pytest.mark.parametrize(
    "path", ["mine", "models/mine", "models/../models/mine", "linked/mine", "models/new"]
)
def test_inside(place, path):
    found = resolved_below(path if path == "mine" else place / path, [place / "models"])
    assert found == place / "models" / path.rsplit("/", maxsplit=1)[-1]


@pytest.mark.parametrize("path", ["outside", "models/../outside", "models/link", "models-of-others", "", "/"])
def test_outside(place, path):
    assert resolved_below(place / path, [place / "models"]) is None


def test_either_of_several_folders_and_links_to_them(place):
    folders = [place / "outside", place / "linked"]
    assert resolved_below(place / "models" / "mine", folders) == place / "models" / "mine"
    assert resolved_below(place / "models" / "link", folders) == place / "outside"


@pytest.mark.parametrize("error", [None, ValueError, KeyboardInterrupt])
def test_a_temporary_folder_is_gone_after_its_block(tmp_path, error):
    with pytest.raises(error) if error else nullcontext(), scratch_folder(tmp_path) as folder:
        (folder / "below").mkdir()
        assert [path.name for path in tmp_path.iterdir()] == [folder.name]
        if error:
            raise error
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("function", ["mkdir", "rmdir"])
def test_an_interrupt_as_it_is_made_or_removed_leaves_nothing(tmp_path, monkeypatch, function):
    call, interrupted = getattr(os, function), []

    def interrupt(*args, **options):
        if interrupted:
            return call(*args, **options)
        interrupted.append(args)
        if function == "mkdir":
            call(*args, **options)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, function, interrupt)
    with pytest.raises(KeyboardInterrupt), scratch_folder(tmp_path):
        pass
    assert interrupted
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", [False, True])
def test_a_folder_replaces_another_as_a_whole(tmp_path, there):
    if there:
        (tmp_path / "model").mkdir()
        (tmp_path / "model" / "old").touch()
    with whole_output(tmp_path / "model") as made:
        made.mkdir()
        (made / "new").touch()
    assert [path.name for path in sorted(tmp_path.rglob("*"))] == ["model", "new"]


def test_json_has_plain_numbers_and_null_for_what_is_not_finite():
    value = {
        "a": (1.5, np.float64(2.5), float("nan")),
        "b": [{"c": np.int64(3), "d": np.bool_(True)}, -np.inf, "e"],
    }
    assert finite_json(value) == {"a": [1.5, 2.5, None], "b": [{"c": 3, "d": True}, None, "e"]}
    assert type(finite_json(np.int64(3))) is int


# Files of others: how much of one is read, and which JSON is refused.


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
