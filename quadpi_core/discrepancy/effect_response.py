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
from dataclasses import fields, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter1d, uniform_filter1d

from quadpi_core.discrepancy.simulations import Column, Margins, Simulation, Tolerances
from quadpi_core.discrepancy.unmeasured_states import BiasResponse, Started, started
from quadpi_core.discrepancy.whitening import Columns, Memoised, OfEachFlight, Spectrum, spectrum
from quadpi_core.flight import Flight, ImuStream, PoseStream, Recording, RotorSpeedStream
from quadpi_core.frames import Array, rotate_body_to_world, rotate_world_to_body
from quadpi_core.records import CONVENTION, Threshold
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.simulation.applied_effects import EFFECTS, effect_wrench, remembered_wrenches
from quadpi_core.simulation.effect_definition import Effect
from quadpi_core.vehicle import Motors, Vehicle

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
NOISE_HZ = Threshold(
    "band of noise",
    (12.0, 20.0),
    "Hz",
    "the upper half of the frequencies compared, where a vehicle moves less than its sensors make noise",
    CONVENTION,
)
AVERAGE_HZ = Threshold(
    "width of the average of power",
    0.6,
    "Hz",
    "averages several frequencies of a flight of 10 s, and is narrower than the band of any manoeuvre",
    CONVENTION,
)
# Parameters of an effect with a state of its own that are so near, in typical sizes, start all but alike.
_NEAR = 0.02
_NO_NUMBERS = np.random.default_rng(0)
# What a flight beside one simulation shares with the same flight beside another.
_OF_THE_FLIGHT = ("_recorded", "flight", "thinned", "step", "quiet", "measured", "bias_response")


