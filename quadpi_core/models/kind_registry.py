# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The kinds of model there are: files of the folder `kinds`, and those of other packages that are installed.

The name of its file or entry point is that of a kind. A stored model only names its kind: the code that reads
it is that of a file here or of a package that someone installed, never of the folder.
"""

from __future__ import annotations

from collections.abc import Callable

from quadpi_core.config_schema import nearest
from quadpi_core.errors import ModelError
from quadpi_core.models import kinds
from quadpi_core.models.model_kind import IdentifyOptions, Kind
from quadpi_core.plugins import Plugins

KINDS = Plugins("method", kinds, "quadpi.model_kinds", Kind, ModelError)  # type: ignore[type-abstract]


def kind_of(options: IdentifyOptions) -> Kind:
    """The kind that options name or hold; unless they do, the first default that has their settings."""
    if isinstance(options.method, Kind):
        return options.method
    if options.method is not None:
        return kind_named(options.method)
    return default_kind(lambda kind: options.settings != "paper" or kind.has_paper_settings)


def default_kind(has_what_is_asked: Callable[[Kind], bool]) -> Kind:
    """The first kind of `kinds.DEFAULTS` that has what is asked for; the first of all if none has."""
    defaults = [kind_named(name) for name in kinds.DEFAULTS]
    return next(filter(has_what_is_asked, defaults), defaults[0])


def kind_named(name: str) -> Kind:
    """The kind of a name.

    Raises:
        ModelError: naming those known, for an unknown name; naming the package whose kind cannot be used.
    """
    kind = KINDS.named(name)
    if kind is None:
        hint = nearest(name, KINDS.names())
        raise ModelError(f"method {name!r} is not known to this version ({', '.join(KINDS.names())}){hint}")
    return kind
