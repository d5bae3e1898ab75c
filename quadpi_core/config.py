# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files under config, or of the user's own: all kinds are found and read alike."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, TypeVar

import yaml

from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.paths import config_directory

_Number = TypeVar("_Number", int, float)


def read_config(kind: str, name_or_path: str | Path, error: type[QuadpiError]) -> tuple[Path, Any]:
    """Path and content of a YAML file, by its name in the folder of its kind or by its path.

    Args:
        kind: "vehicle", "mapping", "adapter", "candidate", "scenario" or "noise".
        name_or_path: a path if it ends in .yaml or .yml, else a name.
        error: class of the error to raise.

    Raises:
        QuadpiError: of that class, naming the file that is absent or no YAML.
    """
    path = Path(name_or_path)
    own = config_directory() / (kind if kind == "noise" else f"{kind}s")
    if not is_config_path(name_or_path):
        path = own / f"{name_or_path}.yaml"
    try:
        return path, yaml.load(path.read_text(), _Loader)
    except FileNotFoundError:
        known = sorted(file.stem for file in own.glob("*.yaml"))
        raise error(
            f"{path}: no such {kind} file; known {kind}s: {', '.join(known)}, or the path of a .yaml file"
            f"{nearest(path.stem, known)}"
        ) from None
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as reason:
        raise error(f"{path}: not a readable YAML file: {one_line(reason)}") from reason


def is_config_path(name_or_path: str | Path) -> bool:
    """Whether it is the path of a file, and not a name in config."""
    return Path(name_or_path).suffix in {".yaml", ".yml"}


# No quantity is larger, or smaller unless it is zero; powers and products of such numbers stay finite.
_LARGEST = 1e30


class _Loader(yaml.SafeLoader):
    """Refuses numbers that no quantity has, and a key that stands twice: YAML would take the last."""

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """See SafeLoader."""
        return self._sized(super().construct_yaml_int(node), node)

    def construct_yaml_float(self, node: yaml.ScalarNode) -> float:
        """See SafeLoader."""
        return self._sized(super().construct_yaml_float(node), node)

    def _sized(self, value: _Number, node: yaml.ScalarNode) -> _Number:
        """The number itself; what is no number, or infinite, is judged where its key is known."""
        if 0 < abs(value) < 1.0 / _LARGEST or _LARGEST < abs(value) < math.inf:
            problem = f"numbers must be from {1.0 / _LARGEST:g} to {_LARGEST:g}, or 0"
            raise yaml.constructor.ConstructorError(problem=problem, problem_mark=node.start_mark)
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """See SafeLoader."""
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                problem = f"the key `{key.value}` stands twice"
                raise yaml.constructor.ConstructorError(problem=problem, problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
_Loader.add_constructor("tag:yaml.org,2002:float", _Loader.construct_yaml_float)
# YAML 1.1 takes 1e-3 and 1.5e3 for text: its numbers have a point, and a sign in the exponent.
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
    list("-+.0123456789"),
)


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name most like the one that was not found, as a question for its error; else nothing."""
    similar = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean `{similar[0]}`?" if similar else ""
