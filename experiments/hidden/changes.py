# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Exact changes of real recordings: what they would have been with an effect, and the right answers.

A change is exact where the flight itself need not change. The world may move at a constant velocity, which
is a wind; a sensor may have said something else of the same motion; the file of the simulation may be wrong.
None uses a formula of the library that is searched.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np
from blind.cases import OUT, SINGLE
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from quadpi_core.flight import Flight, Recording, Stamps, Stream
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.vehicle import ROTORS, Vehicle

# A change that the estimator's biases and delay may take: nothing is missing, but a sensor is not as it was.
CONDITION = "condition"
# A gust is slower than the low-pass of flights, and so fast that the place hardly moves with it.
_GUST_HZ = (0.3, 5.0)
# Readings of a battery jump with the load and by their last digit.
_BATTERY_S = 0.5

_Late = TypeVar("_Late", bound=Stream)


@dataclass(frozen=True)
class Truth:
    """The right answers to a case.

    Attributes:
        right: sets of effects, each of which is right to name; () is to name nothing.
        unknown: whether `unknown` is right, as no law of the library is what is hidden.
        parameters: true ones by `effect.parameter`, where they follow exactly.
    """

    right: tuple[tuple[str, ...], ...] = ()
    unknown: bool = False
    parameters: Mapping[str, float] = field(default_factory=dict)

    def beside(self, other: Truth) -> Truth:
        """Of two changes at once."""
        both = tuple((*one, *two) for one in self.right for two in other.right)
        return Truth(both, self.unknown or other.unknown, {**self.parameters, **other.parameters})


NOTHING = Truth(((),))


class Drawn(NamedTuple):
    """How large a change is, and what chance decides of it: a rotor from 1 on, a unit vector (3,)."""

    amount: float
    rotor: int
    direction: Array

    @property
    def level(self) -> Array:
        """The amount along the direction, without its part upward."""
        level = self.direction * (1.0, 1.0, 0.0)
        found: Array = self.amount * level / np.linalg.norm(level)
        return found


class Given(NamedTuple):
    """What some changes need beside the recording.

    Attributes:
        vehicle: that flew.
        flight: the recording fused, as it was.
        battery: gives stamps (B,) and volts (B,), of this or another flight.
        gust: gives time (M,) s and acceleration (M, 3) m/s² in the world that another flight measured.
    """

    vehicle: Vehicle
    flight: Flight
    battery: Callable[[], tuple[Stamps, Array]]
    gust: Callable[[], tuple[Array, Array]]


@dataclass(frozen=True)
class Change:
    """One kind of change.

    Attributes:
        words: what is changed, at full size.
        full: amount of size 1, in the unit of the words.
        kind: SINGLE, CONDITION or OUT.
        right: effects, each of which is right to name alone; with `none` and `unknown` where these are right.
        recording: the recording as it would have been.
        file: the vehicle file of the simulation as it is, for a flown vehicle; the model is identified before
            with the right file, so that its coefficients are those of the vehicle that flew.
        true: parameters that follow exactly from what was drawn, by `effect.parameter`.
    """

    words: str
    full: float
    kind: str
    right: tuple[str, ...]
    recording: Callable[[Recording, Drawn, Given], Recording] = lambda recording, *_: recording
    file: Callable[[Vehicle, Drawn], Vehicle] = lambda vehicle, _: vehicle
    true: Callable[[Drawn, Vehicle], dict[str, float]] = lambda *_: {}

    def truth(self, drawn: Drawn, vehicle: Vehicle) -> Truth:
        """The right answers of what was drawn, for a vehicle."""
        right = tuple(() if name == "none" else (name,) for name in self.right if name != "unknown")
        return Truth(right, "unknown" in self.right, self.true(drawn, vehicle))


def _with_force(recording: Recording, force: Array) -> Recording:
    return replace(recording, imu=replace(recording.imu, specific_force=force))


def _with_speeds(recording: Recording, change: Callable[[Array, Stamps], Array]) -> Recording:
    stream = recording.rotor_speeds
    assert stream is not None
    return replace(recording, rotor_speeds=replace(stream, speeds=change(stream.speeds, stream.time_ns)))


def _late(stream: _Late | None, delay_s: float) -> _Late | None:
    return None if stream is None else replace(stream, time_ns=stream.time_ns + round(1e9 * delay_s))


