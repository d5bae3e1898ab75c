# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A simulated wrench that was recorded in the bags of the flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from quadpi_core.discrepancy.simulations import Column, Simulation, Tolerances, axis_columns, read_tolerances
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import MAX_GAP_NS, Flight, Stamps, WrenchStream
from quadpi_core.frames import Array
from quadpi_core.logs.bags import read_bag
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.signals.filters import zero_phase
from quadpi_core.signals.resample import first_gap, interpolate, nominal_rate, uniform_stamps
from quadpi_core.vehicle import ROTORS, Vehicle


class Recorded(NamedTuple):
    """Wrench (N, 6) of one flight at even stamps (N,), low-passed as flights are."""

    time_ns: Stamps
    wrench: Array


@dataclass(frozen=True)
class RecordedSimulation(Simulation):
    """What a simulation of any kind gave for each flight, on the topic `simulation/wrench`.

    It cannot answer for other winds or rotor speeds than it was given, so wind and effects on rotor speeds
    are not found with it. The part in proportion to the rotor speeds squared counts as thrust and torque.

    Attributes:
        wrenches: by the source of the flight.
        thrust_n_s2: of a rotor, over its speed squared.
    """

    vehicle: Vehicle
    wrenches: Mapping[str, Recorded]
    thrust_n_s2: float
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    name: str = "recorded"

    @classmethod
    def load(
        cls, vehicle: str, bags: Sequence[Path], cutoff_hz: float = CUTOFF_HZ["default"]
    ) -> RecordedSimulation:
        """Read the topic from bags.

        Args:
            vehicle: name or path of the vehicle file.
            bags: of the flights.
            cutoff_hz: of the low-pass that flights pass.

        Raises:
            DiscrepancyError: for bags without the topic, or without rotor speeds.
            LogError: for bags and samples that cannot be read, and pauses that cannot be bridged.
        """
        flown, wrenches = Vehicle.load(vehicle), {}
        thrust, load = 0.0, 0.0
        for bag in bags:
            recording = read_bag(bag, flown)
            if recording.simulated is None:
                raise DiscrepancyError(f"{bag}: topic {WrenchStream.topic}: missing: no simulated wrench")
            if recording.rotor_speeds is None:
                raise DiscrepancyError(f"{bag}: topic rotor_speeds: missing")
            found = _even(recording.simulated, str(bag), cutoff_hz)
            wrenches[recording.source] = found
            rotors = recording.rotor_speeds
            squares = np.square(rotors.speeds).sum(axis=1)
            force = np.interp(rotors.time_ns, found.time_ns, found.wrench[:, 2])
            thrust -= float(squares @ force)
            load += float(squares @ squares)
        if thrust <= 0.0:
            raise DiscrepancyError(f"topic {WrenchStream.topic}: its Fz gives no thrust as rotors turn")
        return cls(flown, wrenches, thrust / load, read_tolerances(vehicle), vehicle)

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
        columns = [np.interp(stamps, recorded.time_ns, column) for column in recorded.wrench.T]
        return np.stack(columns, axis=1)

    @property
    def hover_rotor_speed(self) -> float:
        """See :class:`Simulation`."""
        weight = self.vehicle.mass_kg * self.vehicle.gravity_m_s2
        return float(np.sqrt(weight / (ROTORS * self.thrust_n_s2)))

    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """See :class:`Simulation`."""
        squares = np.square(flight.rotor_speeds)
        signed = squares @ self.vehicle.rotor_spins
        torque = (self.wrench(flight)[:, 5] @ signed) / max(float(signed @ signed), np.finfo(float).tiny)
        return self.thrust_n_s2 * squares, torque * squares * self.vehicle.rotor_spins

    def uncertain(self, flight: Flight) -> list[Column]:
        """Per axis: of thrust and torque, and of the rest."""
        wrench = self.wrench(flight)
        thrusts, torques = self.thrusts(flight)
        x, y, _ = self.vehicle.rotor_positions.T
        rotors = np.zeros_like(wrench)
        rotors[:, 2], rotors[:, 5] = -thrusts.sum(axis=1), torques.sum(axis=1)
        rotors[:, 3], rotors[:, 4] = -thrusts @ y, thrusts @ x
        return axis_columns({"rotors": rotors, "the rest": wrench - rotors}, self.tolerances)


def _even(stream: WrenchStream, source: str, cutoff_hz: float) -> Recorded:
    stream.check(source)
    gap = first_gap(stream.time_ns, MAX_GAP_NS)
    if gap is not None:
        raise DiscrepancyError(
            f"{source}: topic {stream.topic}: sample {gap}: comes more than "
            f"{1e-9 * MAX_GAP_NS:g} s after the one before"
        )
    grid = uniform_stamps(stream.time_ns)
    wrench = interpolate(stream.time_ns, stream.wrench, grid, MAX_GAP_NS).values
    rate_hz = nominal_rate(grid)
    if 2.0 * cutoff_hz < rate_hz:
        wrench = zero_phase(wrench, cutoff_hz, rate_hz, slice(0)).value
    return Recorded(grid, wrench)
