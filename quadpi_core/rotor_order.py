# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Which speed controller of an autopilot turns which rotor of the vehicle file, and in which unit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import numpy as np

from quadpi_core.config_schema import OneOf, ReadBy, Section, load_config
from quadpi_core.core import exponential
from quadpi_core.errors import LogError
from quadpi_core.flight import (
    MAX_JUMP_BACK_NS,
    BatteryStream,
    MotorCommandStream,
    Recording,
    RotorSpeedStream,
    Stamps,
)
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX
from quadpi_core.vehicle import ROTORS, SPIN_SIGN, Motors, Vehicle

RPM, ERPM = "rpm", "erpm"
_RAD_S_PER_RPM = 2.0 * np.pi / 60.0
# Motors whose bearings are closer [rad] sit on one arm.
_SAME_ARM = math.radians(5.0)
# Of half the angle between two motors, that a rotor may be off the one that is taken for it.
_OFF_SHARE = 0.9
_CW, _CCW = SPIN_SIGN["clockwise"], SPIN_SIGN["counterclockwise"]


class Motor(NamedTuple):
    """Where a motor of an autopilot sits, and how it turns.

    Attributes:
        x, y: forward and right of the centre, in any unit.
        spin: as those of a vehicle's rotors; 0 where it is not known.
        below: whether another sits above it; None where neither does, or it is not known.
    """

    x: float
    y: float
    spin: float = 0.0
    below: bool | None = None

    def turns_otherwise(self, other: Motor) -> bool:
        """Of two on one arm, whether it is not the other: by their heights, else by their spins."""
        if self.below is not None and other.below is not None:
            return self.below is not other.below
        return self.spin * other.spin < 0.0


def _ring(*places: tuple[float, float]) -> tuple[Motor, ...]:
    """Motors at bearings in degrees, clockwise from ahead, with their spins."""
    return tuple(Motor(math.cos(math.radians(at)), math.sin(math.radians(at)), spin) for at, spin in places)


# Motors 1, 2, … of standard frames (ArduPilot's AP_MotorsMatrix; PX4's and Betaflight's pages of frames).
LAYOUTS: MappingProxyType[str, tuple[Motor, ...]] = MappingProxyType(
    {
        # PX4 "Generic Quadcopter", ArduPilot FRAME_TYPE 1 (X).
        "quad-x": _ring((45, _CCW), (-135, _CCW), (-45, _CW), (135, _CW)),
        "quad-h": _ring((45, _CW), (-135, _CW), (-45, _CCW), (135, _CCW)),
        "quad-plus": _ring((90, _CCW), (-90, _CCW), (0, _CW), (180, _CW)),
        # Betaflight "Quad X", ArduPilot FRAME_TYPE 12; its propellers turn in or out.
        "betaflight": _ring((135, 0), (45, 0), (-135, 0), (-45, 0)),
        "hexa-x": _ring((90, _CW), (-90, _CCW), (-30, _CW), (150, _CCW), (30, _CCW), (-150, _CW)),
        "hexa-cw-x": _ring((30, _CCW), (90, _CW), (150, _CCW), (-150, _CW), (-90, _CCW), (-30, _CW)),
        "hexa-plus": _ring((0, _CW), (180, _CCW), (-120, _CW), (60, _CCW), (-60, _CCW), (120, _CW)),
        "octo-x": _ring(
            *((22.5, _CW), (-157.5, _CW), (67.5, _CCW), (157.5, _CCW)),
            *((-22.5, _CCW), (-112.5, _CCW), (-67.5, _CW), (112.5, _CW)),
        ),
        "octo-plus": _ring(
            *((0, _CW), (180, _CW), (45, _CCW), (135, _CCW), (-45, _CCW), (-135, _CCW), (-90, _CW), (90, _CW))
        ),
        # Two on each arm, the upper ones first.
        "octo-coaxial-x": (
            *(one._replace(below=False) for one in _ring((45, _CCW), (-45, _CW), (-135, _CCW), (135, _CW))),
            *(one._replace(below=True) for one in _ring((-45, _CCW), (45, _CW), (135, _CCW), (-135, _CW))),
        ),
        "crazyflie": _ring((45, _CCW), (135, _CW), (-135, _CCW), (-45, _CW)),
    }
)

_USUAL = MappingProxyType({4: "quad-x", 6: "hexa-x", 8: "octo-x"})


