# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi info`: what a log, a bag or a model holds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import check_outputs, open_console, write_result


def info(
    path: Annotated[
        Path, typer.Argument(help="A log (FILE#2: the second flight in it), a bag or a model folder.")
    ],
    vehicle: options.OptionalVehicle = None,
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    json_file: options.JsonFile = None,
) -> None:
    """Show what a log, bag or model holds: topics, rates, gaps, envelope, suspicious sensors."""
    from quadpi_core.report.info_tables import describe

    check_outputs([path], json_file)
    tables, data = describe(
        path,
        vehicle,
        options.reading_options(topics, namespace, mapping, part=options.time_range(from_s, to_s)),
    )
    console = open_console()
    for table in tables:
        console.print(table)
    write_result(json_file, data)
