# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Flights of RotorPy: its equations of motion and controller, with what is hidden added to its wrench."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from independent.airframes import GRAVITY_M_S2, Airframe, Array, Blades
from independent.hidden_effects import Flown
from independent.hidden_physics import LAWS, Moment

RATE_HZ = 250.0
DURATION_S = 12.0
# Farther from its path than this, a flight is no flight to learn from.
_LOST_M = 2.5
# Roughness of the floor, m: wind grows with the logarithm of the height over it.
_ROUGHNESS_M = 0.03

Path = Callable[[Array], Array]


@dataclass(frozen=True)
class Path4:
    """Where to fly: functions from time (N,) to (N,) of x, y, z [m] and yaw [rad]."""

    name: str
    x: Path
    y: Path
    z: Path
    yaw: Path

    def sampled(self, time: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Position, velocity, acceleration (N, 3), yaw and yaw rate (N,), by differences of a fine grid."""
        step = 1e-3
        moved = [
            np.stack([axis(time + shift) for axis in (self.x, self.y, self.z, self.yaw)], axis=1)
            for shift in (-step, 0.0, step)
        ]
        before, here, after = moved
        speed = (after - before) / (2.0 * step)
        pushed = (after - 2.0 * here + before) / step**2
        return here[:, :3], speed[:, :3], pushed[:, :3], here[:, 3], speed[:, 3]


def _fade(time: Array, start: float, end: float, over: float) -> Array:
    """0 before the start, 1 in between, 0 after the end; smooth to the third derivative."""
    rise = np.clip((time - start) / over, 0.0, 1.0)
    fall = np.clip((end - time) / over, 0.0, 1.0)
    ramp = np.minimum(rise, fall)
    smooth: Array = ramp**4 * (35.0 - 84.0 * ramp + 70.0 * ramp**2 - 20.0 * ramp**3)
    return smooth


def _sine(
    amplitude: float, hz: float, start: float, end: float, phase: float = 0.0, over: float = 1.5
) -> Path:
    return lambda t: amplitude * _fade(t, start, end, over) * np.sin(2.0 * np.pi * hz * (t - start) + phase)


def _bump(amplitude: float, start: float, end: float, over: float) -> Path:
    return lambda t: amplitude * _fade(t, start, end, over)


def _sum(*parts: Path) -> Path:
    return lambda t: np.sum([part(t) for part in parts], axis=0) if parts else np.zeros_like(t)


def _at(height: float) -> Path:
    return lambda t: np.full_like(t, height)


def paths(airframe: Airframe, rng: np.random.Generator) -> list[Path4]:
    """Eight flights that hold what tells effects apart, each a little different from seed to seed."""
    end, none = DURATION_S - 0.3, _sum()

    def about(value: float) -> float:
        return value * float(rng.uniform(0.9, 1.1))

    v, climb, low = airframe.speed_m_s, airframe.climb_m_s, airframe.lowest_m

    def swing(speed: float, hz: float, start: float, stop: float, phase: float = 0.0) -> Path:
        return _sine(about(speed) / (2.0 * np.pi * hz), about(hz), start, stop, phase, over=2.8)

    base = 2.0
    span = 4.0 * low
    wiggle = 3.5 / (2.0 * np.pi) ** 2
    return [
        Path4(
            "low",
            swing(0.25 * v, 0.4, 6.0, end),
            none,
            _sum(_at(low + span), _bump(-about(span), 0.5, 3.6, 1.2),
                 _bump(-about(0.8 * span), 4.2, 9.0, 1.2), _sine(0.1 * span, 0.8, 4.4, 8.8)),
            _bump(about(1.6), 4.5, end, 2.0),
        ),
        Path4(
            "climb",
            none,
            _sine(0.05, 1.1, 6.0, end),
            _sum(_at(base + 3.0), swing(climb, 0.28, 0.4, 8.0), swing(0.5 * climb, 0.6, 7.0, end)),
            none,
        ),
        Path4(
            "forward",
            _sum(swing(0.5 * v, 0.3, 0.3, 5.0), swing(v, 0.2, 4.5, end)),
            none,
            _sum(_at(base), _sine(0.2, 0.5, 1.0, 6.0)),
            none,
        ),
        Path4(
            "sideways",
            none,
            _sum(swing(v, 0.2, 0.3, 7.5), swing(0.5 * v, 0.3, 7.0, end)),
            _at(base),
            none,
        ),
        Path4(
            "coupled",
            swing(0.7 * v, 0.22, 0.3, end),
            swing(0.6 * v, 0.27, 0.3, end, 1.0),
            _sum(_at(base), swing(0.3 * climb, 0.33, 0.3, end)),
            _sine(about(1.1), 0.2, 0.3, end),
        ),
        Path4(
            "turns",
            swing(0.5 * v, 0.25, 5.0, end),
            none,
            _at(base),
            _sum(_bump(about(5.5), 0.3, end, 4.0), _sine(about(0.4), 1.0, 4.5, 7.5, over=0.6)),
        ),
        Path4(
            "attitude",
            _sum(_sine(about(wiggle), 1.0, 0.3, 4.0), _sine(about(wiggle) / 2.6, 1.6, 7.5, end)),
            _sum(_sine(about(wiggle), 1.0, 3.5, 7.5), _sine(about(wiggle) / 3.6, 1.9, 7.5, end)),
            _at(base),
            _sum(_sine(about(0.35), 0.9, 2.0, 7.0), _sine(about(0.25), 1.4, 7.0, end)),
        ),
        Path4(
            "throttle",
            _sine(about(wiggle) / 2.2, 1.4, 4.0, 8.0),
            _sine(about(wiggle) / 2.2, 1.4, 7.0, end),
            _sum(_at(base), _sine(about(0.05), 1.3, 0.3, 5.0), _sine(about(0.022), 2.0, 4.5, 9.0),
                 _sine(about(0.3), 0.5, 7.5, end)),
            _sine(about(0.3), 0.8, 0.5, 5.0),
        ),
    ]  # fmt: skip


@dataclass(frozen=True)
class Truth:
    """What happened, at RATE_HZ: of the true centre of gravity, RotorPy's axes.

    Attributes:
        time: (N,) s.
        position, velocity: (N, 3), world axes.
        acceleration: (N, 3), specific: gravity not included, world axes.
        attitude: (N, 4), x y z w, body to world.
        rates, turning: (N, 3) rad/s and rad/s², body axes.
        rotor_speeds: (N, 4) rad/s.
    """

    name: str
    time: Array
    position: Array
    velocity: Array
    acceleration: Array
    attitude: Array
    rates: Array
    turning: Array
    rotor_speeds: Array


class PlainRotation:
    """What RotorPy uses of scipy's `Rotation`, whose checks take most of a step's time."""

    def __init__(self, matrix: Array) -> None:
        self._matrix = matrix

    @classmethod
    def from_quat(cls, quaternion: Array) -> PlainRotation:
        return cls(_matrix(quaternion))

    @classmethod
    def from_matrix(cls, matrix: Array) -> PlainRotation:
        return cls(matrix)

    def as_matrix(self) -> Array:
        return self._matrix

    def as_quat(self) -> Array:
        """Of a rotation by less than half a turn."""
        m = self._matrix
        w = 0.5 * np.sqrt(max(1.0 + m[0, 0] + m[1, 1] + m[2, 2], 1e-12))
        x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
        return np.array([x / (4.0 * w), y / (4.0 * w), z / (4.0 * w), w])


def _matrix(quaternion: Array) -> Array:
    x, y, z, w = quaternion.tolist()
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


@lru_cache
def _multirotor() -> type:
    """RotorPy's vehicle with hidden laws; a class inside, so that this file loads where RotorPy is absent."""
    from rotorpy.controllers import quadrotor_control
    from rotorpy.vehicles import multirotor

    for module in (multirotor, quadrotor_control):
        module.Rotation = PlainRotation

    class Hiding(multirotor.Multirotor):  # type: ignore[misc]
        """Its equations of motion, with the wrench of hidden laws added to its own."""

        def hide(self, flown: Flown, memory: dict[str, Any]) -> None:
            self.flown, self.memory, self.now = flown, memory, 0.0
            self.blades = Blades.of(flown.airframe)

        def _s_dot_fn(self, t: float, s: Array, command: Array) -> Array:
            self.here, self.command = s, command
            self.time_s = self.now + t
            slope: Array = super()._s_dot_fn(t, s, command)
            return slope

        def compute_body_wrench(self, rates: Array, speeds: Array, airspeed: Array) -> tuple[Array, Array]:
            force, moment = super().compute_body_wrench(rates, speeds, airspeed)
            if self.flown.laws:
                m = Moment(
                    airframe=self.flown.airframe,
                    blades=self.blades,
                    rotors=self.rotor_geometry,
                    thrust_n=self.k_eta * speeds**2,
                    time_s=self.time_s,
                    position=self.here[:3],
                    rotation=PlainRotation.from_quat(self.here[6:10]).as_matrix(),
                    velocity=self.here[3:6],
                    airspeed=airspeed,
                    rates=rates,
                    speeds=speeds,
                    spin_ups=(self.command - speeds) / self.tau_m,
                    memory=self.memory,
                )
                for name, parameters in self.flown.laws.items():
                    more = LAWS[name](m, *parameters)
                    force, moment = force + more[0], moment + more[1]
            return force, moment

        def advanced(
            self, state: dict[str, Array], command: Array, step: float
        ) -> tuple[Array, dict[str, Array]]:
            """Slope now and state one step on, by Runge and Kutta of fourth order.

            RotorPy's own `step` spends nine tenths of its time in the set-up of scipy's adaptive solver; a
            test compares the two. The midpoint rule is no cheaper substitute: it lets the thrust lead the
            rotor speeds by a millisecond, which a search rightly takes for damping of the rates.
            """
            s = self._pack_state(state)
            first = self._s_dot_fn(0.0, s, command)
            second = self._s_dot_fn(0.5 * step, s + 0.5 * step * first, command)
            third = self._s_dot_fn(0.5 * step, s + 0.5 * step * second, command)
            fourth = self._s_dot_fn(step, s + step * third, command)
            after = self._unpack_state(s + step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth))
            after["q"] = after["q"] / np.linalg.norm(after["q"])
            self.now += step
            return first, after

    return Hiding


