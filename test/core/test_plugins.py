# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Plug-ins of a folder and of installed packages; those of quadpi itself are tested by their guides."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from quadpi_core.errors import QuadpiError
from quadpi_core.plugins import Plugins, names_in

GROUP = "quadpi.test_tunes"
TUNE = "from test_tunes_class import Tune\n"


@dataclass(frozen=True)
class Tune:
    name: str


class TuneError(QuadpiError):
    pass


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package `tunes` with two files of plug-ins and a private one."""
    place = tmp_path / "source" / "tunes"
    place.mkdir(parents=True)
    (place / "__init__.py").touch()
    (place / "slow_waltz.py").write_text(f"{TUNE}WALTZ = Tune('slow-waltz')\nSECOND = Tune('second')\n")
    (place / "air.py").write_text(f"{TUNE}from tunes.slow_waltz import SECOND\nAIR = Tune('air')\n")
    (place / "_shared.py").write_text("raise RuntimeError\n")
    monkeypatch.syspath_prepend(place.parent)
    monkeypatch.setitem(sys.modules, "test_tunes_class", sys.modules[__name__])
    yield place
    for name in [name for name in sys.modules if name.partition(".")[0] in {"tunes", "others_tunes"}]:
        del sys.modules[name]


@pytest.fixture
def plugins(folder: Path) -> Plugins[Tune]:
    return Plugins("tune", importlib.import_module(folder.name), GROUP, Tune, TuneError)


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Install a package with one module and its entry points."""

    def package(name: str, content: str, *entries: str) -> None:
        site = tmp_path / name
        information = site / f"{name}-2.1.dist-info"
        information.mkdir(parents=True)
        (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 2.1\n")
        (information / "entry_points.txt").write_text("\n".join((f"[{GROUP}]", *entries)))
        (site / "others_tunes").mkdir()
        (site / "others_tunes" / "__init__.py").touch()
        (site / "others_tunes" / "jig.py").write_text(TUNE + content)
        monkeypatch.syspath_prepend(site)

    return package


def test_names_are_known_without_an_import(plugins: Plugins[Tune], install: Callable[..., None]) -> None:
    install("a-package", "", "jig = others_tunes.not_there")
    assert names_in(plugins.folder) == ("air", "slow-waltz")
    assert plugins.names() == ("air", "slow-waltz", "jig")
    assert not {"tunes.air", "tunes.slow_waltz", "others_tunes"} & set(sys.modules)


def test_one_is_imported_by_its_name_alone(plugins: Plugins[Tune]) -> None:
    waltz = plugins.named("slow-waltz")
    assert waltz == Tune("slow-waltz")
    assert "tunes.air" not in sys.modules
    assert plugins.named("second") is None


def test_all_of_them_in_the_order_of_files_then_packages(
    plugins: Plugins[Tune], install: Callable[..., None]
) -> None:
    install(
        "a-package", "A, B = Tune('jig'), Tune('reel')", "reel = others_tunes.jig:B", "jig = others_tunes.jig"
    )
    assert [tune.name for tune in plugins.all()] == [
        *("second", "air"),
        *("slow-waltz", "second"),
        *("jig", "reel"),
        "reel",
    ]
    # What a file imports from another is no second declaration.
    assert sorted(plugins.by_name()) == ["air", "jig", "reel", "second", "slow-waltz"]


@pytest.mark.parametrize(
    ("content", "entry", "message"),
    [
        ("", "others_tunes.reel", "(others_tunes.reel): cannot be imported: ModuleNotFoundError: No module"),
        ("\n1 / 0", "others_tunes.jig:A", "jig.py, line 3: ZeroDivisionError: division by zero"),
        ("A = (", "others_tunes.jig:A", "SyntaxError: '(' was never closed (jig.py, line 2)"),
        ("B = 1", "others_tunes.jig:A", "AttributeError: module 'others_tunes.jig' has no attribute 'A'"),
        ("A = 1", "others_tunes.jig:A", "(others_tunes.jig:A): there is no Tune"),
        ("A = 1", "others_tunes.jig", "(others_tunes.jig): there is no Tune"),
    ],
)
def test_a_broken_one_is_one_line_with_package_and_file(
    plugins: Plugins[Tune], install: Callable[..., None], content: str, entry: str, message: str
) -> None:
    install("a-package", content, f"jig = {entry}")
    for refused in (lambda: plugins.named("jig"), lambda: list(plugins.all()), plugins.by_name):
        with pytest.raises(TuneError, match=re.escape(message)) as caught:
            refused()
        assert str(caught.value).startswith("tune `jig` of a-package 2.1 (others_tunes.")
        assert "\n" not in str(caught.value)
    assert plugins.named("air") == Tune("air")


def test_a_broken_file_of_the_folder_too(plugins: Plugins[Tune], folder: Path) -> None:
    (folder / "reel.py").write_text("raise ValueError('two\\nlines')\n")
    message = (
        f"tune `reel` of tunes (tunes.reel): cannot be imported: {folder / 'reel.py'}, line 1: ValueError"
    )
    with pytest.raises(TuneError, match=re.escape(f"{message}: two lines")):
        plugins.named("reel")


def test_a_name_of_its_file_that_nothing_in_it_has(plugins: Plugins[Tune], folder: Path) -> None:
    (folder / "reel.py").write_text(f"{TUNE}A = Tune('jig')\n")
    with pytest.raises(TuneError, match=r"tune `reel` of tunes \(tunes.reel\): nothing there has that name"):
        plugins.named("reel")


def test_two_of_one_name_are_refused_with_both_places(
    plugins: Plugins[Tune], install: Callable[..., None]
) -> None:
    install("a-package", "A = Tune('air')", "air = others_tunes.jig:A")
    message = "declared twice: `air` of tunes (tunes.air) and `air` of a-package 2.1 (others_tunes.jig:A)"
    for refused in (lambda: plugins.named("air"), lambda: list(plugins.all()), plugins.by_name):
        with pytest.raises(TuneError, match=re.escape(message)):
            refused()
    assert plugins.named("slow-waltz") == Tune("slow-waltz")


def test_so_are_two_declarations_of_one_name(plugins: Plugins[Tune], install: Callable[..., None]) -> None:
    install("a-package", "A = Tune('second')", "jig = others_tunes.jig")
    message = "`second` is declared twice: `air` of tunes (tunes.air) and `jig` of a-package 2.1 ("
    with pytest.raises(TuneError, match=re.escape(message)):
        plugins.by_name()
