# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations other than quadpi's own, known only by the wrench that they give.

A function from a flight to its wrench, an identified model, or a wrench that was recorded in bags.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.discrepancy.simulations import (
    Column,
    Margins,
    Simulation,
    Tolerances,
    axis_columns,
    read_tolerances,
)
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, MAX_GAP_NS, Flight, Stamps, WrenchStream
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, flight_derivatives, flight_inputs
from quadpi_core.logs import read_recording
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.model_kind import CUTOFF_HZ, Evaluation
from quadpi_core.signals.filters import zero_phase
from quadpi_core.signals.resample import (
    first_gap,
    interpolate,
    interpolate_columns,
    nominal_rate,
    uniform_stamps,
)
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.vehicle import ROTORS, Vehicle

_HOVER_ROUNDS = 10
UNJUDGED_MOST = Threshold(
    "samples that a model cannot judge",
    0.05,
    "of a flight",
    "beyond, what bridges them would be compared rather than the model",
    CONVENTION,
)


@dataclass(frozen=True)
class CallableSimulation(Simulation):
    """Any function from a flight to its wrench.

    Its wrench for the same rotor speeds in still air without rotation counts as thrust and torque of the
    rotors. What body rates add, and what the airspeed adds, have one uncertain coefficient per axis each.
    """

    name: str
    vehicle: Vehicle
    function: Callable[[Flight], Array]
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    code: str = ""

    def wrench(self, flight: Flight) -> Array:
        """See :class:`Simulation`."""
        try:
            wrench = np.asarray(self.function(flight), dtype=float)
        except Exception as error:  # the user's code may raise anything
            raise DiscrepancyError(
                f"{self.name}: raised {type(error).__name__} for flight {flight.name}: {error}"
            ) from error
        if wrench.shape != (len(flight), len(AXES)):
            raise DiscrepancyError(
                f"{self.name}: flight {flight.name}: expected a wrench of shape "
                f"{(len(flight), len(AXES))}, found {wrench.shape}"
            )
        finite = np.isfinite(wrench).all(axis=1)
        return wrench if finite.all() else self._without_gaps(flight, wrench, finite)

    def _without_gaps(
        self,
        flight: Flight,
        wrench: Array,  # noqa: ARG002 - for those that can bridge them
        finite: npt.NDArray[np.bool_],
    ) -> Array:
        """The wrench (N, 6) of a flight of which some samples are no numbers."""
        sample = int(np.argmin(finite))
        raise DiscrepancyError(f"{self.name}: flight {flight.name}: sample {sample}: not finite")

    @cached_property
    def hover_rotor_speed(self) -> float:
        """See :class:`Simulation`; found by iteration, as thrust is about quadratic in the speed."""
        vehicle = self.vehicle
        weight = vehicle.mass_kg * vehicle.gravity_m_s2
        speed = self._about_hover
        for _ in range(_HOVER_ROUNDS):
            thrust = -float(self.wrench(_hover(vehicle, speed))[0, 2])
            if thrust <= 0.0:
                raise DiscrepancyError(f"{self.name}: gives no thrust at rotor speeds of {speed:.0f} rad/s")
            speed *= np.sqrt(weight / thrust)
        return float(speed)

    @property
    def _about_hover(self) -> float:
        """Rotor speed [rad/s] at which the iteration for hover starts."""
        return 0.5 * self.vehicle.rotor_speed_max_rad_s

    def thrusts(self, flight: Flight) -> tuple[Array, Array]:
        """See :class:`Simulation`; those of hover, shared among the rotors by their squared speeds."""
        still = self.wrench(_still(flight))
        squares = np.square(flight.rotor_speeds)
        total = squares.sum(axis=1)
        thrust = -(still[:, 2] @ total) / max(float(total @ total), np.finfo(float).tiny)
        signed = squares @ self.vehicle.rotor_spins
        torque = (still[:, 5] @ signed) / max(float(signed @ signed), float(np.finfo(float).tiny))
        return thrust * squares, torque * squares * self.vehicle.rotor_spins

    def uncertain(self, flight: Flight) -> list[Column]:
        """Per axis the parts of the rotors at rest, of body rates and of the airspeed."""
        moved, still = self.wrench(_without_airspeed(flight)), self.wrench(_still(flight))
        parts = {"rotors": still, "rates": moved - still, "airspeed": self.wrench(flight) - moved}
        return [column for column in axis_columns(parts, self.tolerances) if np.any(column.wrench)]