def flown_parameters(flown: Flown) -> dict[str, Any]:
    """RotorPy's parameters, its rotors about the true centre of gravity."""
    placed = {name: place - flown.centre for name, place in flown.parameters["rotor_pos"].items()}
    return {**flown.parameters, "rotor_pos": placed}


def _winds(flown: Flown, samples: int, rng: np.random.Generator) -> Array:
    """Gusts (N, 3) at every sample."""
    if flown.gust_m_s == 0.0:
        return np.zeros((samples, 3))
    keep = np.exp(-1.0 / (RATE_HZ * flown.gust_s))
    fresh = flown.gust_m_s * np.sqrt(1.0 - keep**2) * rng.standard_normal((samples, 3))
    gusts = np.zeros((samples, 3))
    gusts[0] = flown.gust_m_s * rng.standard_normal(3)
    for k in range(1, samples):
        gusts[k] = keep * gusts[k - 1] + fresh[k]
    weighted: Array = gusts * np.array([1.0, 1.0, 0.5])
    return weighted


def fly(flown: Flown, path: Path4, rng: np.random.Generator) -> Truth:
    """One flight.

    Raises:
        RuntimeError: where RotorPy loses its path.
    """
    from rotorpy.controllers.quadrotor_control import SE3Control

    parameters = flown_parameters(flown)
    samples = int(DURATION_S * RATE_HZ)
    time = np.arange(samples) / RATE_HZ
    position, velocity, acceleration, yaw, yaw_rate = path.sampled(time)
    airframe = flown.airframe
    state = {
        "x": position[0].copy(),
        "v": np.zeros(3),
        "q": np.array([0.0, 0.0, np.sin(0.5 * yaw[0]), np.cos(0.5 * yaw[0])]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": np.full(4, airframe.hover_rad_s),
    }
    vehicle = _multirotor()(parameters, initial_state=state)
    vehicle.hide(flown, {"phase": float(rng.uniform(-np.pi, np.pi))})
    # The controller knows the vehicle of the file; what it does not know shows as a distance to the path.
    controller = SE3Control(airframe.parameters)
    gusts = _winds(flown, samples, rng)
    rows, slopes = np.empty((samples, 20)), np.empty((samples, 20))
    integral = np.zeros(3)
    for k in range(samples):
        height = max(float(state["x"][2]), 0.0)
        profile = np.log1p(height / _ROUGHNESS_M) / np.log1p(flown.wind_height_m / _ROUGHNESS_M)
        state["wind"] = gusts[k] + profile * np.append(flown.wind_m_s, 0.0)
        away = state["x"] - position[k]
        integral += np.clip(away, -0.3, 0.3) / RATE_HZ
        wanted = {
            "x": position[k],
            "x_dot": velocity[k],
            "x_ddot": acceleration[k] - 3.0 * integral,
            "yaw": yaw[k],
            "yaw_dot": yaw_rate[k],
        }
        control = controller.update(time[k], state, wanted)
        command = np.clip(control["cmd_motor_speeds"], vehicle.rotor_speed_min, vehicle.rotor_speed_max)
        rows[k] = vehicle._pack_state(state)
        slopes[k], state = vehicle.advanced(state, command, 1.0 / RATE_HZ)
        if not np.linalg.norm(away) < _LOST_M:
            raise RuntimeError(f"RotorPy loses its path after {time[k]:.2f} s of {path.name}")
    return Truth(
        name=path.name,
        time=time,
        position=rows[:, 0:3],
        velocity=rows[:, 3:6],
        acceleration=slopes[:, 3:6] + np.array([0.0, 0.0, GRAVITY_M_S2]),
        attitude=rows[:, 6:10],
        rates=rows[:, 10:13],
        turning=slopes[:, 10:13],
        rotor_speeds=rows[:, 16:20],
    )
