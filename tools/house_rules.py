# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Check the house rules of CONTRIBUTING.md that no linter knows, and print the figures of the code's size.

Run by `make lint`. File names are unique over both packages, so that a name finds one file. A function
of the core takes at most eight parameters, because more of them are a record without a name; ruff limits
those of Python. Its sines and exponentials are its own, since those of a C library differ by processor.
Each room has tests in its folder of test/, so that a change finds them. CONTRIBUTING.md has a budget of lines
and files for each room, one of words for docs/, and a line for each package that users must install:
nothing grows unseen.
"""

from __future__ import annotations

import re
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("quadpi_core", "quadpi_ros")
KERNEL_PARAMETERS_MAX = 8
CORE_LINES_MAX = 400
DOCS_WORDS_MAX = 25_000
# Rows of the tables of CONTRIBUTING.md: rooms, lines, files, goal; and a package with its purpose.
_BUDGET = re.compile(r"^\| `([^|]+)` \| ([\d ]+) \| (\d+) \| [\d ]+ \|$", re.MULTILINE)
# A definition: its name, and what stands between its parentheses.
_FUNCTION = re.compile(r"^[\w:&*\[\] ]*?\b(\w+)\(([^(){};]*)\)(?: const)? \{", re.MULTILINE)
# Functions of a C library, whose results differ by library and processor: elementary.hpp has our own.
_OF_C_LIBRARY = re.compile(
    r"(?<![\w.>])(?:std::|::)?((?:a?(?:sin|cos|tan)h?|atan2|exp2?|expm1|log(?:2|10|1p)?|pow|cbrt|hypot|erfc?)f?)\("
)
_REQUIRED = re.compile(r"^\| ([\w.-]+) \| [^|]+ \|$", re.MULTILINE)


def sources() -> list[Path]:
    """The modules of both packages."""
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def core_sources() -> list[Path]:
    """The files of the compiled core and its bindings."""
    return sorted(path for path in (ROOT / "core").rglob("*.[ch]pp"))


def repeated_names(paths: list[Path]) -> Iterator[str]:
    """Modules of the same name in different folders."""
    places: dict[str, list[Path]] = defaultdict(list)
    for path in paths:
        if path.stem not in {"__init__", "__main__"}:
            places[path.stem].append(path)
    for name, found in places.items():
        if len(found) > 1:
            yield f"{name}.py: {', '.join(str(path.relative_to(ROOT)) for path in found)}"


def wide_kernels(paths: list[Path]) -> Iterator[str]:
    """Functions of the core that take more parameters than the rules allow; bindings take single arrays."""
    for path in paths:
        if path.suffix == ".hpp":
            for name, parameters in _FUNCTION.findall(re.sub(r"<[^<>;]*>", "", path.read_text())):
                count = len(parameters.split(",")) if parameters.strip() else 0
                if count > KERNEL_PARAMETERS_MAX:
                    yield f"{path.relative_to(ROOT)}: {name} takes {count}"


def functions_of_c_library(paths: list[Path]) -> Iterator[str]:
    """Elementary functions of the core that are those of a C library."""
    for path in paths:
        for number, line in enumerate(path.read_text().splitlines(), start=1):
            for name in _OF_C_LIBRARY.findall(line.partition("//")[0]):
                yield f"{path.relative_to(ROOT)}:{number}: {name}"


def room_of(path: Path) -> str:
    """The room of a module; the package itself for a file in none."""
    parts = path.relative_to(ROOT).parts
    if parts[0] == "core":
        return "core"
    return parts[1] if len(parts) > 2 else parts[0]


def untested_rooms(paths: list[Path]) -> Iterator[str]:
    """Rooms without a test file in their folder of test/."""
    for room in sorted({room_of(path) for path in paths}):
        if not any((ROOT / "test").rglob(f"{room.removeprefix('quadpi_')}/test_*.py")):
            yield room


def over_budget(paths: list[Path]) -> Iterator[str]:
    """Rooms with more lines or files than their budget, or without one."""
    rooms: dict[str, list[int]] = defaultdict(list)
    for path in paths:
        rooms[room_of(path)].append(path.read_text().count("\n"))
    for names, *most in _BUDGET.findall((ROOT / "CONTRIBUTING.md").read_text()):
        lengths = [length for name in names.split("`, `") for length in rooms.pop(name, [])]
        allowed = [int(number.replace(" ", "")) for number in most]
        for found, budget, what in zip(
            (sum(lengths), len(lengths)), allowed, ("lines", "files"), strict=True
        ):
            if found > budget:
                yield f"{names.replace('`', '')}: {found} {what}, {budget} allowed"
    yield from (f"{room}: has no budget" for room in rooms)


def long_files(paths: list[Path]) -> Iterator[str]:
    """Files of more lines than the rules allow."""
    for path in paths:
        lines = path.read_text().count("\n")
        if lines > CORE_LINES_MAX:
            yield f"{path.relative_to(ROOT)}: {lines}"


def long_documents() -> Iterator[str]:
    """The words of docs/, where they are more than the rules allow."""
    words = sum(len(page.read_text().split()) for page in (ROOT / "docs").glob("*.md"))
    if words > DOCS_WORDS_MAX:
        yield f"docs: {words}"


def unlisted_packages() -> Iterator[str]:
    """Packages that users have to install and that CONTRIBUTING.md does not list, or the other way round."""
    (required,) = re.findall(
        r"^dependencies = \[\n(.*?)^\]", (ROOT / "pyproject.toml").read_text(), re.M | re.S
    )
    wanted = set(re.findall(r'^    "([\w.-]+)', required, re.M))
    yield from sorted(wanted ^ set(_REQUIRED.findall((ROOT / "CONTRIBUTING.md").read_text())))


def main() -> int:
    """Print the figures; 1 where a rule is broken."""
    paths = sources()
    texts = [path.read_text() for path in paths]
    broken = False
    print(f"files {len(paths)}, lines {sum(text.count(chr(10)) for text in texts)}")
    print(f"dict[str, Any] and Mapping[str, Any]: {sum(text.count('[str, Any]') for text in texts)}")
    for rule, found in (
        (
            f"functions of more than {KERNEL_PARAMETERS_MAX} parameters in the core",
            wide_kernels(core_sources()),
        ),
        ("elementary functions of a C library in the core", functions_of_c_library(core_sources())),
        ("file names used twice", repeated_names(paths)),
        ("rooms without tests in their folder", untested_rooms(paths)),
        ("budgets of rooms exceeded", over_budget([*paths, *core_sources()])),
        (f"files of the core of more than {CORE_LINES_MAX} lines", long_files(core_sources())),
        (f"documents of more than {DOCS_WORDS_MAX} words", long_documents()),
        ("required packages without a line in CONTRIBUTING.md, or no longer required", unlisted_packages()),
    ):
        lines = list(found)
        broken |= bool(lines)
        print(f"{rule}: {len(lines)}")
        for line in lines:
            print(f"  {line}")
    return int(broken)


if __name__ == "__main__":
    sys.exit(main())
