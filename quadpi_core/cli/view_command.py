# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi view`: the live page in a browser, of the nodes that run or of a bag."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli import options
from quadpi_core.cli.options import Confidence, OptionalVehicle, open_console
from quadpi_core.errors import QuadpiError


def view(
    bag: Annotated[
        Path | None, typer.Argument(help="Flight to look at; without one, the live nodes of this ROS domain.")
    ] = None,
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="Model folder; may be given several times. Of a bag: judge it by these models, of which the "
            "first gives the alarm. Live: show the envelope of the one that flies."
        ),
    ] = None,
    vehicle: OptionalVehicle = None,
    confidence: Confidence = None,
    topics: options.Topics = None,
    namespace: options.Namespace = "",
    from_s: options.FromS = None,
    to_s: options.ToS = None,
    at: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="SECONDS", help="Moment of the bag to show first, in the time of the page."
        ),
    ] = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0 takes any.")] = 8710,
    bind: Annotated[
        str, typer.Option(help="Address to listen on; another than loopback lets the network in.")
    ] = "127.0.0.1",
    open_page: Annotated[
        bool | None,
        typer.Option("--open/--no-open", help="Open the page; default: where there is a display."),
    ] = None,
) -> None:
    """Show in a browser how far the model can be trusted now, and why not."""
    from quadpi_core.models.aerodynamic import AerodynamicModel
    from quadpi_core.view.rerun_recording import open_bag
    from quadpi_core.view.view_server import announce, serve_page

    models = [AerodynamicModel.load(folder) for folder in model or ()]
    if vehicle is not None and not models:
        raise QuadpiError("--vehicle: is that of the models, and there is no --model")
    console = open_console()

    if at is not None and bag is None:
        raise QuadpiError("--at: is a moment of a bag, and none is given")
    if at is not None and not math.isfinite(at):
        raise QuadpiError(f"--at {at}: is no moment")
    how = options.reading_options(topics, namespace, part=options.time_range(from_s, to_s))
    if (how.topics or how.namespace) and not (bag and models):
        raise QuadpiError("--topics, --namespace: are of a bag that --model judges")
    if bag is None and not how.part.is_whole:
        raise QuadpiError("--from, --to: are of a bag, and none is given")
    moment = "" if at is None else f"#t={at:g}"

    def say(url: str) -> None:
        announce(console.print, url + moment, open_page)

    # Ctrl-C is how it ends.
    with suppress(KeyboardInterrupt):
        if bag is not None:
            the_vehicle = models[0].load_vehicle(vehicle) if models else None
            serve_page(open_bag(bag, models, the_vehicle, confidence, how), port, bind, say)
            return
        if confidence is not None:
            raise QuadpiError("--confidence: is for a bag that --model judges; live nodes have theirs")
        try:
            # Here the command line reaches for ROS, as in `quadpi demo`.
            from quadpi_ros.view_node import view_live
        except ModuleNotFoundError as error:
            raise QuadpiError(
                f"live nodes are seen through ROS 2 ({error}); without it, look at a bag: quadpi view BAG"
            ) from error
        view_live(models, vehicle, port, bind, say)