class Compared(Memoised):
    """A flight beside the simulation that it is compared with.

    Columns and residuals are thinned to about `RATE_HZ`: a flight has been low-passed far below that. What
    has M samples is thinned.

    Attributes:
        flight: input of the simulation, thinned as far as derivatives allow where it takes any.
        thinned: the flight at about `RATE_HZ`.
        step: thins `flight` to it.
    """

    def __init__(self, flight: Flight, simulation: Simulation) -> None:
        self.simulation, self._recorded = simulation, flight
        self._started: dict[str, dict[tuple[float, ...], Started]] = {}
        step = max(1, int(flight.rate_hz / RATE_HZ.value + 0.5))
        self.thinned = _every(flight, step)
        # What has a memory takes derivatives, for which twice the rate is enough.
        self.step = 1 if simulation.memoryless else 2 if step % 2 == 0 else step
        self.flight = _every(flight, step // self.step)

    @classmethod
    def together(cls, flights: Sequence[Flight], simulation: Simulation) -> list[Compared]:
        """Flights that are searched together; for own inputs see :mod:`.other_simulations`."""
        compared = [cls(flight, simulation) for flight in flights]
        if not simulation.own_inputs:
            return compared
        learned = simulation.learned([(own.flight, own.quiet) for own in compared])
        return [own.compared_with(learned) for own in compared]

    def compared_with(self, simulation: Simulation) -> Compared:
        """The same flight beside another simulation of the same vehicle, at the same rate."""
        other = object.__new__(Compared)
        vars(other).update({name: value for name, value in vars(self).items() if name in _OF_THE_FLIGHT})
        other.simulation, other._started = simulation, {}
        return other

    @cached_property
    def quiet(self) -> Flight:
        """What columns are made of, see :func:`quiet`; the residual is of the flight itself."""
        return _every(quiet(self._recorded), max(1, round(self._recorded.rate_hz / self.flight.rate_hz)))

    @cached_property
    def measured(self) -> Array:
        """Measured wrench (M, 6)."""
        return measured_wrench(self.thinned, self.simulation.vehicle)

    @cached_property
    def residual(self) -> Array:
        """Measured less simulated wrench (M, 6)."""
        return self.whole_residual[:: self.step]

    @cached_property
    def whole_residual(self) -> Array:
        """The same of every sample (N, 6) of the flight."""
        return residual(self.flight, self.simulation)

    @cached_property
    def margins(self) -> Margins | None:
        """Intervals of the simulation for the flight; None for one without."""
        return self.simulation.margins(self.flight)

    @cached_property
    def quiet_wrench(self) -> Array:
        """Wrench (N, 6) of the simulation for the quiet flight, as the recording would have it."""
        return explained_wrench(self.quiet, self.simulation)

    @cached_property
    def expected(self) -> Flight:
        """The quiet flight, with the accelerations that the simulation predicts of it."""
        return predicted_flight(self.quiet, self.simulation.vehicle, self.quiet_wrench)

    @cached_property
    def expected_measured(self) -> Array:
        """Measured wrench (M, 6) of the flight :attr:`expected`."""
        return measured_wrench(self.expected, self.simulation.vehicle)[:: self.step]

    def expected_before(self, *, noisy: bool) -> tuple[Flight, Array]:
        """The flight :attr:`expected`, or such a one with its noise, and the residual (N, 6) of it."""
        flight, simulation = self.expected, self.simulation
        if noisy:
            wrench = explained_wrench(self.flight, simulation)
            flight = predicted_flight(self.flight, simulation.vehicle, wrench)
        return flight, measured_wrench(flight, simulation.vehicle) - explained_wrench(flight, simulation)

    @cached_property
    def states(self) -> npt.NDArray[np.void]:
        """Input records (M,) of wrench effects, with the measured force.

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
    def bias_response(self) -> BiasResponse:
        """Biases that the estimator attributes to errors of the IMU in this flight."""
        return BiasResponse(self.flight, self.simulation.vehicle, self._recorded.rate_hz)

    def started(self, effect: Effect, values: Array) -> Started:
        """State at the start of the flight of an effect that has one of its own."""
        # The strength has no part in it, and a search asks again for what surrounds a point.
        near, known = None, self._started.setdefault(effect.name, {})
        part = [i for i, own in enumerate(effect.parameters) if i and own.name not in effect.moments_alone]
        key = tuple(values[part].tolist())
        if key not in known:
            typical = [abs(effect.parameters[i].default) or 1.0 for i in part]
            if others := [*known]:
                away = np.max(np.abs(np.subtract(others, key)) / typical, axis=1)
                near = known[others[int(away.argmin())]] if away.min() < _NEAR else None
            step_s = 1.0 / self.thinned.rate_hz
            known[key] = started(effect, values, self.states, self.record, self.residual, step_s, near)
        return known[key]

    def spectrum(self, columns: Array) -> Spectrum:
        """Spectrum of columns (M, ·, K) of this flight, as far as it is compared."""
        return spectrum(columns, self.thinned.rate_hz)

    def uncertain(self) -> list[Column]:
        """Columns (M, 6) of the tolerances, one each."""
        columns = [
            column._replace(wrench=self.simulation.recorded(self.quiet, column.wrench)[:: self.step])
            for column in self.simulation.uncertain(self.quiet)
        ]
        for effect, deviation in body_tolerances(self.simulation):
            deviations = deviation * np.eye(len(effect.parameters))
            for parameter, values in zip(effect.parameters, deviations, strict=True):
                columns.append(Column(f"{effect.name}.{parameter.name}", self.added(effect, values)))
        return columns

    def added(self, effect: Effect, values: Array) -> Array:
        """What an effect with these parameters, within their bounds or not, adds to the residual (M, 6)."""
        return _KINDS[effect.kind](self, effect, values)


def quiet(flight: Flight) -> Flight:
    """The flight with the white noise of its velocity, rates and rotor speeds filtered out.

    The residual holds the noise of the simulation's inputs. Least squares would shrink a column with the same
    noise to remove it, by a quarter where the noise of rotor speeds is most of that of a moment (errors in
    variables; Fuller, Measurement Error Models, 1987), and one with other noise, too. So Wiener's filter
    frees columns of it, but those of what moves signals in time: a delay changes most what the filter takes.
    """
    rate = flight.rate_hz
    if 2.0 * NOISE_HZ.value[1] > rate:
        return flight
    # In the world, an error of the attitude is not one of the velocity.
    velocity = _without_noise(rotate_body_to_world(flight.attitude, flight.velocity), rate)
    return replace(
        flight,
        velocity=rotate_world_to_body(flight.attitude, velocity),
        rates=_without_noise(flight.rates, rate),
        rotor_speeds=_without_noise(flight.rotor_speeds, rate),
    )


def _without_noise(values: Array, rate_hz: float) -> Array:
    """Wiener's filter of each column (N, C): each frequency's share of power above the noise."""
    # Mirrored about both ends, so that the last sample leads on to the first.
    whole = np.concatenate((values, values[::-1]))
    transformed = np.fft.rfft(whole, axis=0)
    frequency = np.fft.rfftfreq(len(whole), 1.0 / rate_hz)
    power = np.abs(transformed) ** 2
    noise = power[(frequency >= NOISE_HZ.value[0]) & (frequency < NOISE_HZ.value[1])].mean(axis=0)
    power = uniform_filter1d(power, max(1, round(AVERAGE_HZ.value / frequency[1])), axis=0)
    gain = 1.0 - noise / np.maximum(power, np.maximum(noise, np.finfo(float).tiny))
    gain[frequency >= NOISE_HZ.value[1]] = 0.0
    gain[0] = 1.0
    return np.fft.irfft(gain * transformed, len(whole), axis=0)[: len(values)]


def body_tolerances(simulation: Simulation) -> tuple[tuple[Effect, float], ...]:
    """Effects that represent what is uncertain in the body, with the standard deviation of their parameters.

    In the order of the tolerances, then of the effects that declare them (`Effect.tolerance`). Thrusts of
    single rotors are those of four; of another number they count as alike.
    """
    rotors = simulation.vehicle.rotor_count
    return tuple(
        (effect, getattr(simulation.tolerances, field.name))
        for field in fields(Tolerances)
        for effect in EFFECTS.values()
        if effect.tolerance == field.name and (field.name != "thrust" or len(effect.parameters) == rotors)
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


def residual(flight: Flight, simulation: Simulation) -> Array:
    """Measured less simulated wrench (N, 6), which is as the recording of the flight would have it."""
    simulated = simulation.recorded(flight, simulation.wrench(flight))
    return measured_wrench(flight, simulation.vehicle) - simulated


def explained_wrench(flight: Flight, simulation: Simulation) -> Array:
    """Simulated wrench (N, 6) as recorded, without the noise of inputs that the simulation has of its own."""
    return simulation.recorded(flight, simulation.explained(flight))


def predicted_flight(flight: Flight, vehicle: Vehicle, wrench: Array) -> Flight:
    """A flight with the accelerations of a wrench (N, 6) as recorded; slow angular ones stay as measured."""
    moment = wrench[:, 3:] - np.cross(flight.rates, flight.rates @ vehicle.inertia)
    turning = moment @ np.linalg.inv(vehicle.inertia)
    # A wrong simulated moment would spin up the predicted vehicle, and another inertia would seem to explain
    # a share of it. Slow angular acceleration is measured with little noise.
    smoothing = flight.rate_hz / (2.0 * np.pi * SLOW_HZ.value)
    turning += gaussian_filter1d(flight.angular_acceleration - turning, smoothing, axis=0, mode="nearest")
    return replace(flight, specific_force=wrench[:, :3] / vehicle.mass_kg, angular_acceleration=turning)


def _every(flight: Flight, step: int) -> Flight:
    """Every `step`-th sample, side by side in memory as the kernels want them."""
    taken = flight.slice(slice(None, None, step))
    changes: Any = {n: np.ascontiguousarray(v) for n, v in vars(taken).items() if isinstance(v, np.ndarray)}
    return replace(taken, **changes)


def _wrench(compared: Compared, effect: Effect, values: Array) -> Array:
    parameters = {p.name: v for p, v in zip(effect.parameters, values, strict=True)}
    name, states, record = effect.name, compared.states, compared.record
    if not effect.at_rest:
        added = effect_wrench(name, parameters, states, record)
    else:
        start, step_s = compared.started(effect, values).memory[np.newaxis], 1.0 / compared.thinned.rate_hz
        added = remembered_wrenches(name, parameters, states, record, start, step_s)[:, :, 0]
    return compared.simulation.recorded(compared.thinned, added)


def _vehicle(compared: Compared, effect: Effect, values: Array) -> Array:
    vehicle = effect.function(compared.simulation.vehicle, values)
    return compared.expected_measured - measured_wrench(compared.expected, vehicle)[:: compared.step]


def _wind(compared: Compared, effect: Effect, values: Array) -> Array:
    flight = compared.quiet
    windy = replace(flight, wind=flight.wind + effect.function(flight.time, values, _NO_NUMBERS))
    return (explained_wrench(windy, compared.simulation) - compared.quiet_wrench)[:: compared.step]


def _sensor(compared: Compared, effect: Effect, values: Array) -> Array:
    simulation, vehicle = compared.simulation, compared.simulation.vehicle
    noisy = effect.shifts_noise
    expected, before = compared.once(("expected", noisy), lambda: compared.expected_before(noisy=noisy))
    altered = without_sensor_effect(expected, effect, vehicle, values, compared.bias_response)
    left = measured_wrench(altered, vehicle) - explained_wrench(altered, simulation)
    return (before - left)[:: compared.step]


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
    undone = effect.undo(values)
    altered = effect.function(recording, vehicle, undone)
    rotors, pose = altered.rotor_speeds, altered.pose
    rates, force = altered.imu.angular_velocity, altered.imu.specific_force
    acceleration = flight.angular_acceleration
    if rates is not flight.rates:
        # The derivative belongs to the rates as they were filtered: turn it as they are turned.
        turned = replace(recording, imu=ImuStream(time_ns, acceleration, flight.specific_force))
        acceleration = effect.function(turned, vehicle, undone).imu.angular_velocity
    if altered.imu is not recording.imu and flight.biases_estimated:
        gyro_bias, accelerometer_bias = biases(rates - flight.rates, force - flight.specific_force)
        rates, force = rates - gyro_bias, force - accelerometer_bias

    def shifted(values: Array, stamps: npt.NDArray[np.int64]) -> Array:
        delay_s = 1e-9 * float(stamps[0] - time_ns[0])
        if delay_s == 0.0:
            return values
        from scipy.interpolate import CubicSpline

        # Between samples straight lines quieten noise, so that delays of half a sample would be preferred.
        at = (flight.time - delay_s).clip(flight.time[0], flight.time[-1])
        return np.asarray(CubicSpline(flight.time, values)(at))

    return replace(
        flight,
        rates=rates,
        angular_acceleration=acceleration,
        specific_force=force,
        rotor_speeds=shifted(rotors.speeds, rotors.time_ns),
        position=shifted(pose.position, pose.time_ns),
        attitude=shifted(pose.attitude, pose.time_ns),
        velocity=shifted(flight.velocity, pose.time_ns),
    )


_Added: TypeAlias = Callable[[Compared, Effect, Array], Array]
_KINDS: dict[str, _Added] = {"wrench": _wrench, "vehicle": _vehicle, "wind": _wind, "sensor": _sensor}


# Nothing measured these speeds: each flight has a gain of all of them, one of each rotor and a lag of its
# own, known as well as motors predicted flights that they were not identified on. Motors that are known by
# thrust alone, and of no other flights than those searched, take their scale from them: what scales all
# thrust (a mass, a thrust coefficient) is then in the speeds already.

GAIN_LEAST = Threshold(
    "least standard deviation of the gain of all rotor speeds from commands",
    0.005,
    "share",
    "another pack on another day; flights of one afternoon differ by less",
    "imrc_payload of ../shared/data by the motors of imrc_brushless",
)
ROTORS_DIFFER = Threshold(
    "standard deviation of the speed of a rotor at the command of the others, where no tachometer told it",
    0.03,
    "share",
    "motors of one kind differ; motors known by thrust alone are taken as alike",
    "motors of imrc_brushed of ../shared/data by their tachometers",
)
LAG_ERROR = Threshold(
    "standard deviation of the lag of rotor speeds from commands",
    0.15,
    "of the lag",
    "a first-order lag is a simplification: rotors spool up faster than down",
    CONVENTION,
)
# Thrust goes with the square of speed but for what airspeed adds: steps in which the scale converges.
_SCALE_STEPS = 4
# Of a scale that only the searched flights tell: larger than any effect.
_UNKNOWN_SCALE = 0.5
# Steps of the differences: 1 % of speed, 2 ms of lag.
_SHARE, _LATE_S = 0.01, 0.002


def at_scale_of(simulation: Simulation, flights: Sequence[Flight]) -> list[Flight]:
    """The flights with rotor speeds of an assumed scale brought to that of a simulation, all by one factor.

    With it the simulated thrust along the body is on average the measured one.
    """

    def is_assumed(flight: Flight) -> bool:
        return flight.motors is not None and not scale_is_known(flight.motors, simulation.vehicle)

    assumed, gain = [own for own in flights if is_assumed(own)], 1.0
    if not assumed or simulation.own_inputs:
        return list(flights)
    measured = sum(float(measured_wrench(own, simulation.vehicle)[:, 2].sum()) for own in assumed)
    for _ in range(_SCALE_STEPS):
        scaled = [replace(own, rotor_speeds=gain * own.rotor_speeds) for own in assumed]
        simulated = sum(float(simulation.wrench(own)[:, 2].sum()) for own in scaled)
        if simulated * measured <= 0.0:
            return list(flights)
        gain *= float(np.sqrt(measured / simulated))
    return [replace(own, rotor_speeds=gain * own.rotor_speeds) if is_assumed(own) else own for own in flights]


def errors_of_speeds(flights: Sequence[Compared]) -> tuple[OfEachFlight, ...]:
    """What flights have of their own as their rotor speeds are of commands; empty where all are measured."""
    if all(own.flight.motors is None for own in flights):
        return ()
    vehicle = flights[0].simulation.vehicle
    columns = Columns(tuple(own.spectrum(_columns(own)) for own in flights))
    each = [np.diag(deviations(own.flight.motors, vehicle, len(flights))) for own in flights]
    return (OfEachFlight(columns, np.stack(each)),)


def _columns(flight: Compared) -> Array:
    """What a gain of all speeds, one of each rotor (by 1) and a lag [s] add to the residual (M, 6, K)."""
    scale, delay = EFFECTS["rotor_speed_scale"], EFFECTS["sensor_delay"]
    rotors = range(flight.flight.rotor_speeds.shape[1] + 1)
    gains = [flight.added(scale, np.array([rotor, _SHARE])) / _SHARE for rotor in rotors]
    return np.stack([*gains, flight.added(delay, np.array([_LATE_S, 0.0])) / _LATE_S], axis=2)


def deviations(motors: Motors | None, vehicle: Vehicle, flights: int) -> Array:
    """Standard deviations (K,) of these of one of several flights; what flights share is in each of them."""
    rotors = vehicle.rotor_count
    if motors is None:
        return np.zeros(rotors + 2)
    gain, own, lag_s = max(motors.gain, GAIN_LEAST.value), np.zeros(rotors), LAG_ERROR.value * motors.lag_s
    # As many deviations as flights: their mean then deviates by as much as what they share.
    shared = np.sqrt(flights)
    own = np.array(motors.error) if motors.error else np.full(rotors, shared * ROTORS_DIFFER.value)
    if not scale_is_known(motors, vehicle):
        gain = np.hypot(gain, shared * _UNKNOWN_SCALE)
    return np.concatenate(([gain], own, [lag_s]))


def scale_is_known(motors: Motors, vehicle: Vehicle) -> bool:
    """Whether tachometers, or other flights than those searched, tell the scale of the speeds."""
    return bool(motors.error) or motors == vehicle.motors
