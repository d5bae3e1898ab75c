# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi demo`: the whole story, live nodes included."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli.options import open_console
from quadpi_core.errors import QuadpiError


def demo(
    data: Annotated[
        Path | None,
        typer.Option(envvar="QUADPI_DATA", help="Folder of real flights; default: the bundled ones."),
    ] = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for all that the demo makes.")
    ] = Path("out/demo"),
    rate: Annotated[float, typer.Option(help="Speed of the live replay; 1 is real time.")] = 1.0,
    view: Annotated[
        bool, typer.Option(help="Serve the live part as a page; it opens where there is a display.")
    ] = True,
) -> None:
    """Run the whole story: identify, evaluate, replay a flight through the live nodes, report."""
    try:
        # The one place where the command line reaches for ROS: the demo starts the live nodes.
        from quadpi_ros.demo import run_demo
    except ModuleNotFoundError as error:
        raise QuadpiError(f"the demo needs ROS 2 for its live nodes ({error}): run `make demo`") from error

    run_demo(data, output, rate, open_console(), view)
