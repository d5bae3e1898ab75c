# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""`quadpi view`: a flight in a browser, with how far the model can be trusted at every moment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from quadpi_core.cli.options import Confidence, OptionalVehicle, open_console
from quadpi_core.errors import QuadpiError


def view(
    bag: Annotated[Path, typer.Argument(help="Flight to look at: with sensor topics, or with results.")],
    model: Annotated[
        list[Path] | None,
        typer.Option(
            help="Model folder; may be given several times. Of a bag: judge it by these models, of which the "
            "first gives the alarm."
        ),
    ] = None,
    vehicle: OptionalVehicle = None,
    confidence: Confidence = None,
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
    from quadpi_core.view.bag_view import open_bag
    from quadpi_core.view.browser import announce
    from quadpi_core.view.view_server import serve_page

    models = [AerodynamicModel.load(folder) for folder in model or ()]
    the_vehicle = models[0].load_vehicle(vehicle) if models else None
    if vehicle is not None and not models:
        raise QuadpiError("--vehicle: is that of the models, and there is no --model")
    for other in models[1:]:
        assert the_vehicle is not None
        other.require(the_vehicle)
    console = open_console()
    source = open_bag(bag, models, the_vehicle, confidence)
    serve_page(source, port, bind, lambda url: announce(console.print, url, open_page))
