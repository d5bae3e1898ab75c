# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""The messages of other packages that are understood, by the names of their adapters."""

from __future__ import annotations

from functools import cache

from quadpi_core.errors import LogError
from quadpi_core.messages.adapters import packages
from quadpi_core.messages.adapters.adapter_definition import Adapter
from quadpi_core.plugins import Plugins

ADAPTERS = Plugins("message", packages, "quadpi.messages", Adapter, LogError)


@cache
def known_adapters() -> dict[str, Adapter]:
    """The adapters by name: those of the folder `packages` by file, then those of installed packages.

    Raises:
        LogError: naming the package whose adapter cannot be used.
    """
    return ADAPTERS.by_name()
