# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of configuration against the types that declare it, with refusals in one line.

A configuration is a frozen dataclass derived from :class:`Section`: its fields are the keys of a mapping in
the file, and their annotations the values allowed. pydantic checks a file's content against the annotations;
this module adds the numbers of physics (finite, in a range, no booleans), the refusal of unknown keys with
the nearest known one, and the wording of messages.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeAlias, TypeVar

import numpy as np
from pydantic import GetCoreSchemaHandler, StrictBool, TypeAdapter, ValidationError
from pydantic_core import CoreSchema, ErrorDetails, core_schema

from quadpi_core.config import nearest, read_config
from quadpi_core.errors import QuadpiError
from quadpi_core.frames import Array

_Content = TypeVar("_Content")


def load_config(
    kind: str, name_or_path: str | Path, content: type[_Content], error: type[QuadpiError]
) -> tuple[Path, _Content]:
    """Read a YAML file (see :func:`quadpi_core.config.read_config`) as the type that declares its content.

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
        content: a :class:`Section`, or another type that pydantic knows.
        data: mappings, lists and scalars.
        where: the file, for messages.
        error: class of the error to raise.
        above: the keys of the file that lead to the data.

    Raises:
        QuadpiError: of that class, naming the key that is missing, unknown or impossible.
    """
    try:
        return check_config(content, data)
    except ValidationError as refusal:
        raise error(f"{where}: {_sentence(refusal.errors(include_url=False)[0], above)}") from None


def check_config(content: type[_Content], data: Any) -> _Content:
    """As :func:`parse_config`, inside a validator of another section, which then words the refusal.

    Raises:
        ValidationError: if the data does not fit the type.
    """
    kind: Any = content
    checked: _Content = _adapter(kind).validate_python(data)
    return checked


@cache
def _adapter(content: Any) -> TypeAdapter[Any]:
    return TypeAdapter(content)


class Section:
    """Base of a dataclass whose fields are the keys of a mapping in a file.

    A key of another name is refused. A key without a value (null) counts as absent if its field has a
    default, unless `blank_is_absent` is False. Rules between keys are checked in `__post_init__`, which
    raises ValueError.
    """

    blank_is_absent: ClassVar[bool] = True

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Let pydantic check the fields, after the keys."""
        schema = handler(source)
        # Changed in place: where a section occurs again, pydantic takes what it has stored of it.
        stored: Any = handler.resolve_ref_schema(schema)
        fields = stored["schema"]["fields"]
        defaults = {key: field["schema"]["type"] == "default" for field in fields for key in _keys(field)}

        def known_keys(data: Any) -> Any:
            if not isinstance(data, Mapping):
                return data
            for key in data:
                if key not in defaults:
                    raise ValueError(unknown_key(key, defaults))
            absent = {key for key, value in data.items() if value is None and defaults[key]}
            return {k: v for k, v in data.items() if k not in absent} if cls.blank_is_absent else data

        stored["schema"] = core_schema.no_info_before_validator_function(known_keys, stored["schema"])
        return schema


def _keys(field: Mapping[str, Any]) -> list[str]:
    """The keys of a file that give a field of a dataclass schema."""
    alias = field.get("validation_alias", field["name"])
    return [alias] if isinstance(alias, str) else [path[0] for path in alias]


def unknown_key(key: Any, known: Collection[str]) -> str:
    """Refusal of a key, with all known ones and the nearest of them."""
    return f"unknown key `{key}`; known: {', '.join(known)}{nearest(str(key), known)}"


@dataclass(frozen=True)
class Expected:
    """Annotation: what a value must be, in the words of a refusal, instead of pydantic's reason."""

    words: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """See pydantic."""
        return _worded(handler(source), self.words)


