# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Names that a terminal, a markup or a file system would make something else of."""

import shutil

import pytest

NAMES = ("[red]x", "[bold", ":smile:", "a b\tc", "ünï", "$(x)", "%s{}")


@pytest.mark.parametrize("name", NAMES)
def test_info_prints_a_name_as_it_is(quadpi, bags, tmp_path, name):
    path = tmp_path / f"{name}.mcap"
    shutil.copy(bags[0], path)
    shown = quadpi("info", path)
    assert shown.status == 0
    assert name.replace("\t", " ").split()[0] in shown.output
    path.write_bytes(b"none")
    refused = quadpi("info", path)
    assert refused.status == 2
    assert refused.errors.count("\n") == 1
    assert name.replace("\t", "\\t") in refused.errors


def test_import_prints_a_name_as_it_is(quadpi, bags, tmp_path):
    path = tmp_path / "[red]x.mcap"
    shutil.copy(bags[0], path)
    done = quadpi("import", path, "--vehicle", "neurobem", "-o", tmp_path / "[blue]bags")
    assert done.status == 0, done
    assert "[blue]bags/[red]x.mcap" in done.output.replace("\n", "")


@pytest.mark.parametrize("command", [("info",), ("import", "--vehicle", "bebop2", "-o", "out")])
def test_a_name_longer_than_a_file_system_takes(quadpi, tmp_path, command):
    refused = quadpi(command[0], tmp_path / ("x" * 300), *command[1:])
    assert refused.status == 2
    assert refused.errors.count("\n") == 1
    assert "File name too long" in refused.errors
