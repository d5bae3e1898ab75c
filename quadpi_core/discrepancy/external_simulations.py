# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations other than quadpi's own that can be called: a function from a flight to its wrench, a model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from quadpi_core.brief_repr import brief_repr
from quadpi_core.discrepancy.simulations import (
    Column,
    Margins,
    Simulation,
    Tolerances,
    read_tolerances,
)
from quadpi_core.discrepancy.uncertain_parts import EVEN, LINEAR, SQUARED, Part, part_columns
from quadpi_core.discrepancy.uncertain_parts import ROTORS as OF_ROTORS
from quadpi_core.errors import DiscrepancyError
from quadpi_core.flight import AXES, Flight
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_INDEX, flight_derivatives, flight_inputs
from quadpi_core.models.aerodynamic import AerodynamicModel, unchecked_evaluation
from quadpi_core.models.model_kind import Evaluation
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
    rotors. What body rates add, and what the airspeed adds in each order, may be wrong by itself.
    """

    __repr__ = brief_repr

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
        still = self.wrench(_moving(flight, 0.0, 0.0))
        squares = np.square(flight.rotor_speeds)
        total = squares.sum(axis=1)
        thrust = -(still[:, 2] @ total) / max(float(total @ total), np.finfo(float).tiny)
        signed = squares @ self.vehicle.rotor_spins
        torque = (still[:, 5] @ signed) / max(float(signed @ signed), float(np.finfo(float).tiny))
        return thrust * squares, torque * squares * self.vehicle.rotor_spins

    def uncertain(self, flight: Flight) -> list[Column]:
        """See :class:`Simulation`; by :func:`part_columns`."""
        still, turning = self.wrench(_moving(flight, 0.0, 0.0)), self.wrench(_moving(flight, 0.0, 1.0))
        parts = [Part(OF_ROTORS, still, OF_ROTORS), Part("rates", turning - still, LINEAR)]
        return part_columns(parts + self._by_airspeed(flight, turning), self.tolerances)

    def _by_airspeed(self, flight: Flight, turning: Array) -> list[Part]:
        """What the airspeed adds to the wrench (N, 6) of a turning body, by order and parity in the motion.

        Drag of rotors is of the first order, lift is even, and drag of the airframe reverses with its square:
        coefficients of different laws, of which one may be wrong alone. As the motion is halved, the first
        order halves and the second quarters; what is of other orders is shared between the two. Rates are
        reversed and halved with the airspeed, as a rotor feels both in the velocity of its hub.
        """

        def added(share: float) -> Array:
            return self.wrench(_moving(flight, share, share)) - self.wrench(_moving(flight, 0.0, share))

        ahead, back = self.wrench(flight) - turning, added(-1.0)
        odd, odd_of_half = 0.5 * (ahead - back), 0.5 * (added(0.5) - added(-0.5))
        return [
            Part("airspeed", 4.0 * odd_of_half - odd, LINEAR),
            Part(EVEN, 0.5 * (ahead + back), EVEN),
            Part(SQUARED, 2.0 * odd - 4.0 * odd_of_half, SQUARED),
        ]


@dataclass(frozen=True, repr=False)
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
            return unchecked_evaluation(
                model, flight_inputs(flight, flown), derivatives=flight_derivatives(flight)
            ).predicted

        return cls(str(folder), flown, predict, read_tolerances(file), file, model=model)

    def unjudged(self, flight: Flight) -> int:
        """See :class:`Simulation`; those that the model gives no finite wrench for."""
        return int(np.sum(~np.isfinite(self.function(flight)).all(axis=1)))

    def identified_on(self, flight: Flight) -> bool:
        """See :class:`Simulation`."""
        return self.model is not None and self.model.learned_from(flight.sha256)

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

    def _by_airspeed(self, flight: Flight, turning: Array) -> list[Part]:
        """See :class:`CallableSimulation`; as a whole, as a model knows nothing of a motion reversed."""
        return [Part("airspeed", self.wrench(flight) - turning, LINEAR)]

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
        return unchecked_evaluation(self.model, inputs, derivatives=flight_derivatives(flight))

    @property
    def _about_hover(self) -> float:
        """The middle of the range that the model was identified on."""
        assert self.model is not None  # by load
        envelope, index = self.model.envelope, INPUT_INDEX["omega_avg"]
        return float(np.mean((envelope.lower[index], envelope.upper[index])))


def _moving(flight: Flight, airspeed: float, rates: float) -> Flight:
    """The flight with shares, negative ones too, of its airspeed and of its rates."""
    return replace(
        flight,
        name=f"{flight.name} with its airspeed times {airspeed:g} and its rates times {rates:g}",
        velocity=airspeed * flight.velocity,
        wind=airspeed * flight.wind,
        rates=rates * flight.rates,
        angular_acceleration=rates * flight.angular_acceleration,
    )


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
