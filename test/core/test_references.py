# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Modules, names and files that docstrings, comments and documents refer to exist."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
_PAGES = ("README.md", "CONTRIBUTING.md", "docs/*.md", "experiments/**/*.md")
DOCUMENTS = [page for pattern in _PAGES for page in sorted(ROOT.glob(pattern))]
FOLDERS = ("quadpi_core", "quadpi_ros", "tools", "benchmarks", "examples", "experiments", "launch", "test")


@cache
def attributes(module: Path) -> frozenset[str]:
    """What a module defines, `Class.attribute` of its classes, and `name.*` of what it imports."""
    found = set()
    for statement in ast.parse(module.read_text()).body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            names = [alias.asname or alias.name for alias in statement.names]
            found |= {*names, *(f"{name}.*" for name in names)}
        found |= set(defined(statement))
        if isinstance(statement, ast.ClassDef):
            found |= {f"{statement.name}.{own}" for inner in statement.body for own in defined(inner)}
    return frozenset(found)


def defined(statement: ast.stmt) -> list[str]:
    """The names that a statement defines."""
    match statement:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.ClassDef(name=name):
            return [name]
        case ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
        case ast.Assign(targets=[target]):
            return [node.id for node in ast.walk(target) if isinstance(node, ast.Name)]
        case _:
            return []


def exists(name: str) -> bool:
    """Whether a dotted name is a folder, a module, a name in one, or an attribute of a class there."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        path, rest = ROOT.joinpath(*parts[:end]), ".".join(parts[end:])
        if path.is_dir() and not rest:
            return True
        for module in (path / "__init__.py", path.with_suffix(".py")):
            if module.is_file():
                known = attributes(module)
                return not rest or rest in known or f"{parts[end]}.*" in known
    return False


def test_dotted_names() -> None:
    files = [*DOCUMENTS, ROOT / "pyproject.toml", *(ROOT / "config").rglob("*.yaml")]
    files += [path for folder in FOLDERS[:-1] for path in (ROOT / folder).rglob("*.py")]
    # Tests also name modules that do not exist.
    files = [file for file in files if file.parent != ROOT / "experiments" / "test"]
    pattern = r"\bquadpi_(?:core|ros)(?:\.(?!_)[A-Za-z]\w*)+"
    stale = {
        f"{file.relative_to(ROOT)}: {name}"
        for file in files
        for name in set(re.findall(pattern, file.read_text()))
        if not exists(name)
    }
    assert not stale


def test_files_in_documents() -> None:
    known = {path.name for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")}
    for page in DOCUMENTS:
        text = page.read_text()
        # What stands for any file, and what the reader of a guide writes.
        others = {"FILE.py", "test_FILE.py", *re.findall(r"Saved\s+as\s+`(\w+\.py)`", text)}
        assert set(re.findall(r"\b\w+(?:\.launch)?\.py\b", text)) <= known | others, page.name


def test_rooms_of_the_architecture() -> None:
    """Its table has every folder, and the main names in each are there."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| (?!room|---)([^|]+) \| [^|]+ \|([^|]*)\|$", page, flags=re.MULTILINE)
    rooms = {path.parent.name for path in (ROOT / "quadpi_core").glob("*/__init__.py")}
    assert {room.strip("`") for room, _ in rows if "`" in room} == {*rooms, "quadpi_ros"}
    for room, names in rows:
        place = room.strip("`") if "`" in room else ""
        package = place if place == "quadpi_ros" else f"quadpi_core.{place}".strip(".")
        for name in re.findall(r"`([^`]+?)/?`", names):
            assert exists(f"{package}.{name}"), f"{room}: {name}"
    for name in re.findall(rf"`((?:{'|'.join(rooms)}|paths|records)\.\w+)`", page.partition("## Rules")[2]):
        assert exists(f"quadpi_core.{name}"), name
