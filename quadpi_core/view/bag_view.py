# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bag as a source of the page: judged by models as the live nodes would, or with the results in it."""

from __future__ import annotations

import shlex
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Protocol

from quadpi_core.errors import QuadpiError
from quadpi_core.flight_files import named_files
from quadpi_core.logs.cut_off import is_cut_off, whole_part
from quadpi_core.messages.model_description import DescribedModel
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.flight_parts import Part, Parts, flight_parts, holds_only_results
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView

# An hour at 20 blocks a second, 50 MB with one model.
_BLOCKS = 72_000
# Time that a tick may spend on what has been read, so that pages are answered meanwhile.
_TICK_S = 0.03


class Source(Protocol):
    """Where a page's data come from."""

    live: bool
    title: str

    @property
    def vehicles(self) -> Mapping[str, VehicleView]:
        """Every vehicle, by name."""

    def poll(self) -> None:
        """Take what has come since the last call; called at every tick of the server."""

    def close(self) -> None:
        """Stop."""


class BagSource:
    """A flight that is read in a thread while pages look at what has been read.

    Args:
        title: what the page is about.
        name: of the flight.
        parts: what to do with the view, block by block.
        known: see :class:`VehicleView`.

    Raises:
        QuadpiError: for a bag whose first part cannot be read.
    """

    live = False

    def __init__(self, title: str, name: str, parts: Parts, known: Mapping[str, DescribedModel]) -> None:
        self.title = title
        view = VehicleView(name, known, BLOCK_NS, _BLOCKS)
        view.silent(("reading the bag",))
        self.vehicles = {name: view}
        self.error: QuadpiError | None = None
        self.finished = False
        self._view = view
        self._parts = parts
        self._reader = ThreadPoolExecutor(1, "bag reader")
        # What is wrong with a bag is said before a page is opened.
        self._next: Future[Part | None] = Future()
        self._next.set_result(next(parts, None))

    def poll(self) -> None:
        """Take what has been read, for a moment."""
        deadline = time.monotonic() + _TICK_S
        while not self.finished and wait([self._next], max(0.0, deadline - time.monotonic())).done:
            try:
                part = self._next.result()
            except QuadpiError as error:
                part, self.error = None, error
                self._view.silent((f"the bag cannot be read further: {error}",))
                self._view.health.append(("bag", "error", str(error)))
            self.finished = part is None
            if part is not None:
                part(self._view)
                self._next = self._reader.submit(next, self._parts, None)

    def close(self) -> None:
        """End the reader, and close the bag."""
        self._reader.shutdown()
        self._parts.close()


def open_bag(
    bag: Path,
    models: Sequence[AerodynamicModel],
    vehicle: Vehicle | None,
    confidence: float | None = None,
    mapping: MappingOrOptions = None,
) -> BagSource:
    """The source of a flight.

    Args:
        bag: with sensor topics to judge by the models, or with results.
        models: the first gives the alarm; none: those whose results the bag holds. Of a bag with
            results alone their training ranges are shown.
        vehicle: of the models.
        confidence: of the intervals; each model's own unless given.
        mapping: of a flight that models judge, see :func:`quadpi_core.logs.read_recording`.

    Raises:
        QuadpiError: for a bag that cannot be read or holds no results, and models of another vehicle.
    """
    known = {model.identity: model.described() for model in models}
    command = f"quadpi view {shlex.quote(str(bag))}"
    parts = flight_parts(bag, models, vehicle, confidence, command, mapping)
    with whole_part(bag) as readable:
        judges = models and not holds_only_results(readable)
    about = f"judged by {', '.join(model.name for model in models)}" if judges else "results as recorded"
    whole = ", as far as the file goes: it is cut off" if is_cut_off(bag) else ""
    (file,) = named_files(bag)
    return BagSource(f"{bag.name}, {about}{whole}", file.name, parts, known)
