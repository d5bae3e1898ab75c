# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Reference and truth of a simulated flight, as series of samples."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np

from quadpi_core.brief_repr import brief_repr
from quadpi_core.core import compiled
from quadpi_core.flight import Flight, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, aerodynamic_inputs, relative_to_air
from quadpi_core.models.envelope import MARGIN, Envelope
from quadpi_core.records import Records
from quadpi_core.rotations import rotate_body_to_world
from quadpi_core.simulation.simulated_file import IdentifiedRange
from quadpi_core.vehicle import Vehicle


class Excursion(NamedTuple):
    """How a flight left the ranges of the inputs that a vehicle was identified on.

    Attributes:
        share: of the time outside, by more than the margin of a warning in flight.
        input: that went furthest, in widths of its range.
        reached: its value there.
        lower, upper: its range.
    """

    share: float
    input: str
    reached: float
    lower: float
    upper: float

    def sentence(self) -> str:
        """In words."""
        return (
            f"beyond the flights that the vehicle was identified on for {self.share:.1%} of its time, where "
            f"the simulation extrapolates: {self.input} reaches {self.reached:.3g} and was {self.lower:.3g} "
            f"to {self.upper:.3g}"
        )


def excursion(
    limits: IdentifiedRange | None, vehicle: Vehicle, log: Records, wind: Array
) -> Excursion | None:
    """How far records `dynamics.Logged` (N,) in a wind (N, 3) m/s of the world lie outside; None inside.

    None also for a vehicle that was not identified, which has no limits.
    """
    if limits is None or len(log) == 0:
        return None
    attitude, velocity, rates, speeds = (
        np.ascontiguousarray(log[name]) for name in ("attitude", "velocity", "rates", "rotor_speeds")
    )
    inputs = aerodynamic_inputs(relative_to_air(velocity, attitude, wind), attitude, rates, speeds, vehicle)
    distances = Envelope.outside(inputs, limits.lower, limits.upper)
    outside = np.any(distances > MARGIN, axis=1)
    if not np.any(outside):
        return None
    row, column = np.unravel_index(int(np.argmax(distances)), distances.shape)
    ends = inputs[row, column], limits.lower[column], limits.upper[column]
    return Excursion(float(np.mean(outside)), INPUT_NAMES[column], *(float(value) for value in ends))


# Instants per second at which a flight is simulated, and a reference followed.
STEP_HZ = compiled.STEP_HZ
# Instants per second that are logged: those of the fastest sensors.
LOG_HZ = 500


@dataclass(frozen=True)
class Reference:
    """N instants, evenly spaced; world north-east-down, SI.

    Attributes:
        position: (N, 3) m.
        velocity: (N, 3) m/s, its derivative.
        acceleration: (N, 3) m/s², its second derivative.
        yaw: (N,) rad, not wrapped.
        yaw_rate: (N,) rad/s, its derivative.
        tilt: (N, 2) rad of roll and pitch added to the controller's demand, to excite moments.
        thrust: (N,) added to the controller's demand, as a share of the weight.
    """

    position: Array
    velocity: Array
    acceleration: Array
    yaw: Array
    yaw_rate: Array
    tilt: Array
    thrust: Array

    def __len__(self) -> int:
        return len(self.yaw)

    def every(self, step: int) -> Reference:
        """Every `step`-th instant, from the first."""
        return Reference(**{column.name: getattr(self, column.name)[::step] for column in fields(self)})

    @classmethod
    def hover(cls, position: Array, samples: int) -> Reference:
        """Hover at a position (3,), nose north."""
        still = np.zeros((samples, 3))
        level = np.zeros(samples)
        return cls(still + position, still, still, level, level, np.zeros((samples, 2)), level)


@dataclass(frozen=True)
class Truth:
    """N instants of a simulated flight; body axes forward-right-down, world north-east-down, SI.

    Attributes:
        vehicle: as it truly flew: mass and inertia include effects such as a payload.
        position: (N, 3) m, world.
        attitude: (N, 4) body to world.
        velocity: (N, 3) m/s over ground, body axes.
        rates: (N, 3) rad/s.
        acceleration: (N, 3) m/s², second derivative of the position, world.
        angular_acceleration: (N, 3) rad/s².
        rotor_speeds: (N, rotors) rad/s.
        rotor_accelerations: (N, rotors) rad/s².
        wrench: (N, 6) aerodynamics and every effect, gravity not included.
        wind: (N, 3) m/s of the air over ground, world.
        known_wind: (N, 3) m/s, the part of it that an anemometer measures; None without one.
        reference: reference of the controller at the same instants.
        excursion: where the flight goes beyond those that the vehicle was identified on; None where it
            does not, and for a vehicle that was not identified.
    """

    __repr__ = brief_repr

    name: str
    vehicle: Vehicle
    time_ns: Stamps
    position: Array
    attitude: Array
    velocity: Array
    rates: Array
    acceleration: Array
    angular_acceleration: Array
    rotor_speeds: Array
    rotor_accelerations: Array
    wrench: Array
    wind: Array
    known_wind: Array | None
    reference: Reference
    excursion: Excursion | None = None

    def __len__(self) -> int:
        return len(self.time_ns)

    @property
    def time(self) -> Array:
        """Seconds (N,) since the first instant."""
        seconds: Array = 1e-9 * (self.time_ns - self.time_ns[0])
        return seconds

    @property
    def specific_force(self) -> Array:
        """Specific force (N, 3) m/s² at the centre of gravity, body axes."""
        return self.wrench[:, :3] / self.vehicle.mass_kg

    @property
    def position_error(self) -> Array:
        """Distance (N,) m from the reference."""
        distance: Array = np.linalg.norm(self.position - self.reference.position, axis=1)
        return distance

    @property
    def speed(self) -> Array:
        """Airspeed (N,) m/s."""
        over_ground = rotate_body_to_world(self.attitude, self.velocity)
        airspeed: Array = np.linalg.norm(over_ground - self.wind, axis=1)
        return airspeed

    def flight(self) -> Flight:
        """The truth as a flight, as if the estimator were perfect."""
        return Flight(
            name=self.name,
            vehicle=self.vehicle.name,
            source=self.name,
            start_ns=int(self.time_ns[0]),
            time=self.time,
            position=self.position,
            attitude=self.attitude,
            velocity=self.velocity,
            rates=self.rates,
            angular_acceleration=self.angular_acceleration,
            specific_force=self.specific_force,
            rotor_speeds=self.rotor_speeds,
            wind=self.wind,
        )
