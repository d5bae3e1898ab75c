# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A plug-in of pytest: the core of the file QUADPI_SANITIZED in place of the one that is installed."""

from __future__ import annotations

import importlib.util
import os
import sys

_NAME = "quadpi_core._core"
_spec = importlib.util.spec_from_file_location(_NAME, os.environ["QUADPI_SANITIZED"])
assert _spec is not None
assert _spec.loader is not None
sys.modules[_NAME] = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(sys.modules[_NAME])
