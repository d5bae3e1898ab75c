# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Check the house rules of CONTRIBUTING.md that no linter knows, and print the figures of the code's size.

Run by `make lint`. File names are unique over both packages, so that a name finds one file; a compiled kernel
takes at most eight parameters, for more of them are a record that has no name yet.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("quadpi_core", "quadpi_ros")
KERNEL_PARAMETERS_MAX = 8
# Entry points of the command line have one parameter per option.
FUNCTION_PARAMETERS_MAX = 10


def sources() -> list[Path]:
    """The modules of both packages."""
    return sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def repeated_names(paths: list[Path]) -> Iterator[str]:
    """Modules of the same name in different folders."""
    places: dict[str, list[Path]] = defaultdict(list)
    for path in paths:
        if path.stem not in {"__init__", "__main__"}:
            places[path.stem].append(path)
    for name, found in places.items():
        if len(found) > 1:
            yield f"{name}.py: {', '.join(str(path.relative_to(ROOT)) for path in found)}"


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """How many parameters a caller can give, `self` apart."""
    listed = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return len([one for one in listed if one.arg not in {"self", "cls"}])


def is_kernel(function: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether numba compiles the function."""
    return any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)


def long_signatures(paths: list[Path]) -> tuple[list[str], list[str]]:
    """Kernels, and other functions, of more parameters than the rules allow."""
    kernels, others = [], []
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
                continue
            count = parameters(node)
            place = f"{path.relative_to(ROOT)}:{node.lineno}: {node.name} takes {count}"
            if is_kernel(node) and count > KERNEL_PARAMETERS_MAX:
                kernels.append(place)
            elif count > FUNCTION_PARAMETERS_MAX:
                others.append(place)
    return kernels, others


def main() -> int:
    """Print the figures; 1 where a rule is broken."""
    paths = sources()
    texts = [path.read_text() for path in paths]
    kernels, others = long_signatures(paths)
    names = list(repeated_names(paths))
    print(f"files {len(paths)}, lines {sum(text.count(chr(10)) for text in texts)}")
    print(f"dict[str, Any] and Mapping[str, Any]: {sum(text.count('[str, Any]') for text in texts)}")
    print(f"functions of more than {FUNCTION_PARAMETERS_MAX} parameters: {len(others)}")
    for line in others:
        print(f"  {line}")
    for rule, broken in (
        (f"compiled kernels of more than {KERNEL_PARAMETERS_MAX} parameters", kernels),
        ("file names used twice", names),
    ):
        print(f"{rule}: {len(broken)}")
        for line in broken:
            print(f"  {line}")
    return 1 if kernels or names else 0


if __name__ == "__main__":
    sys.exit(main())
