# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Coverage and width of prediction intervals by flight, axis and bin of a quantity, as a long table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.errors import ArgumentError, require_library
from quadpi_core.evaluation.metrics import coverage_interval_by_flight, mpiw, picp
from quadpi_core.flight import AXES
from quadpi_core.frames import Array
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.inputs import INPUT_INDEX, INPUT_NAMES, VELOCITY_INPUTS
from quadpi_core.library import Guessable
from quadpi_core.library.flight_arrays import counted, html_table, new_axes
from quadpi_core.library.flights import Flights, flights_in
from quadpi_core.library.wrench_model import WrenchModel
from quadpi_core.models.interval_rules import inside_interval

if TYPE_CHECKING:
    import pandas as pd

# Quantities that samples are binned by beside the inputs: their units, and their values (N,) of a flight.
_QUANTITIES: dict[str, tuple[str, Callable[[PreparedFlight], Array]]] = {
    "speed": ("m/s", lambda flight: np.asarray(np.linalg.norm(flight.inputs[:, VELOCITY_INPUTS], axis=1))),
    "rotor_speed": ("rad/s", lambda flight: flight.inputs[:, INPUT_INDEX["omega_avg"]]),
    "height": ("m", lambda flight: flight.height),
    "time": ("s", lambda flight: flight.time),
}
ALL = "all"


class CoverageRow(NamedTuple):
    """The intervals of one axis on the samples of a flight in one bin.

    Attributes:
        flight: its name; "all" for the samples of all flights.
        axis: Fx … Mz.
        bin: from, to (not included, but in the last bin) of the quantity; None where there are no bins.
        coverage: share of measurements inside their interval.
        low, high: 95 % confidence interval of the coverage. Of one flight: of this flight, by blocks within
            it, see `evaluation.metrics.coverage_interval`; of all: of flights like these, by flight.
        width: mean of the interval, N or Nm.
        n: number of samples.
    """

    flight: str
    axis: str
    bin: tuple[float, float] | None
    coverage: float
    low: float
    high: float
    width: float
    n: int


@dataclass(frozen=True, repr=False)
class CoverageTable(Guessable):
    """How intervals hold on flights; LogError without pandas or matplotlib, where they are needed.

    Attributes:
        rows: by flight, axis and bin; bins without samples have none.
        pooled: over the samples of all flights; their intervals are of flights to come like these, except
            where a cell has samples of one flight: they are of this flight then.
        by: quantity of the bins; None without.
        unit: of the quantity.
        confidence: nominal coverage.
        in_sample: names of the flights that the model was fitted to.
    """

    rows: tuple[CoverageRow, ...]
    pooled: tuple[CoverageRow, ...]
    by: str | None
    unit: str
    confidence: float
    in_sample: tuple[str, ...]

    def to_pandas(self, *, pooled: bool = False) -> pd.DataFrame:
        """Long table of columns flight, axis, bin (`pandas.Interval`), coverage, low, high, width, n.

        Args:
            pooled: over the samples of all flights instead of each, with "all" as the flight.
        """
        rows, pandas = self.pooled if pooled else self.rows, require_library("pandas", "notebook")
        frame: pd.DataFrame = pandas.DataFrame(rows, columns=CoverageRow._fields)
        if self.by is not None:
            frame["bin"] = pandas.arrays.IntervalArray.from_tuples([row.bin for row in rows], closed="left")
        return frame

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, place: int) -> CoverageRow:
        return self.rows[place]

    def __repr__(self) -> str:
        below, flights = sum(row.high < self.confidence for row in self.pooled), self._flights
        shares = [row.coverage for row in self.pooled]
        learned = f", {len(self.in_sample)} of which it learned from" if self.in_sample else ""
        bins = f" by {self.by}" if self.by else ""
        return (
            f"<CoverageTable{bins}: {counted(flights)}{learned}, coverage {min(shares):.1%} to "
            f"{max(shares):.1%}, stated {self.confidence:.4g}; {below} of {len(shares)} cover too little>"
        )

    @property
    def _flights(self) -> int:
        return len({row.flight for row in self.rows})

    def _repr_html_(self) -> str:
        rows = [
            (
                row.axis,
                "" if row.bin is None else f"{row.bin[0]:.3g} to {row.bin[1]:.3g} {self.unit}",
                f"{row.coverage:.1%}",
                f"{row.low:.1%} to {row.high:.1%}",
                f"{row.width:.3g}",
                row.n,
            )
            for row in self.pooled
        ]
        bounds = f"95 % interval, {'this flight' if self._flights == 1 else 'by flight'}"
        headings = ("axis", self.by or "", "coverage", bounds, "mean width [N, Nm]", "samples")
        return html_table(repr(self), headings, rows)

    def plot(self, axes: Any = None) -> Any:
        """Draw coverage with its confidence interval by bin, a line per axis; returns the axes of matplotlib.

        Args:
            axes: one of matplotlib; a new figure unless given.
        """
        (axes,) = new_axes(axes)
        for place, axis in enumerate(dict.fromkeys(row.axis for row in self.pooled)):
            rows = [row for row in self.pooled if row.axis == axis]
            shares = np.array([(row.coverage, row.low, row.high) for row in rows]).T
            middles = np.array([0.0 if row.bin is None else float(np.mean(row.bin)) for row in rows])
            step = 0.0 if rows[0].bin is None else 0.02 * (rows[0].bin[1] - rows[0].bin[0])
            errors = np.maximum([shares[0] - shares[1], shares[2] - shares[0]], 0.0)
            axes.errorbar(middles + place * step, shares[0], errors, marker="o", capsize=2, label=axis)
        axes.axhline(self.confidence, color="black", linestyle="--", linewidth=0.8)
        axes.set_ylabel("coverage")
        axes.set_xlabel("" if self.by is None else f"{self.by} [{self.unit}]" if self.unit else self.by)
        axes.legend(ncols=3)
        return axes


