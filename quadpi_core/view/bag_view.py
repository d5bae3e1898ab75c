# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A bag as a source of the page: judged by models as the live nodes would, or with the results in it."""

from __future__ import annotations

import queue
import shlex
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from quadpi_core.errors import QuadpiError
from quadpi_core.flight_files import named_files
from quadpi_core.logs.cut_off import is_cut_off, whole_part
from quadpi_core.messages.model_description import DescribedModel
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.vehicle import Vehicle
from quadpi_core.view.flight_parts import Part, flight_parts, holds_only_results
from quadpi_core.view.vehicle_view import BLOCK_NS, VehicleView

# An hour at 20 blocks a second, 50 MB with one model.
_BLOCKS = 72_000
# Parts that wait to be taken: the reader goes no further ahead than this.
_WAITING = 4
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
        parts: what to do with the view, block by block; may raise QuadpiError.
        known: see :class:`VehicleView`.
    """

    live = False

    def __init__(
        self, title: str, name: str, parts: Iterator[Part], known: Mapping[str, DescribedModel]
    ) -> None:
        self.title = title
        view = VehicleView(name, known, BLOCK_NS, _BLOCKS)
        view.silent(("reading the bag",))
        self.vehicles = {name: view}
        self.error: QuadpiError | None = None
        self.finished = False
        self._view = view
        self._parts: queue.Queue[Part | QuadpiError | None] = queue.Queue(_WAITING)
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._read, args=(parts,), name="bag reader", daemon=True)
        self._thread.start()

    def poll(self) -> None:
        """Take what has been read, for a moment."""
        deadline = time.monotonic() + _TICK_S
        while not self.finished and time.monotonic() < deadline:
            try:
                part = self._parts.get_nowait()
            except queue.Empty:
                break
            if isinstance(part, QuadpiError):
                self.error = part
                self._view.silent((f"the bag cannot be read further: {part}",))
                self._view.health.rows.append(("bag", "error", str(part)))
            elif part is not None:
                part(self._view)
            self.finished = part is None or self.error is not None

    def close(self) -> None:
        """End the reader."""
        self._stopping.set()
        self._thread.join()

    def _read(self, parts: Iterator[Part]) -> None:
        try:
            for part in parts:
                if not self._hand_over(part):
                    return
            self._hand_over(None)
        except QuadpiError as error:
            self._hand_over(error)
        finally:
            if hasattr(parts, "close"):
                parts.close()

    def _hand_over(self, part: Part | QuadpiError | None) -> bool:
        while not self._stopping.is_set():
            try:
                self._parts.put(part, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False


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
    parts = _started(flight_parts(bag, models, vehicle, confidence, command, mapping))
    with whole_part(bag) as readable:
        judges = models and not holds_only_results(readable)
    about = f"judged by {', '.join(model.name for model in models)}" if judges else "results as recorded"
    whole = ", as far as the file goes: it is cut off" if is_cut_off(bag) else ""
    (file,) = named_files(bag)
    return BagSource(f"{bag.name}, {about}{whole}", file.name, parts, known)


def _started(parts: Iterator[Part]) -> Iterator[Part]:
    """The parts with the first one made, so that what is wrong with a bag is said before a page is opened."""
    first = next(parts, None)

    def rest() -> Iterator[Part]:
        if first is not None:
            yield first
        yield from parts

    return rest()
