# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of configuration against the types that declare it, with refusals in one line.

A configuration is a frozen dataclass derived from :class:`Section`: its fields are the keys of a mapping in
the file, and their annotations the values allowed. Not by pydantic, as live nodes read vehicles, adapters and
models by it: they import only what ROS 2 Jazzy's Ubuntu packages, where pydantic is the old one, and a robot
starts 0.1 s sooner.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from copy import deepcopy
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cache, lru_cache, partial
from pathlib import Path
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    TypeAlias,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
import yaml

from quadpi_core import array_checks
from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.frames import Array
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


_Content = TypeVar("_Content")
# Of what was found, in a message.
_FOUND_MAX = 200


def load_config(
    kind: str, name_or_path: str | Path, content: type[_Content], error: type[QuadpiError]
) -> tuple[Path, _Content]:
    """Read a YAML file (see :func:`read_config`) as the type that declares its content.

    Raises:
        QuadpiError: of the class `error`, naming the file and the key that is missing, unknown or impossible.
    """
    path, data = read_config(kind, name_or_path, error)
    return path, parse_config(content, data, str(path), error)


def parse_config(
    content: type[_Content], data: Any, where: str, error: type[QuadpiError], above: tuple[str, ...] = ()
) -> _Content:
    """Data of a YAML or JSON file as the type that declares it.

    Args:
        content: a :class:`Section`, or another type that :func:`check_config` knows.
        data: mappings, lists and scalars.
        where: the file, for messages.
        error: class of the error to raise.
        above: the keys of the file that lead to the data.

    Raises:
        QuadpiError: of that class, naming the key that is missing, unknown or impossible.
    """
    try:
        return check_config(content, data)
    except RefusedError as refusal:
        raise error(f"{where}: {refusal.sentence(above)}") from None


class RefusedError(ValueError):
    """What is wrong with a value of a configuration.

    Args:
        words: a sentence, or "must …", which takes the key before it.
        found: what was found instead, where the words do not say it.
        known: names of which one was expected.

    Attributes:
        place: the keys, and places in lists, that lead to the value.
    """

    def __init__(self, words: str, found: Any = ..., known: Collection[str] = ()) -> None:
        shown = "" if found is ... else repr(found)
        cut = f"{shown[:_FOUND_MAX]}…" if len(shown) > _FOUND_MAX else shown
        super().__init__(
            words + (f", found {cut}" if cut else "") + (nearest(str(found), known) if known else "")
        )
        self.found, self.known = found, known
        self.place: tuple[str | int, ...] = ()

    def sentence(self, above: tuple[str, ...] = ()) -> str:
        """Where, which key, what is expected and what was found, for data below the keys `above`."""
        place = above + self.place
        if not place or not str(self).startswith("must"):
            return f"{_path(place)}{self}"
        key = place[-1]
        return f"{_path(place[:-1])}{f'`{key}`' if isinstance(key, str) else f'entry {key + 1}'} {self}"


def _path(place: tuple[int | str, ...]) -> str:
    """The keys above a value: `motion.x, entry 1, sine: `; entries of lists count from 1."""
    text = ""
    for before, step in zip(("", *place), place, strict=False):
        separator = "" if not text else ", " if isinstance(step, int) or isinstance(before, int) else "."
        text += separator + (f"entry {step + 1}" if isinstance(step, int) else step)
    return f"{text}: " if text else ""


def check_config(content: type[_Content], data: Any) -> _Content:
    """Data as the type that declares it; for functions that read a part of a configuration.

    Args:
        content: a dataclass, scalar, list, tuple, dict, Literal or union, or one of these annotated by rules.
        data: mappings, lists and scalars.

    Raises:
        RefusedError: if the data does not fit the type.
    """
    return _read(content, data)


def _read(content: Any, data: Any) -> Any:
    kind: Any = get_origin(content) or content
    arguments: Any = get_args(content)
    if kind is Annotated:
        inner, *rules = arguments
        return rules.pop().read(Annotated[(inner, *rules)] if rules else inner, data)
    if kind is Literal:
        return OneOf(*arguments).read(str, data)
    if kind in {Union, UnionType}:
        return _first_that_fits(arguments, data)
    if kind is Any:
        return data
    if is_dataclass(kind):
        return _dataclass(kind, data)
    if issubclass(kind, Mapping):
        return _mapping(arguments or (Any, Any), data)
    if kind in {list, tuple}:
        return kind(_items(arguments, data))
    if kind is float:
        return Within().read(float, data) if not isinstance(data, float) else data
    if not isinstance(data, kind) or (kind is int and isinstance(data, bool)):
        raise RefusedError(_EXPECTED.get(kind, f"must be of {kind.__name__}"), data)
    return data


