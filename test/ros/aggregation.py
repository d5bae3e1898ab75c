# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""What diagnostic_aggregator makes of a name, by the rules that its documentation gives for GenericAnalyzer.

Any of them is enough: `startswith`, `contains`, a `regex` that matches the whole name.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

CONFIGURATION = Path(__file__).parents[2] / "config" / "nodes" / "diagnostic_aggregator.yaml"
# Every key of an analyzer that is known here; the aggregator passes over what it does not know.
KNOWN = {"type", "path", "startswith", "contains", "regex", "remove_prefix", "discard_stale"}


def analyzers() -> dict[str, dict[str, Any]]:
    """The analyzers of quadpi's group, by the names of their groups."""
    parameters = yaml.safe_load(CONFIGURATION.read_text())["/**"]["ros__parameters"]
    group = parameters["quadpi"]
    assert (group["type"], group["path"]) == ("diagnostic_aggregator/AnalyzerGroup", "quadpi")
    for analyzer in group["analyzers"].values():
        assert set(analyzer) <= KNOWN
        assert analyzer["type"] == "diagnostic_aggregator/GenericAnalyzer"
    return {analyzer["path"]: analyzer for analyzer in group["analyzers"].values()}


def groups_of(name: str) -> list[str]:
    """The groups that take a status of this name."""
    return [
        group
        for group, analyzer in analyzers().items()
        if any(name.startswith(start) for start in analyzer.get("startswith", ()))
        or any(part in name for part in analyzer.get("contains", ()))
        or any(re.fullmatch(pattern, name) for pattern in analyzer.get("regex", ()))
    ]