@dataclass(frozen=True)
class Within:
    """Annotation: a finite number (float), or a whole one (int), in a range; true and false are no numbers.

    Attributes:
        lowest, highest: bounds, inclusive.
        positive: whether zero is excluded too.
    """

    lowest: float = -math.inf
    highest: float = math.inf
    positive: bool = False

    def __get_pydantic_core_schema__(self, source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        """See pydantic."""
        bounds: dict[str, Any] = {}
        if math.isfinite(self.lowest):
            bounds["ge"] = self.lowest
        if math.isfinite(self.highest):
            bounds["le"] = self.highest
        if self.positive:
            bounds["gt"] = 0
        if source is int:
            whole: dict[str, Any] = {name: int(bound) for name, bound in bounds.items()}
            return _worded(core_schema.int_schema(strict=True, **whole), self._words("whole number"))
        number = core_schema.float_schema(strict=True, allow_inf_nan=False, **bounds)
        return _worded(number, self._words("number"))

    def _words(self, noun: str) -> str:
        if self.positive:
            most = f" not above {self.highest:g}" if math.isfinite(self.highest) else ""
            return f"must be a positive {noun}{most}"
        if math.isfinite(self.highest):
            return f"must be a {noun} from {self.lowest:g} to {self.highest:g}"
        return f"must be a {noun}" + (f" not below {self.lowest:g}" if math.isfinite(self.lowest) else "")


@dataclass(frozen=True)
class Numbers:
    """Annotation: an array of finite numbers (N,), or of rows of them (M, N).

    Attributes:
        count: N; None for any.
        rows: whether there are rows, one at least.
    """

    count: int | None = None
    rows: bool = False

    def __get_pydantic_core_schema__(self, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        """See pydantic."""
        number = core_schema.float_schema(strict=True, allow_inf_nan=False)
        numbers = core_schema.list_schema(number, min_length=self.count, max_length=self.count)
        if self.rows:
            numbers = core_schema.list_schema(numbers, min_length=1)
        schema = core_schema.no_info_after_validator_function(_floats, numbers)
        amount = "numbers" if self.count is None else f"{self.count} numbers"
        return _worded(schema, f"must hold {'rows of ' if self.rows else ''}{amount}")


def _floats(numbers: Any) -> Array:
    return np.array(numbers, dtype=float)


class OneOf:
    """Annotation: one of some names."""

    def __init__(self, *names: str) -> None:
        self._names = names

    def __get_pydantic_core_schema__(self, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        """See pydantic."""
        words = f"must be one of {', '.join(self._names)}"
        return _worded(core_schema.literal_schema(list(self._names)), words, known="\n".join(self._names))


@dataclass(frozen=True)
class Each:
    """Annotation: a mapping that has an entry for each of some names."""

    names: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """See pydantic."""

        def complete(found: dict[str, Any]) -> dict[str, Any]:
            if missing := [name for name in self.names if name not in found]:
                raise ValueError(f"missing key `{missing[0]}`")
            return found

        return core_schema.no_info_after_validator_function(complete, handler(source))


def _worded(schema: CoreSchema, words: str, **context: Any) -> CoreSchema:
    return core_schema.custom_error_schema(
        schema, custom_error_type="expected", custom_error_message=words, custom_error_context=context
    )


Real: TypeAlias = Annotated[float, Within()]
Positive: TypeAlias = Annotated[float, Within(positive=True)]
NotNegative: TypeAlias = Annotated[float, Within(0.0)]
Share: TypeAlias = Annotated[float, Within(0.0, 1.0)]
Flag: TypeAlias = Annotated[StrictBool, Expected("must be true or false")]
Vector: TypeAlias = Annotated[tuple[Real, Real, Real], Expected("must be three numbers")]


@dataclass(frozen=True)
class _NonEmpty:
    def __get_pydantic_core_schema__(self, _source: Any, _handler: GetCoreSchemaHandler) -> CoreSchema:
        return _worded(core_schema.str_schema(strict=True, min_length=1), "must be text")


Text: TypeAlias = Annotated[str, _NonEmpty()]

# What a value must be where a type of pydantic's own is not met.
_EXPECTED = {
    "string_type": "must be text",
    "tuple_type": "must be a list",
}
# Of what was found, in a message.
_FOUND_MAX = 200


def _sentence(problem: ErrorDetails, above: tuple[str, ...]) -> str:
    """A refusal by pydantic in our words: where, which key, what is expected and what was found."""
    place, kind, found = above + problem["loc"], problem["type"], problem["input"]
    context = problem.get("ctx", {})
    path = _path(place[:-1])
    key = place[-1] if place else ""
    if key == "[key]":
        return f"{_path(place[:-2])}{unknown_key(found, context.get('known', '').splitlines())}"
    if kind == "missing" or (found is None and isinstance(key, str) and key and kind != "value_error"):
        return f"{path}missing key `{key}`"
    if kind == "value_error":
        message = str(context["error"])
        return f"{path}`{key}` {message}" if message.startswith("must") else f"{_path(place)}{message}"
    shown = repr(found)
    if len(shown) > _FOUND_MAX:
        shown = f"{shown[:_FOUND_MAX]}…"
    if kind in {"dataclass_type", "dict_type"}:
        return f"{_path(place)}expected keys and values, found {shown}"
    words = _EXPECTED.get(kind, problem["msg"][:1].lower() + problem["msg"][1:])
    name = f"`{key}` " if isinstance(key, str) and key else f"entry {key + 1} " if key != "" else ""
    suggestion = nearest(str(found), context["known"].splitlines()) if "known" in context else ""
    return f"{path}{name}{words}, found {shown}{suggestion}"


def _path(place: tuple[int | str, ...]) -> str:
    """The keys above a value: `motion.x, entry 1, sine: `; entries of lists count from 1."""
    text = ""
    for before, step in zip(("", *place), place, strict=False):
        separator = "" if not text else ", " if isinstance(step, int) or isinstance(before, int) else "."
        text += separator + (f"entry {step + 1}" if isinstance(step, int) else step)
    return f"{text}: " if text else ""
