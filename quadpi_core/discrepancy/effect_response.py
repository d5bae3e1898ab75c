# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Response of the residual of a flight to an effect: the residual less the residual with the effect removed.

The residual is the measured wrench less the simulated one. An effect can hide in either: a force that the
simulation lacks, a wrong mass in the vehicle file, wind that was not measured, an error of a sensor. In this
form one search treats them in the same way.

Effects that are proportional to accelerations use those that the simulation predicts. The measured ones carry
the noise of the residual itself: a vehicle without mass in no air would fit every flight to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import fields, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d

from quadpi_core.discrepancy.bias_response import BiasResponse
from quadpi_core.discrepancy.own_state import Started, started
from quadpi_core.discrepancy.quiet_flight import quiet
from quadpi_core.discrepancy.simulations import Column, Simulation, Tolerances
from quadpi_core.discrepancy.whitening import BAND_HZ, Spectrum, spectrum
from quadpi_core.flight import Flight, ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.frames import Array
from quadpi_core.signals.resample import interpolate_columns
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import effect_wrench, remembered_wrenches
from quadpi_core.simulation.effect_definition import Effect
from quadpi_core.simulation.effect_registry import EFFECTS
from quadpi_core.thresholds import CONVENTION, Threshold
from quadpi_core.vehicle import Vehicle

RATE_HZ = Threshold(
    "rate of columns and residuals",
    125.0,
    "Hz",
    "more than six times the highest frequency compared, `whitening.BAND_HZ`",
    CONVENTION,
)
SLOW_HZ = Threshold(
    "angular accelerations taken as measured",
    1.0,
    "Hz, below which they are",
    "slower ones are measured with little noise; faster ones would let another inertia explain that noise",
    "13 development flights without effects: two had an inertia named with predicted accelerations alone",
)
# Parameters of an effect with a state of its own that are so near, in typical sizes, start all but alike.
_NEAR = 0.02
_NO_NUMBERS = np.random.default_rng(0)