def evaluate(
    model: WrenchModel,
    flights: Flights,
    *,
    by: str | None = "speed",
    bins: int | Sequence[float] = 5,
    confidence: float | None = None,
) -> CoverageTable:
    """Judge the prediction intervals of a model on flights, by what they were like.

    Args:
        model: fitted.
        flights: of the same vehicle and low-pass; better ones that the model did not learn from.
        by: "speed" through the air, mean "rotor_speed", "height", "time" or an input such as "w"; None for
            one bin.
        bins: number of equal bins over all flights, or their edges, between which every sample must lie.
        confidence: of the intervals; the model's own unless given.

    Raises:
        ArgumentError: for what are no model, flights, quantity or bins.
        ModelError: see `WrenchModel.predict_interval`.
    """
    array_checks.instance("model", model, WrenchModel, "load_model(folder) reads one")
    given = flights_in("flights", flights)
    unit, quantity = _quantity(by)
    values = [quantity(flight) for flight in given.prepared]
    edges = _edges(np.concatenate(values), 1 if by is None else bins)
    evaluated = model.evaluations(given, confidence)
    confidence = model.model_.confidence if confidence is None else confidence
    places = [np.clip(np.searchsorted(edges, each, side="right") - 1, 0, len(edges) - 2) for each in values]

    def rows_of(name: str, members: Sequence[int]) -> list[CoverageRow]:
        of = np.repeat(members, [len(values[k]) for k in members])
        at = np.concatenate([places[k] for k in members])
        lower, upper, predicted = (
            np.concatenate([getattr(evaluated[k], bound) for k in members])
            for bound in ("lower", "upper", "predicted")
        )
        measured = np.concatenate([given.prepared[k].wrench for k in members])
        rows = []
        for axis in model.axes_:
            for place, ends in enumerate(pairwise(edges.tolist())):
                cell, column = at == place, AXES.index(axis)
                if cell.any():
                    y, low, high = (array[cell, column] for array in (measured, lower, upper))
                    interval = coverage_interval_by_flight(
                        inside_interval(y, low, high), y - predicted[cell, column], of[cell]
                    )
                    bounds = None if by is None else ends
                    width = mpiw(low, high)
                    rows.append(
                        CoverageRow(name, axis, bounds, picp(y, low, high), *interval, width, int(cell.sum()))
                    )
        return rows

    learned = {flight.sha256 for flight in model.model_.flights} - {""}
    return CoverageTable(
        rows=tuple(row for k, name in enumerate(given.names) for row in rows_of(name, [k])),
        pooled=tuple(rows_of(ALL, range(len(given)))),
        by=by,
        unit=unit,
        confidence=confidence,
        in_sample=tuple(flight.name for flight in given.prepared if flight.sha256 in learned),
    )


def _quantity(by: str | None) -> tuple[str, Callable[[PreparedFlight], Array]]:
    """Unit of a quantity, and its values (N,) of a flight."""
    if by is None:
        return "", lambda flight: np.zeros(len(flight.time))
    array_checks.instance("by", by, str)
    if by in INPUT_INDEX:
        return "", lambda flight: flight.inputs[:, INPUT_INDEX[by]]
    if by not in _QUANTITIES:
        known = ", ".join((*_QUANTITIES, *INPUT_NAMES))
        raise ArgumentError(f"by: no quantity {by!r}; there are {known}")
    return _QUANTITIES[by]


def _edges(values: npt.NDArray[np.float64], bins: int | Sequence[float]) -> Array:
    if isinstance(bins, int | np.integer):
        count = array_checks.whole("bins", bins, 1, 1000)
        lowest, highest = float(values.min()), float(values.max())
        return np.linspace(lowest, highest if highest > lowest else lowest + 1.0, count + 1)
    edges = array_checks.floats("bins", bins)
    if len(edges) < 2 or np.any(np.diff(edges) <= 0.0):
        raise ArgumentError("bins: expected edges that rise, two or more")
    if values.min() < edges[0] or values.max() > edges[-1]:
        raise ArgumentError(
            f"bins: samples from {values.min():.3g} to {values.max():.3g} lie beyond the edges "
            f"{edges[0]:g} to {edges[-1]:g}"
        )
    return edges