@dataclass(frozen=True)
class ModelSimulation(CallableSimulation):
    """The predictions of an identified model of all six axes.

    Flights must have passed the low-pass of the model.
    """

    model: AerodynamicModel | None = None

    @classmethod
    def load(cls, folder: str | Path, vehicle: str | Path | None = None) -> ModelSimulation:
        """Read a model folder.

        Args:
            folder: model folder.
            vehicle: name or path of the vehicle file; the vehicle that the model names unless given.

        Raises:
            ModelError: for a folder that is no model, or a model of another vehicle.
            VehicleError: if the vehicle file cannot be read.
            DiscrepancyError: for a model that lacks an axis.
        """
        model = AerodynamicModel.load(folder)
        file = str(vehicle or model.vehicle)
        flown = model.load_vehicle(vehicle)
        lacking = [axis for axis in AXES if axis not in model.axes]
        if lacking:
            raise DiscrepancyError(
                f"model {folder}: lacks {', '.join(lacking)}; a simulation has all six axes"
            )

        def predict(flight: Flight) -> Array:
            return model.evaluate(
                flight_inputs(flight, flown), derivatives=flight_derivatives(flight)
            ).predicted

        return cls(str(folder), flown, predict, read_tolerances(file), file, model=model)

    def unjudged(self, flight: Flight) -> int:
        """See :class:`Simulation`; those that the model gives no finite wrench for."""
        return int(np.sum(~np.isfinite(self.function(flight)).all(axis=1)))

    def _without_gaps(self, flight: Flight, wrench: Array, finite: npt.NDArray[np.bool_]) -> Array:
        """The wrench with the samples left out that the model cannot judge: their neighbours bridge them.

        Raises:
            DiscrepancyError: where those are too many to say anything of the flight.
        """
        share = 1.0 - float(np.mean(finite))
        if share > UNJUDGED_MOST.value:
            raise DiscrepancyError(
                f"{self.name}: flight {flight.name}: the model gives no finite wrench for {share:.0%} of it, "
                f"first for sample {int(np.argmin(finite))}"
            )
        rows = np.arange(len(wrench))
        return np.column_stack([np.interp(rows, rows[finite], axis[finite]) for axis in wrench.T])

    def intervals(self, flight: Flight) -> tuple[Array, Array]:
        """Lower and upper bounds (N, 6) at the confidence of the model."""
        found = self._evaluated(flight)
        return found.lower, found.upper

    def margins(self, flight: Flight) -> Margins | None:
        """See :class:`Simulation`; at the confidence of the model."""
        assert self.model is not None  # by load
        found = self._evaluated(flight)
        return Margins(found.lower - found.predicted, found.upper - found.predicted, self.model.confidence)

    def _evaluated(self, flight: Flight) -> Evaluation:
        assert self.model is not None  # by load
        inputs = flight_inputs(flight, self.vehicle)
        return self.model.evaluate(inputs, derivatives=flight_derivatives(flight))

    @property
    def _about_hover(self) -> float:
        """The middle of the range that the model was identified on."""
        assert self.model is not None  # by load
        envelope, index = self.model.envelope, INPUT_INDEX["omega_avg"]
        return float(np.mean((envelope.lower[index], envelope.upper[index])))


def _without_airspeed(flight: Flight) -> Flight:
    none = np.zeros((len(flight), 3))
    return replace(flight, velocity=none, wind=none)


def _still(flight: Flight) -> Flight:
    none = np.zeros((len(flight), 3))
    return replace(_without_airspeed(flight), rates=none, angular_acceleration=none)


def _hover(vehicle: Vehicle, rotor_speed: float) -> Flight:
    """A hover of two samples."""
    none = np.zeros((2, 3))
    force = np.tile([0.0, 0.0, -vehicle.gravity_m_s2], (2, 1))
    return Flight(
        name="hover",
        vehicle=vehicle.name,
        source="hover",
        start_ns=0,
        time=np.array([0.0, 0.002]),
        position=np.tile([0.0, 0.0, -10.0], (2, 1)),
        attitude=np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)),
        velocity=none,
        rates=none,
        angular_acceleration=none,
        specific_force=force,
        rotor_speeds=np.full((2, ROTORS), rotor_speed),
        wind=none,
    )


class Recorded(NamedTuple):
    """Wrench (N, 6) of one flight at even stamps (N,), low-passed as flights are."""

    time_ns: Stamps
    wrench: Array


@dataclass(frozen=True)
class RecordedSimulation(Simulation):
    """Wrench of each flight that a simulation of any kind recorded on the topic `simulation/wrench`.

    It cannot be evaluated for other wind or rotor speeds, so neither wind nor errors of rotor speeds are
    found with it. The part in proportion to the squared rotor speeds counts as thrust and torque.

    Attributes:
        wrenches: recorded wrench by the source of the flight.
        thrust_n_s2: thrust of a rotor over its squared speed.
    """

    vehicle: Vehicle
    wrenches: Mapping[str, Recorded]
    thrust_n_s2: float
    tolerances: Tolerances = field(default_factory=Tolerances)
    vehicle_file: str = ""
    name: str = "recorded"
    own_inputs: ClassVar[bool] = True

    @classmethod
    def load(cls, vehicle: str, bags: Sequence[Path], mapping: str | None = None) -> RecordedSimulation:
        """Read the topic from bags, and low-pass it as flights are.

        Args:
            vehicle: name or path of the vehicle file.
            bags: bags or logs of the flights.
            mapping: see :func:`quadpi_core.logs.read_recording`.

        Raises:
            DiscrepancyError: for bags without the topic, or without rotor speeds.
            LogError: for bags and samples that cannot be read, and pauses that cannot be bridged.
        """
        flown, wrenches = Vehicle.load(vehicle), {}
        thrust, load = 0.0, 0.0
        for bag in bags:
            recording = read_recording(bag, flown, mapping)
            if recording.simulated is None:
                raise DiscrepancyError(f"{bag}: topic {WrenchStream.topic}: missing: no simulated wrench")
            if recording.rotor_speeds is None:
                raise DiscrepancyError(f"{bag}: topic rotor_speeds: missing")
            found = _even(recording.simulated, str(bag))
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
        return interpolate_columns(recorded.time_ns, recorded.wrench, stamps)

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
        """Per axis the part of thrust and torque, and the rest."""
        wrench = self.wrench(flight)
        thrusts, torques = self.thrusts(flight)
        x, y, _ = self.vehicle.rotor_positions.T
        rotors = np.zeros_like(wrench)
        rotors[:, 2], rotors[:, 5] = -thrusts.sum(axis=1), torques.sum(axis=1)
        rotors[:, 3], rotors[:, 4] = -thrusts @ y, thrusts @ x
        return axis_columns({"rotors": rotors, "the rest": wrench - rotors}, self.tolerances)


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