def usual_layout(vehicle: Vehicle | None, rotors: int = ROTORS) -> str:
    """The standard frame of a vehicle's number of rotors, where a log says nothing of its frame.

    Args:
        vehicle: without one, a log may say the number.
        rotors: that it says.

    Raises:
        LogError: for a number of rotors that has none.
    """
    rotors = rotors if vehicle is None else vehicle.rotor_count
    if rotors not in _USUAL:
        raise LogError(f"there is no standard frame of {rotors} rotors: give their order")
    return _USUAL[rotors]


@dataclass(frozen=True)
class RotorOrder:
    """The speed controllers of the rotors, in the vehicle's rotor order.

    Attributes:
        controllers: their numbers, counted from 0.
        unit: "rpm", mechanical revolutions per minute, or "erpm", electrical ones; None where the log says.
    """

    controllers: tuple[int, ...]
    unit: str | None = None

    @classmethod
    def load(cls, name_or_path: str | Path) -> RotorOrder:
        """Read a mapping file with the key `rotors`, controllers counted from 1, and optionally `unit`.

        Raises:
            LogError: naming the file and the key.
        """
        _, content = load_config("mapping", name_or_path, _OrderFile, LogError)
        return cls(tuple(number - 1 for number in content.rotors), content.unit)

    @classmethod
    def parse(cls, text: str, unit: str | None = None) -> RotorOrder:
        """The order that numbers in a string give, counted from 1, such as "4 1 2 3".

        Raises:
            LogError: if they are not different numbers.
        """
        numbers = [int(word) if word.isdecimal() else word for word in text.replace(",", " ").split()]
        try:
            return cls(tuple(number - 1 for number in controller_numbers(numbers)), unit)
        except ValueError as error:
            raise LogError(f"rotor order {error}") from None

    def of(self, vehicle: Vehicle | None) -> RotorOrder:
        """The same, for a vehicle of as many rotors.

        Raises:
            LogError: for a vehicle of another number of rotors.
        """
        if vehicle is not None and vehicle.rotor_count != len(self.controllers):
            raise LogError(
                f"rotor order of {len(self.controllers)} numbers; vehicle {vehicle.name} has "
                f"{vehicle.rotor_count} rotors"
            )
        return self

    @classmethod
    def by_place(
        cls, vehicle: Vehicle | None, motors: Sequence[Motor], unit: str | None = None
    ) -> RotorOrder | None:
        """The order by where the motors sit; None if they do not sit as the vehicle's rotors do.

        Of four, corners count: autopilots know signs of their places, and no lengths. Of others, bearings do,
        and spins where rotors sit on one another.
        """
        count = len(motors)
        if any(not motor.x and not motor.y for motor in motors):
            return None
        if vehicle is None:
            return cls(tuple(range(count)), unit)
        if vehicle.rotor_count != count:
            return None
        rotors = _rotors_of(vehicle)
        bearing = _corner if count == ROTORS and not _on_axes(rotors) else _bearing
        order = []
        for rotor in rotors:
            apart = [(abs(_turn(bearing(rotor) - bearing(m))), m.turns_otherwise(rotor)) for m in motors]
            # Of two on one arm the one that sits, or turns, as the rotor does.
            nearest = min(angle for angle, _ in apart)
            order.append(
                min(
                    range(count),
                    key=lambda k: (apart[k][0] > nearest + _SAME_ARM, apart[k][1], apart[k][0]),
                )
            )
            if nearest > _OFF_SHARE * math.pi / count:
                return None
        return cls(tuple(order), unit) if len(set(order)) == count else None

    @classmethod
    def by_layout(
        cls, vehicle: Vehicle | None, layout: str = "", unit: str | None = None, rotors: int = ROTORS
    ) -> RotorOrder:
        """The order in which an autopilot numbers the motors of a standard frame (see :data:`LAYOUTS`).

        Args:
            vehicle: without one, the motors keep their order.
            layout: of the frame; the usual one of as many rotors unless given.
            unit: see the attribute.
            rotors: number of them, without a vehicle.

        Raises:
            LogError: if the vehicle's rotors do not sit as the frame's do.
        """
        layout = layout or usual_layout(vehicle, rotors)
        order = cls.by_place(vehicle, LAYOUTS[layout], unit)
        if order is None:
            raise LogError(f"the vehicle's rotors are not those of a frame {layout}: give their order")
        return order

    def speeds(self, values: Array, vehicle: Vehicle | None, pole_pairs: int | None = None) -> Array:
        """Magnitudes (N, rotors) in rad/s of speeds as reported, already in the vehicle's rotor order.

        Controllers report a rotor that turns the other way as negative. A log that says the pole pairs, for
        electrical speeds, knows them better than the vehicle's file.

        Raises:
            LogError: for electrical speeds without a vehicle and pole pairs.
            VehicleError: for electrical speeds if the vehicle file does not give the pole pairs.
        """
        magnitudes: Array = np.abs(values)
        if self.unit != ERPM:
            return magnitudes * _RAD_S_PER_RPM
        if pole_pairs is not None:
            return magnitudes * (_RAD_S_PER_RPM / pole_pairs)
        if vehicle is None:
            raise LogError("electrical speeds need the vehicle, whose file gives the pole pairs")
        return vehicle.rotor_speeds_from_erpm(magnitudes)


