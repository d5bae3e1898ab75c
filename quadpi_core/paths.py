# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Where the files that belong to quadpi lie, and how output appears whole or not at all."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from quadpi_core.errors import OutputError


def config_directory() -> Path:
    """The folder of vehicles, candidate pools, mappings and node parameters."""
    return _share_directory() / "config"


def message_directory() -> Path:
    """The folder of quadpi's message definitions."""
    return _share_directory() / "msg"


def bags_directory() -> Path:
    """The folder of the bundled bags."""
    return _share_directory() / "bags"


def _share_directory() -> Path:
    """The checkout, or share/quadpi of the prefix that pip or colcon installed the package below."""
    package = Path(__file__).resolve().parent
    for candidate in (package.parent, *(prefix / "share" / "quadpi" for prefix in package.parents)):
        if (candidate / "package.xml").is_file():
            return candidate
    raise FileNotFoundError(f"no package.xml beside {package} or in share/quadpi above it")


@contextmanager
def whole_output(path: Path) -> Iterator[Path]:
    """Give a temporary path in the target's folder that replaces `path` once the block succeeds.

    Works for a file or a folder, but no file replaces a folder, and nothing a device or pipe. On an exception
    the temporary one is removed and whatever stood at `path` before stays as it was.

    Raises:
        OutputError: if `path` cannot be written.
    """
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise OutputError(f"{path}: is neither a file nor a folder: not replaced")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        temporary = scratch / path.name
        try:
            yield temporary
            if temporary.is_dir() and path.is_dir() and not path.is_symlink():
                path.rename(scratch / "replaced")
            temporary.replace(path)
        finally:
            shutil.rmtree(scratch, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from error


def write_json(path: Path, data: Any) -> None:
    """Write JSON, whole or not at all.

    Raises:
        OutputError: if `path` cannot be written.
        ValueError: for a number that is not finite.
    """
    with whole_output(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1, allow_nan=False) + "\n")


def data_directory() -> Path:
    """The folder of real flights: $QUADPI_DATA, or shared/data beside the checkout; may not exist."""
    beside_checkout = Path(__file__).resolve().parent.parent.parent / "shared" / "data"
    return Path(os.environ.get("QUADPI_DATA", beside_checkout))
