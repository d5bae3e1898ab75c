# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights without rotor speeds: read by their motor commands, once the motors are identified.

The motors are identified on flights of the vehicle that have rotor speeds too; each flight is read by motors
that do not know it, so that the intervals, which are of flights left out, hold what the motors err by.
Without any rotor speeds they follow from thrust: their scale is then that of hover.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

from quadpi_core.errors import LogError, QuadpiError
from quadpi_core.estimator.fusion import COMMANDS_ALONE
from quadpi_core.field.airborne import Flown, flown
from quadpi_core.field.field_log import FieldLog
from quadpi_core.field.motor_model import Tachometers, identified_motors, motors_by_thrust, tachometers
from quadpi_core.field.other_logs import field_log_of
from quadpi_core.flight_files import FlightFile, FlightLeftOut, LeftOutFlights, for_each_flight
from quadpi_core.identification.prepared_flights import PreparedFlight, prepare_flights
from quadpi_core.logs import read_recording
from quadpi_core.parallel import DEFAULT_WORKERS, Workers
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.vehicle import Motors, Vehicle

_Read = TypeVar("_Read")


@dataclass(frozen=True)
class FlownByCommands:
    """Flights, and the vehicle that their readers took.

    Attributes:
        flights: prepared.
        vehicle: with motors, where the flights were read by their commands.
        said: what was done, in a sentence; empty for flights with rotor speeds.
    """

    flights: list[PreparedFlight] = field(repr=False)
    vehicle: Vehicle
    said: str = ""


def prepare_with_motors(
    paths: Sequence[Path | str],
    vehicle: Vehicle,
    cutoff_hz: float,
    *,
    mapping: MappingOrOptions = None,
    workers: Workers = DEFAULT_WORKERS,
    left_out: LeftOutFlights = None,
    from_commands: bool = False,
    **further: Any,
) -> FlownByCommands:
    """:func:`prepare_flights`; all by motor commands where one of them has no rotor speeds, but commands.

    Args:
        paths: see there.
        vehicle: that flew; one that has motors is taken as it is.
        cutoff_hz: see there.
        mapping: see there.
        workers: see there.
        left_out: see there.
        from_commands: also where all flights have rotor speeds.
        further: see there.

    Raises:
        QuadpiError: see there; LogError for motors that cannot be identified.
    """

    def read(flown: Vehicle, left_out: LeftOutFlights, motors: Mapping[str, Motors]) -> list[PreparedFlight]:
        reading: dict[str, Any] = {"mapping": mapping, "workers": workers, **further}
        return prepare_flights(paths, flown, cutoff_hz, left_out=left_out, motors=motors, **reading)

    with_speeds = vehicle.motors is None and from_commands
    return FlownByCommands(
        *read_with_motors(
            read, paths, vehicle, mapping=mapping, workers=workers, left_out=left_out, commands=with_speeds
        )
    )


def read_with_motors(
    read: Callable[[Vehicle, LeftOutFlights, Mapping[str, Motors]], list[_Read]],
    paths: Sequence[Path | str],
    vehicle: Vehicle,
    *,
    mapping: MappingOrOptions,
    workers: Workers,
    left_out: LeftOutFlights,
    commands: bool,
) -> tuple[list[_Read], Vehicle, str]:
    """Flights by a reader; all by motor commands where one of them has no rotor speeds, but commands.

    Args:
        read: gives flights of a vehicle, adding to those left out, by motors of single flights by path.
        paths: of the flights.
        vehicle: that flew.
        mapping: see :func:`quadpi_core.logs.read_recording`.
        workers: processes that read the commands.
        left_out: list to which flights that cannot be used are added; without it, the first is an error.
        commands: whether rotor speeds are made of commands even where all flights have them.

    Returns:
        The flights, the vehicle that their readers took, and what was done, in a sentence.

    Raises:
        QuadpiError: of the reader; LogError for motors that cannot be identified.
    """
    tried = None if left_out is None else list(left_out)
    if not commands:
        try:
            flights = read(vehicle, tried, {})
            lacking = any(COMMANDS_ALONE in one.reason for one in tried or ())
        except LogError as error:
            if COMMANDS_ALONE not in str(error):
                if left_out is not None:
                    left_out[:] = tried or ()
                raise
            lacking = True
        if not lacking:
            if left_out is not None:
                left_out[:] = tried or ()
            return flights, vehicle, ""
    motors, each, sentence = motors_of(paths, vehicle, mapping=mapping, workers=workers)
    flown_by = replace(vehicle, motors=motors)
    return read(flown_by, left_out, each), flown_by, sentence


def motors_of(
    paths: Sequence[Path | str],
    vehicle: Vehicle,
    *,
    mapping: MappingOrOptions = None,
    workers: Workers = DEFAULT_WORKERS,
) -> tuple[Motors, dict[str, Motors], str]:
    """The motors of a vehicle by its flights; for each flight, by path, those by the others; and in words.

    Raises:
        LogError: for flights that do not tell the motors, saying what they lack.
    """
    left_out: list[FlightLeftOut] = []
    read = for_each_flight(
        _commanded,
        paths,
        shared=(replace(vehicle, motors=None), workers.found_by(mapping)),
        task="Reading commands",
        workers=workers,
        left_out=left_out,
    )
    known = [found for _, found in read if found is not None]
    if not known:
        raise LogError(f"{paths[0]}: none of the flights has motor commands")
    source, _ = Counter(found.source for found in known).most_common(1)[0]
    flights = [(found.log, found.flown) for found in known if found.source == source]
    measured = [one for one in flights if one[0].rotor_speeds is not None and _is_sound(*one)]
    told = identified_motors(measured, source) if measured else None
    if told is None or isinstance(told, str):
        thrust = motors_by_thrust(flights, source, vehicle)
        if isinstance(thrust, str):
            raise LogError(f"{paths[0]}: no rotor speeds, and motors cannot be told by commands: {thrust}")
        return (*thrust, _said(thrust[0], len(flights), 0))
    return (*told, _said(told[0], len(flights), len(measured)))


def _said(motors: Motors, flights: int, measured: int) -> str:
    known = "command and battery voltage" if motors.with_battery else "command"
    lag = f"lag {1e3 * motors.lag_s:.0f} ms"
    if measured:
        errs = f"errs by up to {100.0 * max(motors.error):.2g} % (RMS, by rotor)"
        how = f"from {known}, {lag}, by {measured} flights with rotor speeds: {errs}"
    else:
        how = f"from {known}, {lag}, by the thrust of {flights} flights: their scale is assumed"
    return f"rotor speeds of all flights are made of their motor commands ({motors.source}): {how}"


@dataclass(frozen=True)
class _Commanded:
    """A flight with commands."""

    log: FieldLog
    flown: Flown
    source: str


def _commanded(shared: tuple[Vehicle, Any], file: FlightFile) -> _Commanded | None:
    vehicle, mapping = shared
    recording = read_recording(file.path, vehicle, mapping)
    if recording.commands is None:
        return None
    log = replace(field_log_of(recording), source=str(file.path))
    return _Commanded(log, flown(log), recording.command_source)


def _is_sound(log: FieldLog, flight: Flown) -> bool:
    """Whether all tachometers read the same multiple of their commands."""
    try:
        readings = tachometers(log, flight)
    except QuadpiError:
        return False
    return not isinstance(readings, Tachometers) or not readings.odd
