# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The kinds of model there are: files of the folder `kinds`, and those of packages that are installed.

A file declares its kind as `KIND`; its name, with dashes for underscores, is that of the kind. Another
package declares kinds as entry points of the group `quadpi.model_kinds`. A stored model only names its kind:
the code that reads it is that of a file here or of a package that someone installed, never of the folder.

Only what is asked for is imported, so that the command line can name the kinds at once.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from quadpi_core.errors import ModelError
from quadpi_core.models import kinds

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from quadpi_core.models.model_kind import Kind

# Entry points by which another package declares kinds.
ENTRY_POINTS = "quadpi.model_kinds"


def kind_names() -> tuple[str, ...]:
    """Names of all kinds, those of this package first."""
    return (*own_kind_names(), *(name for name in _installed() if name not in _modules()))


def own_kind_names() -> tuple[str, ...]:
    """Names of the kinds of this package."""
    return tuple(_modules())


def kind_named(name: str) -> Kind:
    """The kind of a name.

    Raises:
        ModelError: naming those known, for an unknown name; naming the package whose kind cannot be used.
    """
    if module := _modules().get(name):
        return _imported(module)
    if entry := _installed().get(name):
        return _loaded(entry)
    raise ModelError(f"method {name!r} is not known to this version ({', '.join(kind_names())})")


def _modules() -> dict[str, str]:
    """Module of each kind of this package, by name."""
    stems = sorted(path.stem for folder in kinds.__path__ for path in Path(folder).glob("[!_]*.py"))
    return {stem.replace("_", "-"): f"{kinds.__name__}.{stem}" for stem in stems}


def _installed() -> dict[str, EntryPoint]:
    from importlib.metadata import entry_points

    return {entry.name: entry for entry in entry_points(group=ENTRY_POINTS)}


def _imported(module: str) -> Kind:
    kind: Kind = import_module(module).KIND
    return kind


def _loaded(entry: EntryPoint) -> Kind:
    """The kind of another package."""
    from quadpi_core.models.model_kind import Kind

    try:
        kind: Any = entry.load()
    except Exception as error:  # of any kind, as it is another package's code
        raise ModelError(f"method {entry.name}: {entry.value} cannot be imported: {error}") from error
    if not isinstance(kind, Kind) or kind.name != entry.name:
        raise ModelError(f"method {entry.name}: {entry.value} is no kind of model of that name")
    return kind
