# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Safe and bounded reading of YAML configuration, from the folder config or from a user's own path."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable
from copy import deepcopy
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar

import yaml

from quadpi_core import array_checks
from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.paths import CONFIG_BYTES_MAX, config_directory, read_bounded


def read_config(kind: str, name_or_path: str | Path, error: type[QuadpiError]) -> tuple[Path, Any]:
    """Path and content of a YAML file, found by its name in config's folder of its kind, or by its path.

    Args:
        kind: "vehicle", "mapping", "adapter", "candidate", "scenario" or "noise".
        name_or_path: a path if it ends in .yaml or .yml, else a name.
        error: class of the error to raise.

    Raises:
        QuadpiError: of that class, naming the file that does not exist or is not YAML.
    """
    path = array_checks.path(kind, name_or_path)
    folder = config_directory() / (kind if kind == "noise" else f"{kind}s")
    if not is_config_path(name_or_path):
        path = folder / f"{name_or_path}.yaml"
    try:
        return path, deepcopy(_parsed(read_bounded(path, CONFIG_BYTES_MAX).decode()))
    except FileNotFoundError:
        known = sorted(file.stem for file in folder.glob("*.yaml"))
        raise error(
            f"{path}: no such {kind} file; known {kind}s: {', '.join(known)}, or the path of a .yaml file"
            f"{nearest(path.stem, known)}"
        ) from None
    except RecursionError:
        raise error(f"{path}: not a readable YAML file: nested too deeply") from None
    except (OSError, ValueError, yaml.YAMLError) as reason:
        raise error(f"{path}: not a readable YAML file: {one_line(reason)}") from reason


def is_config_path(name_or_path: str | Path) -> bool:
    """Whether a text is the path of a YAML file, rather than the name of one in config."""
    return Path(name_or_path).suffix in {".yaml", ".yml"}


# Beyond any physical quantity; powers and products of such numbers stay finite.
_LARGEST = 1e30
_OF_SIZE = f"numbers must be from {1.0 / _LARGEST:g} to {_LARGEST:g}, or 0"
# Entries with every alias expanded: nested aliases grow exponentially ("billion laughs").
_NODES_MAX = 100_000
_TAG = "tag:yaml.org,2002:"
_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class _Loader(yaml.SafeLoader):
    """Accepts mappings, lists, text, decimal numbers, booleans and null, and no other tag.

    YAML 1.1 reads 1:30 as 90, 010 as 8, 2024-01-01 as a date, and 1e-3 as text; this loader reads the first
    and the third as text, the others as the decimal numbers 10 and 0.001. It refuses numbers beyond any
    physical quantity, duplicate keys (YAML would keep the last), and aliases that expand too far.
    """

    yaml_constructors: ClassVar[dict[Any, Any]] = {}
    yaml_multi_constructors: ClassVar[dict[Any, Any]] = {}
    yaml_implicit_resolvers: ClassVar[dict[Any, Any]] = {}  # type: ignore[misc]  # typed as of an instance

    def construct_document(self, node: yaml.Node) -> Any:
        """See SafeLoader."""
        _count(node, {})
        return super().construct_document(node)

    def construct_int(self, node: yaml.ScalarNode) -> int:
        """A whole decimal number."""
        self._require(_INT, node, "a whole number")
        if math.isinf(value := float(node.value)):
            raise _refused(_OF_SIZE, node)
        self._sized(value, node)
        return int(node.value)

    def construct_float(self, node: yaml.ScalarNode) -> float:
        """A decimal number; infinity and NaN pass, for the type of the key to refuse by name."""
        self._require(_FLOAT, node, "a number")
        text = node.value.lower()
        return self._sized(float(text.replace(".inf", "inf").replace(".nan", "nan")), node)

    def construct_bool(self, node: yaml.ScalarNode) -> bool:
        """True or false."""
        if not isinstance(node, yaml.ScalarNode) or node.value.lower() not in self.bool_values:
            raise _refused(f"`{node.value}` is neither true nor false", node)
        return self.bool_values[node.value.lower()]

    def _require(self, pattern: re.Pattern[str], node: yaml.ScalarNode, what: str) -> None:
        if not isinstance(node, yaml.ScalarNode) or not pattern.fullmatch(node.value):
            raise _refused(f"`{node.value}` is not {what}", node)

    def _sized(self, value: float, node: yaml.ScalarNode) -> float:
        if 0 < abs(value) < 1.0 / _LARGEST or _LARGEST < abs(value) < math.inf:
            raise _refused(_OF_SIZE, node)
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """See SafeLoader."""
        if not isinstance(node, yaml.MappingNode):
            raise _refused("expected keys and values", node)
        seen = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                raise _refused(f"duplicate key `{key.value}`", key)
            seen.add(key.value)
        return yaml.constructor.BaseConstructor.construct_mapping(self, node, deep)


def _refused(problem: str, node: yaml.Node) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(problem=problem[:200], problem_mark=node.start_mark)


def _count(node: yaml.Node, known: dict[int, int]) -> int:
    """Nodes at and below a node, every alias expanded; `known` holds 0 for a node that is being counted."""
    if id(node) in known:
        if known[id(node)] == 0:
            raise _refused("an alias of the entry that contains it", node)
        return known[id(node)]
    known[id(node)] = 0
    below: list[yaml.Node] = []
    if isinstance(node, yaml.MappingNode):
        below = [part for pair in node.value for part in pair]
    elif isinstance(node, yaml.SequenceNode):
        below = node.value
    total = 1 + sum(_count(part, known) for part in below)
    if total > _NODES_MAX:
        raise _refused(f"more than {_NODES_MAX} entries, with every alias expanded", node)
    known[id(node)] = total
    return total


for _name in ("null", "str", "seq", "map"):
    _Loader.add_constructor(f"{_TAG}{_name}", getattr(_Loader, f"construct_yaml_{_name}"))
for _name in ("bool", "int", "float"):
    _Loader.add_constructor(f"{_TAG}{_name}", getattr(_Loader, f"construct_{_name}"))
_Loader.yaml_constructors[None] = _Loader.construct_undefined
for _name, _pattern, _first in (
    ("null", re.compile(r"(~|null|Null|NULL|)$"), ["~", "n", "N", ""]),
    ("bool", re.compile(r"(yes|no|true|false|on|off)$", re.IGNORECASE), list("yYnNtTfFoO")),
    ("int", re.compile(f"({_INT.pattern})$"), list("-+0123456789")),
    ("float", re.compile(f"({_FLOAT.pattern})$"), list("-+.0123456789")),
):
    _Loader.add_implicit_resolver(f"{_TAG}{_name}", _pattern, _first)
# A command reads its vehicle file up to four times, 9 ms each.
_parsed = lru_cache(maxsize=16)(partial(yaml.load, Loader=_Loader))


def nearest(name: str, known: Iterable[str]) -> str:
    """The known name most similar to an unknown one, as the question that ends its refusal; else nothing."""
    similar = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean `{similar[0]}`?" if similar else ""
