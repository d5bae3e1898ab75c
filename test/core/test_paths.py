# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where files may lie."""

from __future__ import annotations

import pytest

from quadpi_core.paths import resolved_below


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