_EXPECTED = {str: "must be text", int: "must be a whole number", bool: "must be true or false"}


def _at(step: str | int, content: Any, data: Any) -> Any:
    """Data that lies at a key or a place of a list."""
    try:
        return _read(content, data)
    except RefusedError as refusal:
        if refusal.found is None and not refusal.place and isinstance(step, str):
            raise RefusedError(f"missing key `{step}`") from None
        refusal.place = (step, *refusal.place)
        raise


def _first_that_fits(kinds: Iterable[Any], data: Any) -> Any:
    *others, last = (kind for kind in kinds if kind is not NoneType or data is None)
    for kind in others:
        try:
            return _read(kind, data)
        except RefusedError:
            continue
    return _read(last, data)


def _items(kinds: tuple[Any, ...], data: Any) -> list[Any]:
    if not isinstance(data, list | tuple):
        raise RefusedError("must be a list", data)
    each = len(kinds) < 2 or kinds[1] is ...
    if not each and len(data) != len(kinds):
        raise RefusedError(f"must be a list of {len(kinds)}", data)
    of = [kinds[0] if kinds else Any] * len(data) if each else kinds
    return [_at(place, kind, item) for place, (kind, item) in enumerate(zip(of, data, strict=True))]


def _mapping(kinds: tuple[Any, ...], data: Any) -> dict[Any, Any]:
    if not isinstance(data, Mapping):
        raise RefusedError("expected keys and values", data)
    read = {}
    for key, value in data.items():
        try:
            name = _read(kinds[0], key)
        except RefusedError as refusal:
            raise RefusedError(unknown_key(key, refusal.known)) from None
        read[name] = _at(str(key), kinds[1], value)
    return read


def _dataclass(kind: Any, data: Any) -> Any:
    if isinstance(data, kind):
        return data
    if not isinstance(data, Mapping):
        raise RefusedError("expected keys and values", data)
    declared = _declared(kind)
    if issubclass(kind, Section):
        known = [key for field in declared for key in field.keys]
        if unknown := [key for key in data if key not in known]:
            raise RefusedError(unknown_key(unknown[0], known))
        if kind.blank_is_absent:
            optional = {key for field in declared if not field.is_required for key in field.keys}
            data = {key: value for key, value in data.items() if value is not None or key not in optional}
    values = {}
    for field in declared:
        given = next((key for key in field.keys if key in data), None)
        if given is not None:
            values[field.name] = _at(given, field.kind, data[given])
        elif field.is_required:
            raise RefusedError(f"missing key `{field.keys[0]}`")
    return _judged(kind, **values)


class _Declared(NamedTuple):
    """A field of a dataclass, and the keys of a file that may give it."""

    name: str
    keys: tuple[str, ...]
    kind: Any
    is_required: bool


@cache
def _declared(kind: type) -> tuple[_Declared, ...]:
    hints = get_type_hints(kind, include_extras=True)
    declared = []
    for field in fields(kind):
        rules = getattr(hints[field.name], "__metadata__", ())
        keys = next((rule.names for rule in rules if isinstance(rule, Key)), (field.name,))
        required = field.default is MISSING and field.default_factory is MISSING
        declared.append(_Declared(field.name, keys, hints[field.name], required))
    return tuple(declared)