def displaced(recording: Recording, path: Callable[[Stamps, Array, Array], tuple[Array, Array]]) -> Recording:
    """Poses and fused states moved in the world.

    Args:
        recording: that has them.
        path: of stamps (N,), matrices (N, 3, 3) from body to world and body rates (N, 3): displacements
            (N, 3) m and their velocities (N, 3) m/s, both in the world.
    """
    pose, state = recording.pose, recording.odometry
    if pose is not None:
        turned = rotation_matrix(pose.attitude)
        pose = replace(pose, position=pose.position + path(pose.time_ns, turned, np.zeros((len(pose), 3)))[0])
    if state is not None:
        turned = rotation_matrix(state.attitude)
        place, velocity = path(state.time_ns, turned, state.rates)
        seen = np.einsum("nij,ni->nj", turned, velocity)
        state = replace(state, position=state.position + place, velocity=state.velocity + seen)
    return replace(recording, pose=pose, odometry=state)


def _in_wind(recording: Recording, drawn: Drawn, given: Given) -> Recording:  # noqa: ARG001
    def blown(at_ns: Stamps, *_: Array) -> tuple[Array, Array]:
        since_s = 1e-9 * (at_ns - recording.imu.time_ns[0])
        return np.outer(since_s, drawn.level), np.tile(drawn.level, (len(at_ns), 1))

    return displaced(recording, blown)


def _off_centre(recording: Recording, drawn: Drawn, given: Given) -> Recording:
    arm = np.linalg.norm(given.vehicle.rotor_positions[:, :2], axis=1).mean()
    offset = drawn.amount * arm * drawn.direction
    return displaced(
        recording,
        lambda _, turned, rates: (turned @ offset, np.einsum("nij,nj->ni", turned, np.cross(rates, offset))),
    )


def _turned_imu(recording: Recording, drawn: Drawn, given: Given) -> Recording:  # noqa: ARG001
    turn, imu = Rotation.from_rotvec(np.radians(drawn.amount) * drawn.direction).inv().apply, recording.imu
    turned = replace(imu, angular_velocity=turn(imu.angular_velocity))
    return _with_force(replace(recording, imu=turned), turn(imu.specific_force))


def _fast_rotor(recording: Recording, drawn: Drawn, given: Given) -> Recording:  # noqa: ARG001
    scale = np.where(np.arange(1, ROTORS + 1) == drawn.rotor, 1.0 + drawn.amount, 1.0)
    return _with_speeds(recording, lambda speeds, _: speeds * scale)


def _stopped(recording: Recording, drawn: Drawn, given: Given) -> Recording:  # noqa: ARG001
    def held(speeds: Array, time_ns: Stamps) -> Array:
        stopped = (1e-9 * (time_ns - time_ns[0])) % 1.0 < drawn.amount
        last = np.maximum.accumulate(np.where(stopped, 0, np.arange(len(speeds))))
        of_rotor = np.arange(1, ROTORS + 1) == drawn.rotor
        found: Array = np.where(of_rotor, speeds[last], speeds)
        return found

    return _with_speeds(recording, held)


def _battery(recording: Recording, drawn: Drawn, given: Given) -> Recording:
    def following(speeds: Array, time_ns: Stamps) -> Array:
        rate_hz = 1e9 * (len(time_ns) - 1) / (time_ns[-1] - time_ns[0])
        volts = uniform_filter1d(np.interp(time_ns, *given.battery()), max(1, round(_BATTERY_S * rate_hz)))
        shape = (volts - volts.mean()) / np.abs(volts - volts.mean()).max()
        found: Array = speeds * (1.0 + drawn.amount * shape)[:, None]
        return found

    return _with_speeds(recording, following)


def _gust(recording: Recording, drawn: Drawn, given: Given) -> Recording:
    """The force of a gust, and the way that it and its air would have carried the vehicle."""
    imu_ns, (time, source), flight = recording.imu.time_ns, given.gust(), given.flight
    grid = np.linspace(0.0, 1e-9 * (imu_ns[-1] - imu_ns[0]), len(imu_ns))
    # As often as it takes, in a flight that is longer.
    period = time[-1] - time[0]
    wrapped = np.stack([np.interp(grid, time - time[0], axis, period=period) for axis in source.T])
    spectrum, hz = np.fft.rfft(wrapped), np.fft.rfftfreq(len(grid), grid[1])
    spectrum[:, (hz < _GUST_HZ[0]) | (hz > _GUST_HZ[1])] = 0.0
    # Acceleration, velocity and place are the same waves.
    once = 1.0 / np.where(hz > 0.0, 2j * np.pi * hz, 1.0)
    waves = np.stack([np.fft.irfft(spectrum * once**order, len(grid)) for order in range(3)])
    waves *= drawn.amount * given.vehicle.gravity_m_s2 / np.sqrt(np.square(waves[0]).sum(axis=0).mean())

    def at(order: int, at_ns: Stamps) -> Array:
        time = 1e-9 * (at_ns - imu_ns[0])
        return np.stack([np.interp(time, grid, axis) for axis in waves[order]], axis=1)

    near = np.searchsorted(flight.start_ns + np.rint(1e9 * flight.time), imu_ns).clip(0, len(flight) - 1)
    felt = np.einsum("nij,ni->nj", rotation_matrix(flight.attitude)[near], at(0, imu_ns))
    pushed = _with_force(recording, recording.imu.specific_force + felt)
    return displaced(pushed, lambda at_ns, *_: (at(2, at_ns), at(1, at_ns)))


