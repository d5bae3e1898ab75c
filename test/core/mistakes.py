# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Mistakes that people make, done to a recording and its vehicle, with the finding that should name each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from quadpi_core.flight import Recording
from quadpi_core.frames import Array
from quadpi_core.vehicle import Vehicle

FLIP = np.diag([1.0, -1.0, -1.0])
NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
LEFT_RIGHT, FRONT_REAR = np.diag([1.0, -1.0, 1.0]), np.diag([-1.0, 1.0, 1.0])
XY = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Mistake:
    """What is done to the data, and the `mistake` of the finding that should say so."""

    done: Callable[[Recording, Vehicle], tuple[Recording, Vehicle]]
    named: str


def about(axis: str, degrees: float) -> Array:
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def pose(**changes: Callable[[Array], Array]) -> Callable[[Recording, Vehicle], Any]:
    def done(recording, vehicle):
        stream = recording.pose
        changed = {name: change(getattr(stream, name)) for name, change in changes.items()}
        return replace(recording, pose=replace(stream, **changed)), vehicle

    return done


def attitude(world: Array, body: Array) -> Callable[[Array], Array]:
    def turned(quaternions: Array) -> Array:
        matrices = world @ Rotation.from_quat(quaternions, scalar_first=True).as_matrix() @ body
        return Rotation.from_matrix(matrices).as_quat(scalar_first=True)

    return turned


def imu(gyro: Array, accelerometer: Array | None = None) -> Callable[[Recording, Vehicle], Any]:
    force = gyro if accelerometer is None else accelerometer

    def done(recording, vehicle):
        stream = recording.imu
        turned = replace(
            stream,
            angular_velocity=stream.angular_velocity @ gyro.T,
            specific_force=stream.specific_force @ force.T,
        )
        return replace(recording, imu=turned), vehicle

    return done


def rotors(
    columns: Any = slice(None),
    factor: Any = 1.0,
    late_s: float = 0.0,
    power: float = 1.0,
    shift: float = 0.0,
) -> Callable[..., Any]:
    """Other columns, scale, stamps, power (of the same median), or a later share of the flight."""

    def done(recording, vehicle):
        stream = recording.rotor_speeds
        usual = np.median(stream.speeds)
        speeds = np.roll(stream.speeds[:, columns], round(shift * len(stream)), axis=0)
        changed = replace(
            stream,
            time_ns=stream.time_ns + round(late_s * 1e9),
            speeds=factor * usual * (speeds / usual) ** power,
        )
        return replace(recording, rotor_speeds=changed), vehicle

    return done


def vehicle(**changes: Callable[[Any], Any]) -> Callable[[Recording, Vehicle], Any]:
    def done(recording, of):
        return recording, replace(of, **{name: change(getattr(of, name)) for name, change in changes.items()})

    return done


def clock(factor: float) -> Callable[[Recording, Vehicle], Any]:
    def done(recording, of):
        start = recording.imu.time_ns[0]
        streams = {
            name: replace(
                getattr(recording, name),
                time_ns=start
                + np.round(factor * (getattr(recording, name).time_ns - start)).astype(np.int64),
            )
            for name in ("imu", "rotor_speeds", "pose")
        }
        return replace(recording, **streams), of

    return done


def origin(*place_m: float) -> Callable[[Recording, Vehicle], Any]:
    def done(recording, of):
        stream = recording.pose
        moved = Rotation.from_quat(stream.attitude, scalar_first=True).apply(place_m)
        return replace(recording, pose=replace(stream, position=stream.position + moved)), of

    return done


def frozen(seconds: float, share: float = 0.5) -> Callable[[Recording, Vehicle], Any]:
    """Motion capture that repeats its pose from a share of the flight on."""

    def done(recording, of):
        stream = recording.pose
        time_s = (stream.time_ns - stream.time_ns[0]) * 1e-9
        first, last = np.searchsorted(time_s, share * time_s[-1] + np.array([0.0, seconds]))
        shown = np.arange(len(stream))
        shown[first:last] = first
        still = replace(stream, position=stream.position[shown], attitude=stream.attitude[shown])
        return replace(recording, pose=still), of

    return done


