# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of arrays and tables of a user's own, prepared as those of logs are, and back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy.integrate import cumulative_trapezoid

from quadpi_core import array_checks
from quadpi_core.array_checks import description
from quadpi_core.errors import ArgumentError, LogError, named_in, require_library
from quadpi_core.flight import (
    Flight,
    ImuStream,
    OdometryStream,
    Recording,
    RotorSpeedStream,
    Stamps,
    WindStream,
    check_stamps,
    hole_ends,
)
from quadpi_core.frames import Array, rotate_body_to_world
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_recording
from quadpi_core.logs.flight_table import WRENCH, columns_of
from quadpi_core.logs.readers import recording_hash
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.monitor.preparation import conditions
from quadpi_core.records import QUATERNION_NORM_TOLERANCE
from quadpi_core.screening.consistency import checked
from quadpi_core.vehicle import Vehicle

if TYPE_CHECKING:
    import pandas as pd

_ROWS_SHOWN = 12


def html_table(sentence: str, headings: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A sentence above a table of HTML, of the first rows only where there are many."""
    more = f"<p>… {len(rows) - _ROWS_SHOWN} more</p>" if len(rows) > _ROWS_SHOWN else ""
    cells = [("th", headings), *(("td", row) for row in rows[:_ROWS_SHOWN])]
    lines = ("".join(f"<{cell}>{escape(str(one))}</{cell}>" for one in row) for cell, row in cells)
    return f"<p>{escape(sentence)}</p><table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>{more}"


def counted(flights: int) -> str:
    """Their number in words."""
    return "1 flight" if flights == 1 else f"{flights} flights"


def new_axes(axes: Any, count: int = 1) -> Any:
    """Axes (count,) of matplotlib to draw on: those given, else of a new figure, one below another.

    Raises:
        ArgumentError: for what are no axes, or another number of them.
        LogError: without matplotlib.
    """
    if axes is not None:
        given = np.ravel(np.array(axes, dtype=object))
        if len(given) != count or not all(hasattr(one, "fill_between") for one in given):
            raise ArgumentError(f"axes: expected {count} of matplotlib, found {description(axes)}")
        return given
    pyplot = require_library("matplotlib.pyplot", "notebook")
    height_in = max(3.0, 1.8 * count)
    figure = {"figsize": (8.0, height_in), "layout": "constrained"}
    return np.ravel(pyplot.subplots(count, 1, sharex=True, **figure)[1])


# Quantities that a table may lack; the second is taken only from signals that have been filtered.
_OPTIONAL = ("position", "wind")
_DERIVED = "angular_acceleration"
_TIME, _FLIGHT = "time_ns", "flight"
# Types of the names of columns.
_COLUMN = (str, int, np.integer)
# No quantity of a flight is larger in its SI unit; those of raw signals are looked at one by one.
_LARGEST = 1e6
# No flight is sampled faster than at 10 kHz: gyros give 8 kHz at most. In µs those are states of 10 Hz.
_SHORTEST_STEP_NS = 100_000
_NO_LABEL = ("nan", "NaT", "None", "<NA>")
# What `to_frame` says of a table beside its columns.
_CUTOFF, _ROWS = "cutoff_hz", "rows"


def prepared_from_arrays(
    time_ns: npt.ArrayLike,
    arrays: Mapping[str, npt.ArrayLike | None],
    flight: npt.ArrayLike | None,
    vehicle: Vehicle,
    cutoff_hz: float,
    *,
    air_density: npt.ArrayLike | None = None,
    filtered: bool = False,
    whole: Mapping[str, int] | None = None,
) -> tuple[PreparedFlight, ...]:
    """Flights by their labels, in the order of their first samples; see `Flights.from_arrays`.

    `whole` has the rows of flights that were filtered here: as many have no holes but those of their log.
    """
    cutoff_hz = array_checks.number("cutoff_hz", cutoff_hz, above=0.0)
    stamps = array_checks.stamps("time_ns", time_ns)
    for name, values in arrays.items():
        if values is None and name not in _OPTIONAL:
            raise ArgumentError(
                f"{name}: expected numbers, found None; only position and wind may be left out"
            )
    widths = {name: len(columns) for name, columns in columns_of(vehicle.rotor_count).items()}
    checked = {
        name: array_checks.floats(name, values, widths[name], rows=len(stamps), of="time_ns")
        for name, values in arrays.items()
        if values is not None
    }
    if air_density is not None and np.ndim(air_density) == 0:
        air_density = np.full(len(stamps), air_density)
    known = None if air_density is None else conditions(len(stamps), air_density)
    prepared = []
    for label, rows in _by_label(flight, len(stamps)):
        flight_values = {name: values[rows] for name, values in checked.items()}
        with named_in(f"flight {label}"):
            check_stamps("time_ns", stamps[rows])
            step_ns = float(np.median(np.diff(stamps[rows]))) if len(rows) > 1 else _SHORTEST_STEP_NS
            if step_ns < _SHORTEST_STEP_NS:
                raise ArgumentError(
                    f"time_ns: {step_ns:g} from sample to sample: looks like µs or ms, not ns"
                )
        recording = _recording(label, vehicle, stamps[rows], flight_values)
        if filtered:
            for name, values in flight_values.items():
                largest = np.abs(values).max(axis=1)
                for sample in np.flatnonzero(largest > _LARGEST)[:1]:
                    found = f"{largest[sample]:.3g}, which no flight has"
                    raise LogError(f"flight {label}: {name}: sample {sample}: magnitude of {found}")
            is_whole = (whole or {}).get(label) == len(rows)
            prepared.append(_taken(recording, flight_values[_DERIVED], vehicle, is_whole=is_whole))
        else:
            prepared.append(prepare_recording(recording, vehicle, cutoff_hz))
        if known is not None:
            prepared[-1] = prepared[-1].in_air(float(np.median(known["air_density"][rows])), vehicle)
    return tuple(prepared)


def _by_label(flight: npt.ArrayLike | None, samples: int) -> Iterator[tuple[str, npt.NDArray[np.int64]]]:
    """Rows of each flight."""
    if samples == 0:
        raise ArgumentError("time_ns: expected samples, found none")
    if flight is None:
        yield "flight", np.arange(samples)
        return
    labels = np.asarray(flight)
    if labels.shape != (samples,):
        raise ArgumentError(f"flight: expected shape ({samples},) for time_ns, found {labels.shape}")
    texts = np.array([str(label) for label in labels])
    for row in np.flatnonzero(np.isin(texts, _NO_LABEL)):
        if not isinstance(labels[row], str):
            raise ArgumentError(f"flight: no label in row {row}")
    for label in dict.fromkeys(texts.tolist()):
        yield label, np.flatnonzero(texts == label)


def _recording(name: str, vehicle: Vehicle, time_ns: Stamps, arrays: Mapping[str, Array]) -> Recording:
    position = arrays.get("position")
    if position is None:
        velocity = rotate_body_to_world(arrays["attitude"], arrays["velocity"])
        seconds = 1e-9 * (time_ns - time_ns[0])
        position = cumulative_trapezoid(velocity, seconds, axis=0, initial=0.0)
    attitude, velocity, rates = arrays["attitude"], arrays["velocity"], arrays["rates"]
    return Recording(
        name=name,
        vehicle=vehicle.name,
        source=f"flight {name}",
        imu=ImuStream(time_ns, rates, arrays["specific_force"]),
        rotor_speeds=RotorSpeedStream(time_ns, arrays["rotor_speeds"]),
        odometry=OdometryStream(time_ns, position, attitude, velocity, rates),
        wind=WindStream(time_ns, arrays["wind"]) if "wind" in arrays else None,
    )


def _taken(
    recording: Recording, angular_acceleration: Array, vehicle: Vehicle, *, is_whole: bool
) -> PreparedFlight:
    """A flight whose signals have been filtered, as they are.

    Raises:
        LogError: naming the flight, for rows that were left out, attitudes that are no rotations, units
            or axes that cannot be right, and certain mistakes.
    """
    state, rotors, wind = recording.odometry, recording.rotor_speeds, recording.wind
    assert state is not None
    assert rotors is not None
    source, time = recording.source, 1e-9 * (recording.imu.time_ns - recording.imu.time_ns[0])
    if len(time) == 1:
        raise LogError(f"{source}: has 1 row, expected 2 or more")
    for end in () if is_whole else hole_ends(time):
        raise LogError(
            f"{source}: sample {end}: rows before it are left out: filter rows after loading, not before"
        )
    norms = np.linalg.norm(state.attitude, axis=1)
    off = np.abs(norms - 1.0) > QUATERNION_NORM_TOLERANCE
    if off.any():
        first = int(np.argmax(off))
        raise LogError(f"{source}: attitude: sample {first}: norm of {norms[first]:.3g}, expected 1")
    recording = checked(recording, vehicle, filtered=True)
    flight = Flight(
        name=recording.name,
        vehicle=vehicle.name,
        source=recording.source,
        start_ns=int(recording.imu.time_ns[0]),
        time=time,
        position=state.position,
        attitude=state.attitude,
        velocity=state.velocity,
        rates=state.rates,
        angular_acceleration=angular_acceleration,
        specific_force=recording.imu.specific_force,
        rotor_speeds=rotors.speeds,
        wind=np.zeros((len(recording.imu), 3)) if wind is None else wind.velocity,
        biases_estimated=False,
        quality=recording.quality,
    )
    prepared = PreparedFlight.from_flight(flight, vehicle, recording_hash(recording))
    return replace(prepared, file=recording.name)


def from_frame(
    frame: pd.DataFrame,
    vehicle: Vehicle,
    cutoff_hz: float | None,
    *,
    flight: str | None,
    time: str,
    names: Mapping[str, Sequence[str]] | None,
    filtered: bool,
) -> tuple[tuple[PreparedFlight, ...], float]:
    """Flights of a table, and their low-pass; see `Flights.from_pandas`."""
    array_checks.instance("frame", frame, require_library("pandas", "notebook").DataFrame)
    array_checks.instance("filtered", filtered, bool)
    array_checks.instance("columns", {} if names is None else names, Mapping)
    if cutoff_hz is None:
        cutoff_hz = frame.attrs.get(_CUTOFF) if filtered else CUTOFF_HZ["default"]
    if cutoff_hz is None:
        raise ArgumentError("cutoff_hz: the table does not say which low-pass its signals passed: pass it")
    states = columns_of(vehicle.rotor_count)
    columns: dict[str, Sequence[str]] = {**states}
    for quantity, own in (names or {}).items():
        if quantity not in states:
            raise ArgumentError(f"columns: no quantity {quantity!r}; there are {', '.join(states)}")
        listed = own if isinstance(own, list | tuple | np.ndarray) else ()
        if len(listed) != len(states[quantity]) or not all(isinstance(name, _COLUMN) for name in listed):
            raise ArgumentError(f"columns, {quantity}: expected {len(states[quantity])} names, found {own!r}")
        columns[quantity] = own
    if not filtered:
        if set(states[_DERIVED]) <= set(frame.columns):
            raise ArgumentError(
                f"frame: has angular accelerations ({states[_DERIVED][0]} …), so its signals were filtered: "
                "pass filtered=True to take them as they are, or leave those columns out"
            )
        del columns[_DERIVED]
    arrays: dict[str, npt.ArrayLike | None] = {}
    for quantity, own in columns.items():
        absent = [name for name in own if name not in frame.columns]
        if not absent:
            part = frame[list(own)]
            numbers = all(dtype.kind in "iuf" for dtype in part.dtypes)
            arrays[quantity] = part.to_numpy(dtype=float, na_value=np.nan) if numbers else part.to_numpy()
        elif quantity not in _OPTIONAL or len(absent) < len(own):
            raise ArgumentError(
                f"frame: {quantity} needs the columns {_listed(own)}: no {_listed(absent)}; "
                f'columns={{"{quantity}": […]}} names yours'
            )
    for argument, name in (("time", time), ("flight", _FLIGHT if flight is None else flight)):
        if not isinstance(name, _COLUMN):
            raise ArgumentError(
                f"{argument}: expected the name of a column, found {array_checks.description(name)}"
            )
        if name not in frame.columns and (argument, flight) != ("flight", None):
            indexed = name in frame.index.names
            hint = "; reset_index() makes it one" if indexed else f"; it has {_listed(frame.columns)}"
            raise ArgumentError(f"frame: no column {name}{hint}")
    labels = None if flight is None else frame[flight].to_numpy()
    stamps = frame[time].to_numpy()
    if getattr(frame[time], "dtype", stamps.dtype).kind == "M":  # of a time zone too
        stamps = frame[time].to_numpy("datetime64[ns]").astype(np.int64)
    whole = frame.attrs.get(_ROWS)
    if not isinstance(whole, Mapping):
        whole = None  # another library's
    return (
        prepared_from_arrays(stamps, arrays, labels, vehicle, cutoff_hz, filtered=filtered, whole=whole),
        cutoff_hz,
    )


def _listed(names: Iterable[Any]) -> str:
    return ", ".join(map(str, names))


def to_frame(flights: Sequence[PreparedFlight], cutoff_hz: float) -> pd.DataFrame:
    """The table of flights; see `Flights.to_pandas`."""
    parts, pandas = [], require_library("pandas", "notebook")
    for prepared in flights:
        flight = prepared.states
        table: dict[str, Any] = {_FLIGHT: prepared.name, _TIME: flight.stamps_ns}
        for quantity, columns in columns_of(flight.rotor_speeds.shape[1]).items():
            table |= dict(zip(columns, getattr(flight, quantity).T, strict=True))
        table |= dict(zip(WRENCH, prepared.wrench.T, strict=True))
        parts.append(pandas.DataFrame(table))
    frame: pd.DataFrame = pandas.concat(parts, ignore_index=True)
    frame.attrs = {_CUTOFF: cutoff_hz, _ROWS: {flight.name: len(flight.time) for flight in flights}}
    return frame