def _wide(vehicle: Vehicle, drawn: Drawn) -> Vehicle:
    scale = np.array([1.0 + drawn.amount, 1.0 + drawn.amount, 1.0])
    return replace(vehicle, rotor_positions=vehicle.rotor_positions * scale)


_SCALE, _WHICH, _SHARE = ("rotor_speed_scale", "rotor_speed_scale.rotor", "rotor_speed_scale.change")
CHANGES = {
    "wind": Change("the world moves at 2 m/s", 2.0, SINGLE, ("wind",), _in_wind,
        true=lambda own, _: {"wind.north_m_s": own.level[0], "wind.east_m_s": own.level[1]}),
    # Thrust goes with k ω²: a factor on every speed is one on k, and no flight tells them apart.
    "fast rotors": Change("rotor speeds × 1.05", 0.05, SINGLE, (_SCALE, "thrust_coefficient"),
        lambda log, own, _: _with_speeds(log, lambda speeds, _: speeds * (1.0 + own.amount)),
        true=lambda own, _: {_WHICH: 0.0, _SHARE: own.amount}),
    # The same of one rotor.
    "fast rotor": Change("one rotor speed × 1.052", 0.052, SINGLE, (_SCALE, "weak_rotor"), _fast_rotor,
        true=lambda own, _: {_WHICH: own.rotor, _SHARE: own.amount, "weak_rotor.rotor": own.rotor}),
    "late rotors": Change("rotor speeds 24 ms late", 0.024, SINGLE, ("sensor_delay",),
        lambda log, own, _: replace(log, rotor_speeds=_late(log.rotor_speeds, own.amount)),
        true=lambda own, _: {"sensor_delay.rotor_speeds_s": own.amount}),
    "light file": Change("file 12 % lighter", 0.12, SINGLE, ("payload",),
        file=lambda body, own: replace(body, mass_kg=body.mass_kg * (1.0 - own.amount)),
        true=lambda own, body: {"payload.mass_kg": body.mass_kg * own.amount}),
    "nimble file": Change("inertia of the file ÷ 1.4", 0.4, SINGLE, ("inertia",),
        file=lambda body, own: replace(body, inertia=body.inertia / (1.0 + own.amount)),
        true=lambda own, _: {f"inertia.{axis}_change": own.amount for axis in "xyz"}),
    # Moments of thrust grow with the arms, those of the air do not: nearly another inertia about x and y.
    "wide file": Change("arms of the file × 1.2", 0.2, SINGLE, ("inertia", "unknown"), file=_wide),
    "turned IMU": Change("IMU turned by 4°", 4.0, CONDITION, ("none", "imu_misalignment"), _turned_imu),
    # Force is mass times reading: a factor on one is one on the other.
    "low accelerometer": Change("accelerometer × 0.92", 0.08, CONDITION, ("none", "payload"),
        lambda log, own, _: _with_force(log, log.imu.specific_force * (1.0 - own.amount))),
    "late states": Change("states 30 ms late", 0.03, CONDITION, ("none", "sensor_delay"),
        lambda log, own, _: replace(
            log, pose=_late(log.pose, own.amount), odometry=_late(log.odometry, own.amount))),
    "off centre": Change("pose half an arm off", 0.5, CONDITION, ("none", "unknown"), _off_centre),
    "stopped rotor": Change("a rotor stops 0.4 s a second", 0.4, CONDITION, ("none", "unknown"), _stopped),
    "gust": Change("measured gust of 10 % of the weight", 0.1, OUT, ("unknown",), _gust),
    "battery": Change("thrust follows the battery by ± 10 %", 0.05, OUT, ("unknown",), _battery),
}  # fmt: skip
PAIRS = (
    ("wind", "fast rotors"),
    ("wind", "light file"),
    ("late rotors", "fast rotor"),
    ("nimble file", "fast rotors"),
)


def drawn(name: str, size: float, seed: int) -> Drawn:
    """A change at a size, as a seed decides it."""
    rng = np.random.default_rng(seed)
    direction = rng.standard_normal(3)
    rotor = int(rng.integers(1, ROTORS + 1))
    return Drawn(size * CHANGES[name].full, rotor, direction / np.linalg.norm(direction))