_EYE = np.eye(3)
MISTAKES = {
    "quaternion conjugated": Mistake(pose(attitude=lambda q: q * [1, -1, -1, -1]), "attitude conjugated"),
    "NED and FRD written into ENU and FLU": Mistake(
        pose(attitude=attitude(NED, FLIP), position=lambda p: p @ NED.T), "ned frd"
    ),
    "so, but for the position": Mistake(pose(attitude=attitude(NED, FLIP)), "attitude ned frd"),
    "so, the position alone": Mistake(pose(position=lambda p: p @ NED.T), "position ned"),
    "position axes swapped": Mistake(pose(position=lambda p: p @ XY), "position swapped"),
    "height downwards": Mistake(pose(position=lambda p: p * [1, 1, -1]), "position axes"),
    "position in feet": Mistake(pose(position=lambda p: p / 0.3048), "position scale"),
    "worlds yawed against each other": Mistake(
        pose(attitude=attitude(about("z", 90), _EYE)), "position axes"
    ),
    "imu yawed by 90": Mistake(imu(about("z", 90)), "imu turned"),
    "imu yawed by 180": Mistake(imu(about("z", 180)), "imu turned"),
    "imu yawed by 45": Mistake(imu(about("z", 45)), "body yawed"),
    "imu mirrored": Mistake(imu(LEFT_RIGHT), "imu mirrored"),
    "imu mirrored as vectors are": Mistake(imu(-LEFT_RIGHT, LEFT_RIGHT), "imu mirrored"),
    "imu x and y swapped": Mistake(imu(XY), "imu mirrored"),
    "gyro inverted": Mistake(imu(-_EYE, _EYE), "gyro axes"),
    "gyro in other axes": Mistake(imu(FLIP, _EYE), "gyro axes"),
    "accelerometer x and y swapped": Mistake(imu(_EYE, XY), "accelerometer axes"),
    "accelerometer x reversed": Mistake(imu(_EYE, FRONT_REAR), "accelerometer axes"),
    "accelerometer reads 5 % more": Mistake(imu(_EYE, 1.05 * _EYE), "accelerometer scale"),
    "mocap origin 8 cm in front": Mistake(origin(0.08, 0.0, 0.0), "mocap origin"),
    "mocap origin 8 cm below": Mistake(origin(0.0, 0.0, 0.08), "mocap origin"),
    "mocap frozen": Mistake(frozen(1.5), "frozen state"),
    "mocap yawed by 20": Mistake(pose(attitude=attitude(_EYE, about("z", 20))), "body yawed"),
    "mocap yawed by 90": Mistake(pose(attitude=attitude(_EYE, about("z", 90))), "imu turned"),
    "mocap body tilted by 8": Mistake(pose(attitude=attitude(_EYE, about("x", 8))), "body tilted"),
    "mocap world tilted by 8": Mistake(
        pose(attitude=attitude(about("y", 8), _EYE), position=lambda p: p @ about("y", 8).T), "world tilted"
    ),
    "clock too fast": Mistake(clock(1.25), "clock"),
    "clock too slow": Mistake(clock(0.8), "clock"),
    "rotor stamps late": Mistake(rotors(late_s=0.1), "rotor stamps"),
    "rotor stamps early": Mistake(rotors(late_s=-0.1), "rotor stamps"),
    "neighbours swapped": Mistake(rotors([1, 0, 2, 3]), "rotor order"),
    "opposite rotors swapped": Mistake(rotors([2, 1, 0, 3]), "rotor order"),
    "rotors moved on by one": Mistake(rotors([1, 2, 3, 0]), "rotor order"),
    "rotors in reverse": Mistake(rotors([3, 2, 1, 0]), "rotor order"),
    "vehicle mirrored": Mistake(vehicle(rotor_positions=lambda p: p @ LEFT_RIGHT), "vehicle mirrored"),
    "vehicle front to rear": Mistake(vehicle(rotor_positions=lambda p: p @ FRONT_REAR), "vehicle mirrored"),
    "all spins inverted": Mistake(vehicle(rotor_spins=np.negative), "spins inverted"),
    "one rotor low": Mistake(rotors(factor=np.array([1.0, 1.0, 0.9, 1.0])), "one rotor"),
    "two rotors on one channel": Mistake(rotors([0, 0, 2, 3]), "one channel"),
    "rotor speeds of another time": Mistake(rotors(shift=0.4), "foreign rotors"),
    "squares of rotor speeds": Mistake(rotors(power=2.0), "squared speeds"),
    "arms twice": Mistake(vehicle(rotor_positions=lambda p: 2.0 * p), "arms"),
    "mass 20 % more": Mistake(vehicle(mass_kg=lambda m: 1.2 * m), "thrust"),
    "mass 20 % less": Mistake(vehicle(mass_kg=lambda m: 0.8 * m), "thrust"),
    "inertia twice": Mistake(vehicle(inertia=lambda i: 2.0 * i), "inertia"),
    "mass twice": Mistake(vehicle(mass_kg=lambda m: 2.0 * m), "thrust"),
    "mass half": Mistake(vehicle(mass_kg=lambda m: 0.5 * m), "inertia"),
    "pole pairs 7 for 6": Mistake(rotors(factor=6 / 7), "thrust"),
    "pole pairs 6 for 7": Mistake(rotors(factor=7 / 6), "thrust"),
}
