# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Plug-ins: what files of a folder and other installed packages declare, such as log formats and effects.

A plug-in is a file of the folder, or an entry point of an installed package: `module`, or `module:attribute`
for one thing in it. It declares instances of one class, at the top level of its module.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from traceback import extract_tb
from types import ModuleType
from typing import Any, Generic, NamedTuple, TypeVar

from quadpi_core.errors import QuadpiError, one_line

Declared = TypeVar("Declared")


class _Plugin(NamedTuple):
    name: str
    package: str
    target: str

    def __str__(self) -> str:
        return f"`{self.name}` of {self.package} ({self.target})"


def names_in(folder: ModuleType) -> tuple[str, ...]:
    """Names of the plug-ins of a folder of this package: its files, sorted; none is imported."""
    files = [file for place in folder.__path__ for file in Path(place).glob("[!_]*.py")]
    return tuple(sorted(file.stem.replace("_", "-") for file in files))


def imported(target: str, where: str, error: type[QuadpiError]) -> Any:
    """What `module` or `module:attribute` names, imported.

    Raises:
        QuadpiError: of the class `error`, beginning with `where`, with the file and line where it failed.
    """
    module, _, attribute = target.partition(":")
    try:
        value = import_module(module)
        for part in filter(None, attribute.split(".")):
            value = getattr(value, part)
    except Exception as reason:  # of any kind, as it is the user's or another package's code
        failed = [frame for frame in extract_tb(reason.__traceback__) if frame.name == "<module>"]
        own = next((f for f in failed if Path(f.filename).stem == module.rpartition(".")[2]), None)
        place = f"{own.filename}, line {own.lineno}: " if own else ""
        text = f"{place}{type(reason).__name__}: {one_line(reason)}"
        raise error(f"{where}: cannot be imported: {text}") from reason
    return value


@dataclass(frozen=True)
class Plugins(Generic[Declared]):
    """All plug-ins of one sort, each imported when it is asked for.

    Every method but `names` raises `error`, with one line that names package and file, for a plug-in that it
    needs and that cannot be imported or declares nothing, and for two plug-ins of the same name.

    Attributes:
        sort: what a user calls one, such as "log format".
        folder: whose files are plug-ins.
        group: of the entry points by which other packages announce theirs.
        of: class of what they declare.
        error: class of the errors.
    """

    sort: str
    folder: ModuleType
    group: str
    of: type[Declared]
    error: type[QuadpiError]

    def names(self) -> tuple[str, ...]:
        """Names of all plug-ins, those of this package first; none is imported."""
        return tuple(dict.fromkeys(plugin.name for plugin in self._found()))

    def all(self) -> Iterator[Declared]:
        """What all plug-ins declare, those of this package first, each in the order of its file."""
        return (declared for name in self.names() for declared in self._declared(self._plugin(name)))

    def by_name(self) -> dict[str, Declared]:
        """What all plug-ins declare, by the name that it has itself; of two of the same name, an error."""
        found: dict[str, tuple[Any, _Plugin]] = {}
        for plugin in map(self._plugin, self.names()):
            for declared in self._declared(plugin):
                known, where = found.setdefault(declared.name, (declared, plugin))
                if known is not declared:
                    raise self._twice(declared.name, where, plugin)
        return {name: declared for name, (declared, _) in found.items()}

    def named(self, name: str) -> Declared | None:
        """What the plug-in of a name declares by the same name; None where there is no such plug-in."""
        if name not in self.names():
            return None
        plugin = self._plugin(name)
        for declared in self._declared(plugin):
            if declared.name == name:
                return declared
        raise self.error(f"{self.sort} {plugin}: nothing there has that name")

    def _found(self) -> list[_Plugin]:
        here = self.folder.__name__
        package = here.partition(".")[0]
        own = [_Plugin(name, package, f"{here}.{name.replace('-', '_')}") for name in names_in(self.folder)]
        return own + _installed(self.group, tuple(sys.path))

    def _plugin(self, name: str) -> _Plugin:
        plugin, *others = (plugin for plugin in self._found() if plugin.name == name)
        if others:
            raise self._twice(name, plugin, others[0])
        return plugin

    def _twice(self, name: str, one: _Plugin, other: _Plugin) -> QuadpiError:
        return self.error(f"{self.sort} `{name}` is declared twice: {one} and {other}")

    def _declared(self, plugin: _Plugin) -> list[Any]:
        value = imported(plugin.target, f"{self.sort} {plugin}", self.error)
        values = vars(value).values() if isinstance(value, ModuleType) else (value,)
        declared = [value for value in values if isinstance(value, self.of)]
        if not declared:
            raise self.error(f"{self.sort} {plugin}: there is no {self.of.__name__}")
        return declared


@cache
def _installed(group: str, _path: tuple[str, ...]) -> list[_Plugin]:
    """Plug-ins that packages announce, sorted; `_path` is where packages are looked for."""
    # Imported here as it takes longer than all else that `quadpi --help` needs.
    from importlib.metadata import entry_points

    found = []
    for entry in entry_points(group=group):
        package = f"{entry.dist.name} {entry.dist.version}" if entry.dist else "?"
        found.append(_Plugin(entry.name, package, f"{entry.module}:{entry.attr or ''}".rstrip(":")))
    return sorted(found)
