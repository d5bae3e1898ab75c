# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A plug-in of pytest: the core of the file QUADPI_SANITIZED in place of the one that is installed.

The names of the functions that are called, here and in the processes of readers, are added to QUADPI_CALLED.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

_NAME = "quadpi_core._core"
_spec = importlib.util.spec_from_file_location(_NAME, os.environ["QUADPI_SANITIZED"])
assert _spec is not None
assert _spec.loader is not None
_core = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(_core)
sys.modules[_NAME] = _core
_called: set[str] = set()


def _noted(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
    def call(*arguments: Any) -> Any:
        if name not in _called:
            _called.add(name)
            with Path(os.environ["QUADPI_CALLED"]).open("a") as file:
                file.write(f"{name}\n")
        return function(*arguments)

    return call


for _function, _of_core in list(vars(_core).items()):
    if callable(_of_core) and not isinstance(_of_core, type):
        setattr(_core, _function, _noted(_function, _of_core))
