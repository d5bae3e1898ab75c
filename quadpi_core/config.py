# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""YAML files under config, or of the user's own: found and read alike for vehicles, mappings and pools."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from quadpi_core.errors import QuadpiError, one_line
from quadpi_core.paths import config_directory


def read_config(kind: str, name_or_path: str | Path, error: type[QuadpiError]) -> tuple[Path, Any]:
    """Path and content of a YAML file, by its name in config/`kind`s or by its path.

    Args:
        kind: "vehicle", "mapping" or "candidate".
        name_or_path: a path if it ends in .yaml or .yml, else a name.
        error: class of the error to raise.

    Raises:
        QuadpiError: of that class, naming the file that is absent or no YAML.
    """
    path = Path(name_or_path)
    own = config_directory() / f"{kind}s"
    if path.suffix not in {".yaml", ".yml"}:
        path = own / f"{name_or_path}.yaml"
    try:
        return path, yaml.safe_load(path.read_text())
    except FileNotFoundError:
        known = ", ".join(sorted(file.stem for file in own.glob("*.yaml")))
        raise error(
            f"{path}: no such {kind} file; known {kind}s: {known}, or the path of a .yaml file"
        ) from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as reason:
        raise error(f"{path}: not a readable YAML file: {one_line(reason)}") from reason
