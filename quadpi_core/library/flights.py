# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of one vehicle, fused and filtered, as models take them."""

from __future__ import annotations

import glob
import logging
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.config_schema import is_config_path
from quadpi_core.errors import ArgumentError, LogError
from quadpi_core.flight import mean_rate_hz
from quadpi_core.flight_files import LeftOutFlights
from quadpi_core.frames import Array
from quadpi_core.identification.commanded_flights import prepare_with_motors
from quadpi_core.identification.prepared_flights import PreparedFlight
from quadpi_core.inputs import VELOCITY_INPUTS
from quadpi_core.library import Guessable
from quadpi_core.library.flight_arrays import counted, from_frame, html_table, prepared_from_arrays, to_frame
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.parallel import Workers
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.vehicle import LOAD_VEHICLE, Vehicle

if TYPE_CHECKING:
    import pandas as pd

_log = logging.getLogger(__name__)
_NAMES_SHOWN = 4
# More processes than any machine has cores are a slip.
_WORKERS_MAX = 4096


# Compared and hashed by identity: arrays have no truth value.
@dataclass(frozen=True, eq=False, repr=False)
class Flights(Guessable):
    """Flights of one vehicle after one low-pass; each counts as one sample in cross-validation.

    `flights[0]`, `flights[1:]` and `flights["train_1"]` are `Flights` too. SI units, body axes
    forward-right-down; arrays have a row for each sample, one flight after another.

    Attributes:
        prepared: the flights, one by one.
        vehicle: that flew.
        cutoff_hz: of the low-pass over all signals; a model is used on flights of the one that it learned
            from.
    """

    prepared: tuple[PreparedFlight, ...]
    vehicle: Vehicle
    cutoff_hz: float = CUTOFF_HZ["default"]

    def __post_init__(self) -> None:
        """Refuse what are no flights, two of one name, and one that is there twice."""
        prepared = array_checks.several("prepared", self.prepared, PreparedFlight, "load_flights gives them")
        array_checks.instance("vehicle", self.vehicle, Vehicle, LOAD_VEHICLE)
        array_checks.number("cutoff_hz", self.cutoff_hz, above=0.0)
        object.__setattr__(self, "prepared", tuple(prepared))
        if not prepared:
            raise ArgumentError("flights: expected one at least, found none")
        known: dict[str, str] = {}
        for place, (name, flight) in enumerate(zip(self.names, prepared, strict=True)):
            if name in self.names[:place]:
                raise ArgumentError(
                    f"flights: two are called {name}: load them in one call, which names them by folder"
                )
            if flight.sha256 and known.setdefault(flight.sha256, name) != name:
                raise ArgumentError(
                    f"flights: {known[flight.sha256]} and {name} are the same flight: give it once"
                )

    @classmethod
    def from_arrays(  # noqa: PLR0913 - a name for each array
        cls,
        time_ns: npt.ArrayLike,
        *,
        vehicle: Vehicle | str | Path,
        velocity: npt.ArrayLike,
        attitude: npt.ArrayLike,
        rates: npt.ArrayLike,
        specific_force: npt.ArrayLike,
        rotor_speeds: npt.ArrayLike,
        position: npt.ArrayLike | None = None,
        wind: npt.ArrayLike | None = None,
        air_density: npt.ArrayLike | None = None,
        flight: npt.ArrayLike | None = None,
        cutoff_hz: float = CUTOFF_HZ["default"],
    ) -> Flights:
        """Flights from arrays of your own, low-passed as those of logs are; the part in the air is kept.

        Args:
            time_ns: (N,) int64 stamps, rising within a flight.
            vehicle: that flew; its name in config/vehicles, or its file.
            velocity: (N, 3) m/s over ground, body axes.
            attitude: (N, 4) unit quaternions w, x, y, z, body to world (north-east-down).
            rates: (N, 3) rad/s, body axes.
            specific_force: (N, 3) m/s² of the accelerometer, body axes: z near −9.8 in hover.
            rotor_speeds: (N, rotors) rad/s, rotors in the order of the vehicle file.
            position: (N, 3) m, world; the integrated velocity unless given.
            wind: (N, 3) m/s of the air, world; none unless given.
            air_density: kg/m³, one or (N,), of which each flight's median counts: pressure [Pa] over 287.05
                times kelvin; that of the vehicle file unless given. Give `Monitor.step` the same.
            flight: (N,) label of the flight of each sample; all of one unless given.
            cutoff_hz: of the low-pass over all signals.

        Raises:
            ArgumentError: naming the array of another shape, or that is not finite.
            LogError, SignalError: naming the flight that cannot be used.
        """
        arrays = {
            "velocity": velocity,
            "attitude": attitude,
            "rates": rates,
            "specific_force": specific_force,
            "rotor_speeds": rotor_speeds,
            "position": position,
            "wind": wind,
        }
        flown = _vehicle(vehicle)
        prepared = prepared_from_arrays(time_ns, arrays, flight, flown, cutoff_hz, air_density=air_density)
        return _warned(cls(prepared, flown, cutoff_hz))

    @classmethod
    def from_pandas(
        cls,
        frame: pd.DataFrame,
        vehicle: Vehicle | str | Path,
        *,
        flight: str | None = "flight",
        time: str = "time_ns",
        columns: Mapping[str, Sequence[str]] | None = None,
        cutoff_hz: float | None = None,
        filtered: bool = False,
    ) -> Flights:
        """Flights from a table with a row for each sample, the inverse of :meth:`to_pandas`.

        Args:
            frame: with the columns of `to_pandas`, which are those of `quadpi export`; position and wind may
                be absent.
            vehicle: that flew; its name in config/vehicles, or its file.
            flight: column that tells flights apart; None for one flight.
            time: column of int64 nanoseconds.
            columns: your names of the columns of a quantity, such as `{"rates": ["p", "q", "r"]}`;
                quantities, units and frames are those of :meth:`from_arrays`.
            cutoff_hz: of the low-pass over all signals, 30 unless given; with `filtered` that of the table,
                which `frame.attrs` keeps: give it where the table went through a file.
            filtered: the signals have passed that low-pass already and are taken as they are, as those of
                `to_pandas` have, with their angular acceleration; a model fitted to them calibrates its alarm
                on smoothed states, not on those that a monitor would have.

        Raises:
            ArgumentError: naming the column that is absent or of no numbers, and for a table of `to_pandas`
                without `filtered=True`, which would be filtered twice.
            LogError, SignalError: naming the flight that cannot be used.
        """
        flown = _vehicle(vehicle)
        prepared, cutoff_hz = from_frame(
            frame, flown, cutoff_hz, flight=flight, time=time, names=columns, filtered=filtered
        )
        return _warned(cls(prepared, flown, cutoff_hz))

    def to_pandas(self) -> pd.DataFrame:
        """A row for each sample: flight, time_ns, the filtered state, and the measured wrench fx_n … mz_nm.

        `attrs` of the table hold the low-pass, `cutoff_hz`, and `rows` by flight. LogError without pandas.
        """
        return to_frame(self.prepared, self.cutoff_hz)

    def __len__(self) -> int:
        return len(self.prepared)

    def __iter__(self) -> Iterator[Flights]:
        return (self[place] for place in range(len(self)))

    def __contains__(self, name: object) -> bool:
        return name in self.names

    def __getitem__(self, key: int | slice | str | Sequence[int | str] | npt.NDArray[Any]) -> Flights:
        """Part of the flights: by place, name, slice, several places or names, or a mask."""
        places: Any = [key] if isinstance(key, str) else key
        if isinstance(places, list | tuple | np.ndarray) and all(isinstance(name, str) for name in places):
            if absent := [name for name in places if name not in self.names]:
                raise KeyError(f"no flight {absent[0]}; there are {', '.join(self.names)}")
            places = [self.names.index(name) for name in places]
        places = np.atleast_1d(np.arange(len(self))[places])
        return Flights(tuple(self.prepared[k] for k in places), self.vehicle, self.cutoff_hz)

    def __add__(self, other: Flights) -> Flights:
        return joined_flights([self, other]) if isinstance(other, Flights) else NotImplemented

    def __array__(self, *_: Any, **__: Any) -> npt.NDArray[Any]:
        """Refuse to be one array, as a scaler before the model would make of them."""
        raise ArgumentError(
            "flights: no array, so steps before WrenchModel cannot change them: inputs (N, 19) and wrench "
            "(N, 6) are arrays, to_pandas() is a table; WrenchModel(estimator=make_pipeline(…)) scales the "
            "inputs of a regressor"
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Of the flights."""
        return tuple(flight.name for flight in self.prepared)

    @property
    def labels(self) -> npt.NDArray[np.int64]:
        """Number (N,) of the flight of each sample, from 0."""
        return np.repeat(np.arange(len(self)), [len(flight.time) for flight in self.prepared])

    @property
    def time(self) -> Array:
        """(N,) s since the start of each recording."""
        return np.concatenate([flight.time for flight in self.prepared])

    @property
    def inputs(self) -> Array:
        """Input vectors (N, 19), columns as `quadpi_core.inputs.INPUT_NAMES`."""
        return np.concatenate([flight.inputs for flight in self.prepared])

    @property
    def wrench(self) -> Array:
        """Measured forces and moments (N, 6) N and Nm, columns Fx … Mz, without gravity."""
        return np.concatenate([flight.wrench for flight in self.prepared])

    @property
    def speed(self) -> Array:
        """(N,) m/s relative to the air."""
        return np.asarray(np.linalg.norm(self.inputs[:, VELOCITY_INPUTS], axis=1))

    def __repr__(self) -> str:
        shown = ", ".join(f"{name:.24}" for name in self.names[:_NAMES_SHOWN])
        more = ", …" if len(self) > _NAMES_SHOWN else ""
        seconds = sum(float(flight.time[-1] - flight.time[0]) for flight in self.prepared)
        return (
            f"<Flights: {counted(len(self))} of {self.vehicle.name:.40} ({shown}{more}), {seconds:.0f} s, "
            f"{len(self.time)} samples, up to {self.speed.max():.1f} m/s, low-pass {self.cutoff_hz:g} Hz>"
        )

    def _repr_html_(self) -> str:
        rows = [
            (
                flight.name,
                f"{flight.time[-1] - flight.time[0]:.1f}",
                len(flight.time),
                f"{mean_rate_hz(flight.time):.0f}",
                f"{self[place].speed.max():.1f}",
                "; ".join(map(str, flight.quality.findings)),
            )
            for place, flight in enumerate(self.prepared)
        ]
        headings = ("flight", "in the air [s]", "samples", "rate [Hz]", "up to [m/s]", "likely mistakes")
        return html_table(repr(self), headings, rows)


def load_flights(
    logs: str | Path | Iterable[str | Path],
    vehicle: Vehicle | str | Path,
    *,
    cutoff_hz: float = CUTOFF_HZ["default"],
    mapping: MappingOrOptions = None,
    left_out: LeftOutFlights = None,
    workers: int | None = None,
) -> Flights:
    """Read, fuse and filter flights from logs of any known format; only the part in the air is kept.

    Where a flight has motor commands and no rotor speeds, those of all flights are made of commands;
    the log (`logging`) says so.

    Args:
        logs: paths, or patterns such as `"bags/train_*.mcap"`; one alone is a list of one.
        vehicle: that flew; its name in config/vehicles, or its file.
        cutoff_hz: of the low-pass over all signals.
        mapping: what the logs do not say of themselves; see docs/import-logs.md.
        left_out: a list of yours, to which flights that cannot be used are added, each with its reason;
            without it the first of them is an error.
        workers: processes that read; as many as pay unless given.

    Raises:
        ArgumentError: for what are no paths, vehicle, frequency, list or number of processes.
        LogError: for a pattern that fits no file, and what cannot be read or used, naming the file.
        SignalError: naming the file, where the signals cannot be fused.
        VehicleError: for a vehicle file that cannot be used.
    """
    flown = _vehicle(vehicle)
    if left_out is not None:
        array_checks.instance("left_out", left_out, list)
    if workers is not None:
        workers = array_checks.whole("workers", workers, 1, _WORKERS_MAX)
    paths = [path for log in array_checks.paths("logs", logs) for path in _matching(log)]
    read = prepare_with_motors(
        paths, flown, cutoff_hz, mapping=mapping, workers=Workers(workers), left_out=left_out
    )
    if read.said:
        _log.warning("%s", read.said)
    return _warned(Flights(tuple(read.flights), read.vehicle, cutoff_hz))


def flights_in(name: str, given: object) -> Flights:
    """Flights that a caller hands in: one `Flights`, or several in a list, as cross-validation does.

    Raises:
        ArgumentError: for anything else, such as bare arrays; it says what to call.
    """
    if isinstance(given, Flights):
        return given
    if isinstance(given, list | tuple) and given and all(isinstance(one, Flights) for one in given):
        return joined_flights(given)
    why = ""
    if isinstance(given, np.ndarray) or hasattr(given, "__array__"):
        why = " (a model also needs how the rotors speed up, and which vehicle it is)"
    types = array_checks.description(given)
    raise ArgumentError(
        f"{name}: expected Flights, found {types}{why}; load_flights(logs, vehicle) reads them, "
        "Flights.from_pandas and Flights.from_arrays make them of data of your own"
    )


def joined_flights(parts: Sequence[Flights]) -> Flights:
    """All flights of several.

    Raises:
        ArgumentError: where vehicles or low-passes differ; for two flights of one name, and one given twice.
    """
    first = parts[0]
    for part in parts[1:]:
        if part.vehicle.fingerprint != first.vehicle.fingerprint:
            raise ArgumentError(
                f"flights: of two vehicles, {first.vehicle.name} and {part.vehicle.name}, or two versions"
            )
        if part.cutoff_hz != first.cutoff_hz:
            raise ArgumentError(
                f"flights: low-passed at {first.cutoff_hz:g} and at {part.cutoff_hz:g} Hz: load them alike"
            )
    return Flights(tuple(one for part in parts for one in part.prepared), first.vehicle, first.cutoff_hz)


def _warned(flights: Flights) -> Flights:
    """The flights, after a warning of each likely mistake in their data, such as an order of rotors."""
    for flight in flights.prepared:
        for finding in flight.quality.findings:
            warnings.warn(f"flight {flight.name}: {finding}", stacklevel=3)
    return flights


def _vehicle(given: Vehicle | str | Path) -> Vehicle:
    if isinstance(given, str | Path) and not is_config_path(given) and Path(given).is_file():
        raise ArgumentError(
            f"vehicle: {given} is a log: load_flights(logs, vehicle), with the name of a vehicle or its .yaml"
        )
    return given if isinstance(given, Vehicle) else Vehicle.load(given)


def _matching(log: Path) -> list[str | Path]:
    """The files that a pattern fits, in order of their names; a path that exists is no pattern."""
    if log.exists() or not glob.has_magic(str(log)):
        return [log]
    paths = sorted(glob.glob(str(log), recursive=True))  # noqa: PTH207 - takes no absolute pattern
    if not paths:
        raise LogError(f"{log}: no file fits this pattern")
    return list(paths)
