# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""One vehicle as it truly is, and the flights that its owner gets of it."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from blind.formulas import Formulas
from quadpi_core.estimator.fusion import fuse_airborne
from quadpi_core.flight import Flight
from quadpi_core.frames import Array, rotate_body_to_world
from quadpi_core.models.model_kind import CUTOFF_HZ
from quadpi_core.simulation.flying import SimulatedVehicle, simulate_flight
from quadpi_core.simulation.rotor_local import RotorLocalCoefficients
from quadpi_core.simulation.scenario import FlightPlan
from quadpi_core.simulation.sensor_noise import SensorSuite
from quadpi_core.simulation.sensors import sense
from quadpi_core.simulation.truth import STEP_HZ, Truth
from quadpi_core.vehicle import Vehicle

# One standard deviation of what no simulation knows better.
THRUST, FLOW, INERTIA, CENTRE_M = 0.01, 0.1, 0.02, 0.0003
# Each its own factor; airframe_* hold a polynomial each, which stays in shape.
_FACTORS = ("torque", "rotor_force_along", "rotor_force_across", "rotor_moment_along", "rotor_moment_across")
_AIRFRAME = tuple(f"airframe_{axis}" for axis in ("fx", "fy", "fz", "mx", "my", "mz"))


@dataclass(frozen=True)
class Specimen:
    """A vehicle that differs from its file.

    Attributes:
        flown: mass, inertia, coefficients and motors as they are; rotors still where the file has them.
        centre: (3,) m, true centre of gravity from that of the file.
        formulas: parameters by name, see :mod:`blind.formulas`.
        sensors: what they do to what happened, (Truth) -> Truth, in order.
        yaw_authority: of the rotors as the controller believes, of that in the file: one that knew nothing of
            the spin-up would shake the vehicle.
        truth: parameters that the library's effect should have, by `effect.parameter`, where both mean the
            same.
    """

    flown: SimulatedVehicle
    centre: Array = field(default_factory=lambda: np.zeros(3))
    formulas: Mapping[str, Sequence[float]] = field(default_factory=dict)
    sensors: tuple[Callable[[Truth], Truth], ...] = ()
    yaw_authority: float = 1.0
    truth: Mapping[str, float] = field(default_factory=dict)

    @property
    def vehicle(self) -> Vehicle:
        return self.flown.vehicle

    @property
    def coefficients(self) -> RotorLocalCoefficients:
        return self.flown.aerodynamics.coefficients

    def with_vehicle(self, **changes: object) -> Specimen:
        return replace(self, flown=self.flown.altered(replace(self.vehicle, **changes)))

    def with_coefficients(self, **changes: object) -> Specimen:
        changed = replace(self.coefficients, **changes)
        return replace(
            self,
            flown=replace(self.flown, aerodynamics=replace(self.flown.aerodynamics, coefficients=changed)),
        )

    def with_formula(self, name: str, *parameters: float) -> Specimen:
        return replace(self, formulas={**self.formulas, name: parameters})

    def with_sensor(self, sensor: Callable[[Truth], Truth]) -> Specimen:
        return replace(self, sensors=(*self.sensors, sensor))

    def knowing(self, **truth: float) -> Specimen:
        named = {name.replace("__", "."): float(value) for name, value in truth.items()}
        return replace(self, truth={**self.truth, **named})

    def shifted(self, centre: Array) -> Specimen:
        return replace(self, centre=self.centre + centre)

    def fly(self, plan: FlightPlan, suite: SensorSuite, seed: int) -> Flight:
        """The flight that the owner of the vehicle gets: sensed, fused, filtered as identification does."""
        owned = Vehicle.load(plan.vehicle)
        truth = self._truth(plan)
        for sensor in (self._at_nominal_centre, *self.sensors):
            truth = sensor(truth)
        # The accelerometer sits where the file has the centre of gravity.
        placed = replace(suite, imu=replace(suite.imu, position=tuple(-self.centre)))
        sensed = sense(truth, owned, placed, {}, (), seed)
        return fuse_airborne(sensed.recording, owned, CUTOFF_HZ["default"])

    def _truth(self, plan: FlightPlan) -> Truth:
        formulas = dict(self.formulas)
        if self.centre.any():
            formulas["airframe_offset"] = tuple(self.centre)
        about_centre = self.with_vehicle(rotor_positions=self.vehicle.rotor_positions - self.centre).flown
        torque = self.coefficients.torque * self.yaw_authority
        believed = replace(self, flown=about_centre).with_coefficients(torque=torque).flown
        steered = _Steered(believed.aerodynamics, believed.motor_time_constant, true=about_centre)
        extra = [(Formulas(formulas), ())] if formulas else []
        return simulate_flight(plan.name, steered, plan.reference(STEP_HZ), extra=extra)

    def _at_nominal_centre(self, truth: Truth) -> Truth:
        arm = np.broadcast_to(-self.centre, truth.position.shape)
        return replace(truth, position=truth.position + rotate_body_to_world(truth.attitude, arm))


@dataclass(frozen=True, kw_only=True)
class _Steered(SimulatedVehicle):
    """As the controller believes; `true` is what flies."""

    true: SimulatedVehicle

    def altered(self, vehicle: Vehicle) -> SimulatedVehicle:  # noqa: ARG002
        return self.true


def ordinary(nominal: SimulatedVehicle, rng: np.random.Generator) -> Specimen:
    """A vehicle as good as its file: every number of it off by what its tolerance says."""
    coefficients = nominal.aerodynamics.coefficients
    thrust = coefficients.thrust.copy()
    thrust[0] *= 1.0 + THRUST * rng.standard_normal()
    thrust[1:] *= 1.0 + FLOW * rng.standard_normal()
    changed = {
        name: getattr(coefficients, name) * (1.0 + FLOW * rng.standard_normal())
        for name in (*_FACTORS, *_AIRFRAME)
    }
    scale = np.sqrt(1.0 + INERTIA * rng.standard_normal(3))
    specimen = Specimen(nominal).with_coefficients(thrust=thrust, **changed)
    specimen = specimen.with_vehicle(inertia=nominal.vehicle.inertia * scale[:, None] * scale)
    return specimen.shifted(CENTRE_M * rng.standard_normal(3))


def flights_of(
    specimen: Specimen, plans: Iterable[FlightPlan], suite: SensorSuite, seed: int
) -> list[Flight]:
    """Flights of a specimen, each with noise of its own."""
    return [specimen.fly(plan, suite, zlib.crc32(f"{seed} {plan.name}".encode())) for plan in plans]