def _judged(function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
    """The result of a function, whose ValueError becomes a refusal."""
    try:
        return function(*arguments, **named)
    except RefusedError:
        raise
    except ValueError as error:
        raise RefusedError(str(error)) from None


def unknown_key(key: Any, known: Collection[str]) -> str:
    """Refusal of a key, with all known ones and the nearest of them."""
    return f"unknown key `{key}`; known: {', '.join(known)}{nearest(str(key), known)}"


class Section:
    """Base of a dataclass whose fields are the keys of a mapping in a file.

    A key of another name is refused. A key without a value (null) counts as absent if its field has a
    default, unless `blank_is_absent` is False. Rules between keys are checked in `__post_init__`, which
    raises ValueError.
    """

    blank_is_absent: ClassVar[bool] = True


# Annotations. Each reads data as a type that other annotations may have narrowed.


class Key:
    """The key in a file, where it differs from the name of the field; of several, a file has one."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def read(self, kind: Any, data: Any) -> Any:
        """The value, unchanged."""
        return _read(kind, data)


@dataclass(frozen=True)
class ReadBy:
    """A function that reads the value, and raises ValueError for what it refuses.

    Attributes:
        first: whether what it gives is then read as the type.
    """

    function: Callable[[Any], Any]
    first: bool = False

    def read(self, kind: Any, data: Any) -> Any:
        """What the function gives."""
        read = _judged(self.function, data)
        return _read(kind, read) if self.first else read


@dataclass(frozen=True)
class Expected:
    """What a value must be: the words of its refusal, in place of the reason."""

    words: str

    def read(self, kind: Any, data: Any) -> Any:
        """The value; it is refused in these words."""
        try:
            return _read(kind, data)
        except RefusedError:
            raise RefusedError(self.words, data) from None


@dataclass(frozen=True)
class Within:
    """A finite number (float), or a whole one (int), in a range; true and false are no numbers.

    Attributes:
        lowest, highest: bounds, inclusive.
        positive: whether zero is excluded too.
    """

    lowest: float = -math.inf
    highest: float = math.inf
    positive: bool = False

    def read(self, kind: Any, data: Any) -> float:
        """The number, of that type."""
        number = isinstance(data, int if kind is int else int | float) and not isinstance(data, bool)
        if (
            number
            and self.lowest <= data <= self.highest
            and abs(data) < math.inf
            and (data > 0 or not self.positive)
        ):
            return kind(data)
        raise RefusedError(self._words("whole number" if kind is int else "number"), data)

    def _words(self, noun: str) -> str:
        if self.positive:
            most = f" not above {self.highest:g}" if math.isfinite(self.highest) else ""
            return f"must be a positive {noun}{most}"
        if math.isfinite(self.highest):
            return f"must be a {noun} from {self.lowest:g} to {self.highest:g}"
        return f"must be a {noun}" + (f" not below {self.lowest:g}" if math.isfinite(self.lowest) else "")


@dataclass(frozen=True)
class Numbers:
    """An array of finite numbers (N,), or of rows of them (M, N).

    Attributes:
        count: N; None for any.
        rows: whether there are rows, one at least.
    """

    count: int | None = None
    rows: bool = False

    def read(self, _kind: Any, data: Any) -> Array:
        """The array."""
        amount = "numbers" if self.count is None else f"{self.count} numbers"
        words = f"must hold {'rows of ' if self.rows else ''}{amount}"
        if isinstance(data, np.ndarray):
            if data.ndim != 1 + self.rows or self.count not in {None, data.shape[-1]}:
                raise RefusedError(f"{words}, is of shape {data.shape}")
            return data
        numbers = Expected(words).read(list[list[Real]] if self.rows else list[Real], data)
        for row in numbers if self.rows else [numbers]:
            if self.count not in {None, len(row)}:
                raise RefusedError(words, data)
        if self.rows and not numbers:
            raise RefusedError(words, data)
        return np.array(numbers, dtype=float)


class OneOf:
    """One of some names."""

    def __init__(self, *names: str) -> None:
        self._names = names

    def read(self, _kind: Any, data: Any) -> str:
        """The name."""
        if data not in self._names:
            raise RefusedError(f"must be one of {', '.join(self._names)}", data, self._names)
        return data


@dataclass(frozen=True)
class Each:
    """A mapping that has an entry for each of some names."""

    names: tuple[str, ...]

    def read(self, kind: Any, data: Any) -> Any:
        """The mapping."""
        mapping = _read(kind, data)
        if missing := [name for name in self.names if name not in mapping]:
            raise RefusedError(f"missing key `{missing[0]}`")
        return mapping


class NotEmpty:
    """A text, list or mapping with something in it."""

    def read(self, kind: Any, data: Any) -> Any:
        """The same."""
        if not (found := _read(kind, data)):
            raise RefusedError("must be text" if kind is str else "must not be empty", data)
        return found


Real: TypeAlias = Annotated[float, Within()]
Positive: TypeAlias = Annotated[float, Within(positive=True)]
NotNegative: TypeAlias = Annotated[float, Within(0.0)]
Share: TypeAlias = Annotated[float, Within(0.0, 1.0)]
Flag: TypeAlias = bool
Vector: TypeAlias = Annotated[tuple[Real, Real, Real], Expected("must be three numbers")]
Text: TypeAlias = Annotated[str, NotEmpty()]
