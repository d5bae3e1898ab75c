# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulation that is known by the wrench that it recorded beside flights, in their logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from quadpi_core.brief_repr import brief_repr
from quadpi_core.discrepancy.instruments import Instruments, learned_weights
from quadpi_core.discrepancy.simulations import Column, Simulation, Tolerances, read_tolerances
from quadpi_core.discrepancy.uncertain_parts import ROTORS as OF_ROTORS
from quadpi_core.discrepancy.uncertain_parts import Part, part_columns
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import MAX_GAP_NS, Flight, RotorSpeedStream, Stamps, WrenchStream
from quadpi_core.flight_files import FlightFile, LeftOutFlights, for_each_flight
from quadpi_core.frames import Array
from quadpi_core.logs import read_recording
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.parallel import Workers
from quadpi_core.reading_options import MappingOrOptions
from quadpi_core.signals.filters import zero_phase
from quadpi_core.signals.resample import (
    first_gap,
    interpolate,
    interpolate_columns,
    nominal_rate,
    uniform_stamps,
)
from quadpi_core.vehicle import ROTORS, Vehicle


class Recorded(NamedTuple):
    """Wrench (N, 6) of one flight at even stamps (N,), low-passed as flights are."""

    time_ns: Stamps
    wrench: Array


@dataclass(frozen=True)
class RecordedSimulation(Simulation):
    """Wrench of each flight that a simulation of any kind recorded on the topic `simulation/wrench`.

    It cannot be evaluated for other wind or rotor speeds. What those would change follows from functions of
    the motion that were learned from flights, see :mod:`.instruments`. The part in proportion to the squared
    rotor speeds counts as thrust and torque.

    Attributes:
        wrenches: recorded wrench by the source of the flight.
        thrust_n_s2, torque_nm_s2: thrust and torque of a rotor over its squared speed.
        weights: (J, 6) by the source of the flight, of the functions of `instruments` in the rest of the
            wrench; empty before `learned`. Those of any other flight are learned from it alone.
    """

    __repr__ = brief_repr

    vehicle: Vehicle
    wrenches: Mapping[str, Recorded]
    thrust_n_s2: float
    torque_nm_s2: float
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    name: str = "recorded"
    weights: Mapping[str, Array] = field(default_factory=dict)
    own_inputs: ClassVar[bool] = True

    @classmethod
    def load(
        cls,
        vehicle: str,
        bags: Sequence[Path],
        mapping: MappingOrOptions = None,
        left_out: LeftOutFlights = None,
    ) -> RecordedSimulation:
        """Read the topic from bags, and low-pass it as flights are.

        Args:
            vehicle: name or path of the vehicle file.
            bags: bags or logs of the flights.
            mapping: see :func:`quadpi_core.logs.read_recording`.
            left_out: list to which flights that cannot be used are added; without it, the first is an error.

        Raises:
            DiscrepancyError: for bags without the topic, or without rotor speeds.
            LogError: for bags and samples that cannot be read, and pauses that cannot be bridged.
        """
        flown, wrenches = Vehicle.load(vehicle), {}
        thrust, load, torque, turned = 0.0, 0.0, 0.0, 0.0
        read = for_each_flight(
            _wrench_of_flight,
            bags,
            shared=(flown, mapping),
            task="Reading wrenches",
            workers=Workers(1),
            left_out=left_out,
        )
        for _, (source, found, rotors) in read:
            wrenches[source] = found
            squares = np.square(rotors.speeds).sum(axis=1)
            signed = np.square(rotors.speeds) @ flown.rotor_spins
            wrench = interpolate_columns(found.time_ns, found.wrench, rotors.time_ns)
            thrust -= float(squares @ wrench[:, 2])
            load += float(squares @ squares)
            torque += float(signed @ wrench[:, 5])
            turned += float(signed @ signed)
        if thrust <= 0.0:
            raise DiscrepancyError(f"topic {WrenchStream.topic}: its Fz gives no thrust as rotors turn")
        torque /= max(turned, float(np.finfo(float).tiny))
        return cls(flown, wrenches, thrust / load, torque, read_tolerances(vehicle), vehicle)

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        where = f"{flight.source}: topic {WrenchStream.topic}"
        if flight.source not in self.wrenches:
            raise DiscrepancyError(f"{where}: was not read")
        recorded = self.wrenches[flight.source]
        stamps = flight.start_ns + np.round(1e9 * flight.time).astype(np.int64)
        first, last = recorded.time_ns[0] - stamps[0], recorded.time_ns[-1] - stamps[0]
        end = stamps[-1] - stamps[0]
        if first > MAX_GAP_NS or last < end - MAX_GAP_NS:
            raise DiscrepancyError(
                f"{where}: its stamps, {1e-9 * first:.3f} to {1e-9 * last:.3f} s after the start of the "
                f"flight, do not cover it, 0 to {1e-9 * end:.3f} s; they must be on the clock of the sensors"
            )
        return interpolate_columns(recorded.time_ns, recorded.wrench, stamps)

    @property
    def hover_rotor_speed(self) -> float:
        """See :class:`Simulation`."""
        weight = self.vehicle.mass_kg * self.vehicle.gravity_m_s2
        return float(np.sqrt(weight / (ROTORS * self.thrust_n_s2)))

    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """See :class:`Simulation`."""
        squares = np.square(flight.rotor_speeds)
        return self.thrust_n_s2 * squares, self.torque_nm_s2 * squares * self.vehicle.rotor_spins

    def learned(self, flights: Sequence[tuple[Flight, Flight]]) -> RecordedSimulation:
        """See :class:`Simulation`; the rest beside the rotors, as functions of the quiet motion."""
        rest = [self.wrench(flight) - self._rotors(flight) for flight, _ in flights]
        functions = [self._instruments(quiet).values for _, quiet in flights]
        found = learned_weights(rest, functions, flights[0][0].rate_hz)
        weights = {flight.source: own for (flight, _), own in zip(flights, found, strict=True)}
        return replace(self, weights=weights)

    def knowing(self, flight: Flight) -> RecordedSimulation:
        """See :class:`Simulation`."""
        return self if flight.source in self.weights else self.learned([(flight, flight)])

    def answering(self, flight: Flight, corrected: Flight) -> RecordedSimulation:
        """See :class:`Simulation`; what it recorded, and what the learned functions say of the difference."""
        known = self.knowing(flight)
        wrench = known.wrench(flight) + known.explained(corrected) - known.explained(flight)
        stamps = flight.start_ns + np.round(1e9 * flight.time).astype(np.int64)
        return replace(known, wrenches={**known.wrenches, flight.source: Recorded(stamps, wrench)})

    def explained(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        return self._rotors(flight) + self._instruments(flight).values @ self._weights(flight)

    def uncertain(self, flight: Flight) -> list[Column]:
        """See :class:`Simulation`; by :func:`part_columns`."""
        found, weights = self._instruments(flight), self._weights(flight)
        parts = [Part(OF_ROTORS, self._rotors(flight), OF_ROTORS)]
        for name, law, functions in found.parts:
            parts.append(Part(name, found.values[:, functions] @ weights[functions], law))
        return part_columns(parts, self.tolerances)

    def _weights(self, flight: Flight) -> Array:
        return self.knowing(flight).weights[flight.source]

    def _instruments(self, flight: Flight) -> Instruments:
        return Instruments.of(flight, self.vehicle, self.hover_rotor_speed)

    def _rotors(self, flight: Flight) -> Array:
        """Wrench (N, 6) of thrust and torque in proportion to the squared rotor speeds."""
        thrusts, torques = self.thrusts(flight)
        x, y, _ = self.vehicle.rotor_positions.T
        rotors = np.zeros((len(flight), 6))
        rotors[:, 2], rotors[:, 5] = -thrusts.sum(axis=1), torques.sum(axis=1)
        rotors[:, 3], rotors[:, 4] = -thrusts @ y, thrusts @ x
        return rotors


def _wrench_of_flight(
    task: tuple[Vehicle, MappingOrOptions], file: FlightFile
) -> tuple[str, Recorded, RotorSpeedStream]:
    """Source, wrench and rotor speeds of a flight."""
    recording = read_recording(file.path, *task)
    if recording.simulated is None:
        raise DiscrepancyError(f"{file.path}: topic {WrenchStream.topic}: missing: no simulated wrench")
    if recording.rotor_speeds is None:
        raise DiscrepancyError(f"{file.path}: topic rotor_speeds: missing")
    return recording.source, _even(recording.simulated, str(file.path)), recording.rotor_speeds


def _even(stream: WrenchStream, source: str) -> Recorded:
    stream.check(source)
    gap = first_gap(stream.time_ns, MAX_GAP_NS)
    if gap is not None:
        raise DiscrepancyError(
            f"{source}: topic {stream.topic}: sample {gap}: comes more than "
            f"{1e-9 * MAX_GAP_NS:g} s after the one before"
        )
    grid = uniform_stamps(stream.time_ns)
    wrench = interpolate(stream.time_ns, stream.wrench, grid, MAX_GAP_NS).values
    rate_hz, cutoff_hz = nominal_rate(grid), CUTOFF_HZ["default"]
    if 2.0 * cutoff_hz < rate_hz:
        wrench = zero_phase(wrench, cutoff_hz, rate_hz, slice(0)).value
    return Recorded(grid, wrench)