def _rotors_of(vehicle: Vehicle) -> list[Motor]:
    """A vehicle's rotors, and of two on one arm which is the lower one."""
    places = list(zip(vehicle.rotor_positions.tolist(), vehicle.rotor_spins.tolist(), strict=True))
    rotors = [Motor(x, y, spin) for (x, y, _), spin in places]
    for k, ((*_, z), _) in enumerate(places):
        on_arm = [
            other
            for j, ((*_, other), _) in enumerate(places)
            if j != k and abs(_turn(_bearing(rotors[j]) - _bearing(rotors[k]))) < _SAME_ARM
        ]
        if on_arm and z != on_arm[0]:
            rotors[k] = rotors[k]._replace(below=z > on_arm[0])
    return rotors


def _bearing(motor: Motor) -> float:
    return math.atan2(motor.y, motor.x)


def _corner(motor: Motor) -> float:
    return math.atan2(math.copysign(motor.y != 0.0, motor.y), math.copysign(motor.x != 0.0, motor.x))


def _on_axes(rotors: Sequence[Motor]) -> bool:
    return all(min(abs(one.x), abs(one.y)) < 0.1 * max(abs(one.x), abs(one.y)) for one in rotors)


def _turn(angle: float) -> float:
    """The angle within half a turn."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def controller_numbers(numbers: Any) -> tuple[int, ...]:
    """The key `rotors` of a file, for `config_schema.ReadBy`: speed controllers counted from 1.

    Raises:
        ValueError: for anything but different numbers.
    """
    is_list = isinstance(numbers, list) and 1 <= len(numbers) <= ROTORS_MAX
    if (
        not is_list
        or len(set(map(str, numbers))) < len(numbers)
        or not all(type(number) is int and number >= 1 for number in numbers)
    ):
        raise ValueError(
            "must be different numbers of speed controllers, counted from 1, in the order of the vehicle's "
            f"rotors; found {numbers!r}"
        )
    return tuple(numbers)


@dataclass(frozen=True, kw_only=True)
class _OrderFile(Section):
    """The content of a mapping file of an autopilot's logs."""

    rotors: Annotated[tuple[int, ...], ReadBy(controller_numbers)]
    unit: Annotated[str, OneOf(RPM, ERPM)] | None = None


# Live, in replay and in identification the same function takes the commands as they come, one or many at
# once, and gives the same bits; see :class:`quadpi_core.vehicle.Motors`.

# Commands that come after a longer pause begin anew, without what the rotors did before: no lag is as long.
_PAUSE_NS = 1_000_000_000


