# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Libraries that only some log formats need: imported when a log of that format is read."""

from __future__ import annotations

import importlib
from typing import Any

from quadpi_core.errors import LogError, one_line


def require(module: str, extra: str) -> Any:
    """The module of an optional dependency.

    Raises:
        LogError: naming the extra that installs it.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        library = module.partition(".")[0]
        raise LogError(
            f"this needs {library}, which the extra `{extra}` brings: pip install quadpi-monitor[{extra}] "
            f"({one_line(error)})"
        ) from error
