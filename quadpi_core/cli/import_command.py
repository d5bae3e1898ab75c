# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi import`: logs of any known format to MCAP bags."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import (
    batch_of_flights,
    check_outputs,
    open_console,
    print_quality,
    shown_work,
    write_result,
)


def import_logs(
    logs: Annotated[
        list[Path],
        typer.Argument(
            help="Logs of any known format, tables or bags: docs/import-logs.md lists them. FILE#2 is the "
            "second flight in a file."
        ),
    ],
    vehicle: options.VehicleName,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the bags.")],
    mapping: options.Mapping = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="Shift what another clock stamped so that turns match the gyro, thrust the accelerometer.",
        ),
    ] = False,
    workers: options.FileProcessCount = None,
    scheduler: options.Scheduler = None,
    json_file: options.JsonFile = None,
) -> None:
    """Convert flight logs to MCAP bags with the standard topics."""
    from quadpi_core.logs import importing
    from quadpi_core.vehicle import Vehicle

    check_outputs(logs, json_file, folders=[output])
    how = options.reading_options(topics, namespace, mapping, part=options.time_range(from_s, to_s))
    console = open_console()
    the_vehicle = Vehicle.load(vehicle)
    with batch_of_flights() as left_out:
        with shown_work(console, workers, scheduler) as reading:
            flights = importing.import_logs(
                logs, the_vehicle, output, how, align=align, workers=reading, left_out=left_out
            )
        for flight in flights:
            console.print(
                f"{flight.bag}: {flight.imu_samples} IMU samples; topics {', '.join(flight.topics)}",
                soft_wrap=True,
            )
            for topic, alignment in flight.alignments.items():
                console.print(
                    f"  {topic} moved by {alignment.offset_s * 1e3:+.1f} ms, correlation with the IMU "
                    f"{alignment.correlation:.3f} over {alignment.matches} samples, "
                    f"{alignment.overlap_s:.1f} s",
                    soft_wrap=True,
                )
            for sentence in flight.missing:
                console.print(f"  {sentence}", soft_wrap=True)
        print_quality(console, ((flight.log, flight.quality) for flight in flights))
        write_result(
            json_file,
            {"bags": [flight.to_json() for flight in flights], "left_out": list(map(asdict, left_out))},
        )