class CommandedSpeeds:
    """Takes the commands and the battery voltages of one flight as they come, and gives rotor speeds."""

    def __init__(self, motors: Motors) -> None:
        self._motors = motors
        self._volts = motors.volts
        self._last_ns: int | None = None
        self._target: list[float] = []
        self._speed: list[float] = []

    def hear(self, battery: BatteryStream) -> None:
        """Take voltages, of the commands that follow."""
        none = np.empty((0, len(self._motors.coefficients)))
        self.take(MotorCommandStream(battery.time_ns[:0], none), battery)

    def take(
        self, commands: MotorCommandStream, battery: BatteryStream | None = None, heard: Stamps | None = None
    ) -> RotorSpeedStream:
        """Speeds of the next commands, N of them, stamped later by the dead time.

        A command that is not above 0 is of a motor that stands. One whose stamp does not rise changes
        nothing, but where the clock fell.

        Args:
            commands: N samples.
            battery: M voltages that came between them.
            heard: (M,) how many of the commands came before each voltage, rising; by the stamps unless given.
        """
        if battery is not None and heard is None:
            # Of stamps that fall the largest counts: what came before something came before what followed it.
            heard = np.searchsorted(np.maximum.accumulate(commands.time_ns), battery.time_ns)
            heard = np.maximum.accumulate(heard)
        volts = np.full(len(commands), self._volts)
        if battery is not None and heard is not None and len(battery):
            known = np.isfinite(battery.voltage) & (battery.voltage > 0.0)
            told = np.concatenate(([self._volts], battery.voltage[known]))
            volts = told[np.searchsorted(heard[known], np.arange(len(commands)), side="right")]
            self._volts = float(told[-1])
        rises, steps_ns = self._steps(commands.time_ns)
        targets = self._targets(commands.commands, volts[:, np.newaxis]).tolist()
        keep, new, old = lag_weights(np.array(steps_ns) * 1e-9, self._motors.lag_s)
        speeds = np.empty(commands.commands.shape)
        for row, target in enumerate(targets):
            if rises[row]:
                if steps_ns[row]:
                    k, a, b = keep[row], new[row], old[row]
                    motors = zip(self._speed, target, self._target, strict=True)
                    self._speed = [k * speed + a * now + b * before for speed, now, before in motors]
                else:
                    self._speed = target
                self._target = target
            speeds[row] = self._speed
        return RotorSpeedStream(commands.time_ns + round(1e9 * self._motors.dead_s), speeds)

    def _steps(self, time_ns: Stamps) -> tuple[list[bool], list[int]]:
        """Of each stamp, whether it rises, and by how much; 0 where the motors begin anew."""
        rises, steps_ns, last_ns = [], [], self._last_ns
        for now_ns in time_ns.tolist():
            step_ns = 0 if last_ns is None else now_ns - last_ns
            fell = step_ns <= -MAX_JUMP_BACK_NS
            rises.append(last_ns is None or step_ns > 0 or fell)
            steps_ns.append(step_ns if 0 < step_ns <= _PAUSE_NS else 0)
            last_ns = now_ns if rises[-1] else last_ns
        self._last_ns = last_ns
        return rises, steps_ns

    def _targets(self, u: Array, volts: Array) -> Array:
        """Speeds (N, R) at which the motors would settle by commands (N, R) and voltages (N, 1)."""
        c = np.array(self._motors.coefficients).T
        told = c[0] + u * (c[1] + u * c[2]) + volts * (c[3] + u * c[4])
        return np.where(u > 0.0, np.maximum(told, 0.0), 0.0)


def lag_weights(steps_s: Array, lag_s: float) -> tuple[list[float], list[float], list[float]]:
    """Weights (N,) of the last output, the input and the last input of a first-order lag, by steps (N,).

    The input is a straight line between samples: what is logged slower than it is sent is not late by that.
    """
    if lag_s <= 0.0:
        return [0.0] * len(steps_s), [1.0] * len(steps_s), [0.0] * len(steps_s)
    steps = np.maximum(steps_s, 1e-12) / lag_s
    keep = exponential(-steps)
    share = (1.0 - keep) / steps
    return keep.tolist(), (1.0 - share).tolist(), (share - keep).tolist()


def with_commanded_speeds(recording: Recording, motors: Motors | None) -> Recording:
    """The recording with rotor speeds by its commands, where it has any and the vehicle says how.

    Raises:
        LogError: for commands of another source, whose scale is another, or of another number of motors.
    """
    if motors is None or recording.commands is None or recording.commanded:
        return recording
    require_source(recording.source, recording.command_source, motors)
    found, known = recording.commands.commands.shape[1], len(motors.coefficients)
    if found != known:
        raise LogError(
            f"{recording.source}: topic motor_commands: {found} motors, and the vehicle file knows {known}"
        )
    speeds = CommandedSpeeds(motors).take(recording.commands, recording.battery)
    return replace(recording, rotor_speeds=speeds, commanded=True)


def require_source(where: str, source: str, motors: Motors) -> None:
    """Refuse commands of another source than the motors were identified with: a LogError that names both."""
    if source != motors.source:
        raise LogError(
            f"{where}: topic motor_commands: are of {source}, and the vehicle's motors are known by commands "
            f"of {motors.source}: their scales differ"
        )