class Compared:
    """A flight beside the simulation that it is compared with.

    Columns and residuals are thinned to about `RATE_HZ`: a flight has been low-passed far below that.

    Attributes:
        flight: input of the simulation, thinned as far as derivatives allow where it takes any.
        thinned: the flight at about `RATE_HZ`.
        highest_hz: highest frequency at which the two are compared.
    """

    def __init__(
        self,
        flight: Flight,
        simulation: Simulation,
        highest_hz: float = BAND_HZ.value,
    ) -> None:
        self.simulation = simulation
        self.highest_hz = highest_hz
        self._started: dict[str, list[tuple[Array, Started]]] = {}
        self._imu_rate_hz = flight.rate_hz
        step = max(1, int(flight.rate_hz / RATE_HZ.value + 0.5))
        self.thinned = _every(flight, step)
        # What has a memory takes derivatives, for which twice the rate is enough.
        self.step = 1 if simulation.memoryless else 2 if step % 2 == 0 else step
        self.flight = _every(flight, step // self.step)
        # What columns are made of; the residual is of the flight itself.
        self.quiet = _every(quiet(flight), step // self.step)

    @classmethod
    def together(
        cls, flights: Sequence[Flight], simulation: Simulation, highest_hz: float = BAND_HZ.value
    ) -> list[Compared]:
        """Flights that are searched together; for own inputs see :mod:`.other_simulations`."""
        compared = [cls(flight, simulation, highest_hz) for flight in flights]
        if not simulation.own_inputs:
            return compared
        learned = simulation.learned([(own.flight, own.quiet) for own in compared])
        return [cls(flight, learned, highest_hz) for flight in flights]

    def compared_with(self, simulation: Simulation) -> Compared:
        """The same flight beside another simulation of the same vehicle, at the same rate."""
        other = copy(self)
        for name in _OF_THE_SIMULATION:
            vars(other).pop(name, None)
        other.simulation, other._started = simulation, {}
        return other

    @cached_property
    def simulated(self) -> Array:
        """Wrench (M, 6) of the simulation as the recording would have it, thinned."""
        return recorded_wrench(self.flight, self.simulation)[:: self.step]

    @cached_property
    def quiet_wrench(self) -> Array:
        """Wrench (N, 6) of the simulation for the quiet flight, as the recording would have it."""
        return explained_wrench(self.quiet, self.simulation)

    @cached_property
    def measured(self) -> Array:
        """Measured wrench (M, 6), thinned."""
        return measured_wrench(self.thinned, self.simulation.vehicle)

    @property
    def residual(self) -> Array:
        """Measured less simulated wrench (M, 6), thinned."""
        return self.measured - self.simulated

    @cached_property
    def expected(self) -> Flight:
        """The flight, with the accelerations that the simulation predicts of it."""
        return predicted_flight(self.quiet, self.simulation, self.quiet_wrench)

    @cached_property
    def states(self) -> npt.NDArray[np.void]:
        """Input records (M,) of wrench effects, thinned, with the measured force.

        The measured force acts even where the simulation lacks it, and its noise does not affect moments.
        """
        states = self.simulation.states(self.quiet)[:: self.step].copy()
        states["wrench"][:, :3] = self.measured[:, :3]
        states["force_is_measured"] = 1.0
        return states

    @cached_property
    def record(self) -> npt.NDArray[np.void]:
        """Vehicle record (1,), an input of wrench effects."""
        return self.simulation.record()

    @cached_property
    def expected_thinned(self) -> Flight:
        """:attr:`expected` at the rate of the residual."""
        return _every(self.expected, self.step)

    @cached_property
    def expected_measured(self) -> Array:
        """Measured wrench (M, 6) of the flight :attr:`expected`, thinned."""
        return measured_wrench(self.expected_thinned, self.simulation.vehicle)

    @cached_property
    def expected_residual(self) -> Array:
        """Residual (M, 6) of the flight :attr:`expected`, thinned."""
        return _explained_residual(self.expected, self.simulation)[:: self.step]

    @cached_property
    def bias_response(self) -> BiasResponse:
        """Biases that the estimator attributes to errors of the IMU in this flight."""
        return BiasResponse(self.flight, self.simulation.vehicle, self._imu_rate_hz)

    def started(self, effect: Effect, values: Array) -> Started:
        """State at the start of the flight of an effect that has one of its own."""
        # The strength has no part in it, and a search asks again for what surrounds a point.
        known = self._started.setdefault(effect.name, [])
        away = [np.max(np.abs(values - other)[1:] / _typical(effect), initial=0.0) for other, _ in known]
        place = int(np.argmin(away)) if away else -1
        if away and away[place] == 0.0:
            return known[place][1]
        near = known[place][1].memory if away and away[place] < _NEAR else None
        step_s = 1.0 / self.thinned.rate_hz
        found = started(effect, values, self.states, self.record, self.residual, step_s, near)
        known.append((values.copy(), found))
        return found

    def spectrum(self, columns: Array) -> Spectrum:
        """Spectrum of columns (M, ·, K) of this flight, as far as it is compared."""
        return spectrum(columns, self.thinned.rate_hz, self.highest_hz)

    def uncertain(self) -> list[Column]:
        """Columns (M, 6) of the tolerances, one each."""
        tolerances = self.simulation.tolerances
        columns = [
            column._replace(wrench=self.simulation.recorded(self.quiet, column.wrench)[:: self.step])
            for column in self.simulation.uncertain(self.quiet)
        ]
        for effect, deviation in body_tolerances(tolerances):
            deviations = deviation * np.eye(len(effect.parameters))
            for parameter, values in zip(effect.parameters, deviations, strict=True):
                columns.append(Column(f"{effect.name}.{parameter.name}", self.added(effect, values)))
        return columns

    def added(self, effect: Effect, values: Array) -> Array:
        """What an effect adds to the residual (M, 6).

        Args:
            effect: effect of any kind.
            values: parameters in their order, within their bounds or not.
        """
        return _KINDS[effect.kind](self, effect, values)


def _typical(effect: Effect) -> Array:
    """Typical sizes (P - 1,) of the parameters of an effect but for its strength."""
    return np.array([abs(parameter.default) or 1.0 for parameter in effect.parameters[1:]])


def body_tolerances(tolerances: Tolerances) -> tuple[tuple[Effect, float], ...]:
    """Effects that represent what is uncertain in the body, with the standard deviation of their parameters.

    In the order of the tolerances, then of the effects that declare them (`Effect.tolerance`).
    """
    return tuple(
        (effect, getattr(tolerances, field.name))
        for field in fields(Tolerances)
        for effect in EFFECTS.values()
        if effect.tolerance == field.name
    )


def share_of_wrench(effect: Effect, vehicle: Vehicle, values: Array) -> Array:
    """Share (6, 6) of the wrench by which an effect on the vehicle changes the residual.

    The wrench is that of the vehicle's accelerations, :attr:`Compared.expected_measured`.
    """
    altered = effect.function(vehicle, values)
    share = np.zeros((6, 6))
    share[:3, :3] = (1.0 - altered.mass_kg / vehicle.mass_kg) * np.eye(3)
    share[3:, 3:] = np.eye(3) - altered.inertia @ np.linalg.inv(vehicle.inertia)
    return share


def predicted_flight(flight: Flight, simulation: Simulation, wrench: Array | None = None) -> Flight:
    """A flight with the accelerations that a simulation predicts; slow angular ones stay as measured.

    Args:
        flight: as measured.
        simulation: of its vehicle.
        wrench: (N, 6) in place of :func:`recorded_wrench`.
    """
    vehicle = simulation.vehicle
    wrench = recorded_wrench(flight, simulation) if wrench is None else wrench
    momentum = flight.rates @ vehicle.inertia
    moment = wrench[:, 3:] - np.cross(flight.rates, momentum)
    turning = moment @ np.linalg.inv(vehicle.inertia)
    # A wrong simulated moment would spin up the predicted vehicle, and another inertia would seem to explain
    # a share of it. Slow angular acceleration is measured with little noise.
    smoothing = flight.rate_hz / (2.0 * np.pi * SLOW_HZ.value)
    turning += gaussian_filter1d(flight.angular_acceleration - turning, smoothing, axis=0, mode="nearest")
    return replace(flight, specific_force=wrench[:, :3] / vehicle.mass_kg, angular_acceleration=turning)


def recorded_wrench(flight: Flight, simulation: Simulation) -> Array:
    """Simulated wrench (N, 6) as the recording of the flight would have it, as its measured one does."""
    return simulation.recorded(flight, simulation.wrench(flight))


def residual(flight: Flight, simulation: Simulation) -> Array:
    """Measured less simulated wrench (N, 6)."""
    return measured_wrench(flight, simulation.vehicle) - recorded_wrench(flight, simulation)


def explained_wrench(flight: Flight, simulation: Simulation) -> Array:
    """As :func:`recorded_wrench`, without the noise of inputs that the simulation has of its own."""
    return simulation.recorded(flight, simulation.explained(flight))


def _explained_residual(flight: Flight, simulation: Simulation) -> Array:
    return measured_wrench(flight, simulation.vehicle) - explained_wrench(flight, simulation)


def _every(flight: Flight, step: int) -> Flight:
    """Every `step`-th sample, side by side in memory as the kernels want them."""
    taken = flight.slice(slice(None, None, step))
    changes: Any = {n: np.ascontiguousarray(v) for n, v in vars(taken).items() if isinstance(v, np.ndarray)}
    return replace(taken, **changes)


def _wrench(compared: Compared, effect: Effect, values: Array) -> Array:
    parameters = {p.name: v for p, v in zip(effect.parameters, values, strict=True)}
    flown = effect.name, parameters, compared.states, compared.record
    if effect.at_rest:
        starts = compared.started(effect, values).memory[np.newaxis]
        added = remembered_wrenches(*flown, starts, 1.0 / compared.thinned.rate_hz)[:, :, 0]
    else:
        added = effect_wrench(*flown)
    return compared.simulation.recorded(compared.thinned, added)


def _vehicle(compared: Compared, effect: Effect, values: Array) -> Array:
    vehicle = effect.function(compared.simulation.vehicle, values)
    return compared.expected_measured - measured_wrench(compared.expected_thinned, vehicle)


def _wind(compared: Compared, effect: Effect, values: Array) -> Array:
    flight = compared.quiet
    wind = flight.wind + effect.function(flight.time, values, _NO_NUMBERS)
    windy = explained_wrench(replace(flight, wind=wind), compared.simulation)[:: compared.step]
    return windy - compared.quiet_wrench[:: compared.step]


def _sensor(compared: Compared, effect: Effect, values: Array) -> Array:
    vehicle, biases = compared.simulation.vehicle, compared.bias_response
    altered = without_sensor_effect(compared.expected, effect, vehicle, values, biases)
    return compared.expected_residual - _explained_residual(altered, compared.simulation)[:: compared.step]


def without_sensor_effect(
    flight: Flight, effect: Effect, vehicle: Vehicle, values: Array, biases: BiasResponse
) -> Flight:
    """The flight that the same estimator would give with sensors without this effect.

    A sustained IMU contribution of the effect has been absorbed by the estimated biases, so it is removed
    from those too; a flight from odometry has none.
    """
    time_ns = np.round(1e9 * flight.time).astype(np.int64)
    recording = Recording(
        name=flight.name,
        vehicle=flight.vehicle,
        source=flight.source,
        imu=ImuStream(time_ns, flight.rates, flight.specific_force),
        rotor_speeds=RotorSpeedStream(time_ns, flight.rotor_speeds),
        pose=PoseStream(time_ns, flight.position, flight.attitude),
    )
    altered = effect.function(recording, vehicle, effect.undo(values))
    rotors, pose = altered.rotor_speeds, altered.pose
    rates, force = altered.imu.angular_velocity, altered.imu.specific_force
    acceleration = flight.angular_acceleration
    if rates is not flight.rates:
        # The derivative belongs to the rates as they were filtered: turn it as they are turned.
        turned = replace(recording, imu=ImuStream(time_ns, acceleration, flight.specific_force))
        acceleration = effect.function(turned, vehicle, effect.undo(values)).imu.angular_velocity
    if altered.imu is not recording.imu and flight.biases_estimated:
        gyro_bias, accelerometer_bias = biases(rates - flight.rates, force - flight.specific_force)
        rates, force = rates - gyro_bias, force - accelerometer_bias

    def shifted(values: Array, delay_s: float) -> Array:
        return values if delay_s == 0.0 else _delayed(flight.time, values, delay_s)

    rotor_delay = 1e-9 * float(rotors.time_ns[0] - time_ns[0])
    pose_delay = 1e-9 * float(pose.time_ns[0] - time_ns[0])
    return replace(
        flight,
        rates=rates,
        angular_acceleration=acceleration,
        specific_force=force,
        rotor_speeds=shifted(rotors.speeds, rotor_delay),
        position=shifted(pose.position, pose_delay),
        attitude=shifted(pose.attitude, pose_delay),
        velocity=shifted(flight.velocity, pose_delay),
    )


def _delayed(time: Array, values: Array, delay_s: float) -> Array:
    """Values (N, C) delayed by a time, constant beyond their ends."""
    return interpolate_columns(time, values, time - delay_s)


# What a flight knows by its simulation; the rest is of flight and vehicle alone.
_OF_THE_SIMULATION = {
    name for name, value in vars(Compared).items() if isinstance(value, cached_property)
} - {"measured", "bias_response"}
_Added: TypeAlias = Callable[[Compared, Effect, Array], Array]
_KINDS: dict[str, _Added] = {"wrench": _wrench, "vehicle": _vehicle, "wind": _wind, "sensor": _sensor}
