# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Vehicles: mass, inertia, rotors and sensors, read from a YAML file under config/vehicles."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from quadpi_core import array_checks
from quadpi_core.config_schema import (
    Expected,
    OneOf,
    Positive,
    Real,
    Section,
    Vector,
    Within,
    load_config,
    parse_config,
)
from quadpi_core.errors import VehicleError, named_in
from quadpi_core.frames import Array
from quadpi_core.records import ROTORS_MAX, Threshold, brief_repr

#     n = c · (1, u, u², V, u V),      followed by a first-order lag and a dead time,
#
# of each rotor; :mod:`quadpi_core.rotor_order` makes speeds of it.

TERMS = 5
LAG_MAX_S, DEAD_MAX_S = 0.5, 0.1
HALF_READING = Threshold(
    "speed of a rotor over that of the others at the same command from which its tachometer counts otherwise",
    (0.6, 1.6),
    "",
    "counting every second pulse, or one twice, gives 0.5 or 2; rotors of one vehicle differ by up to 15 %",
    "eckart51 to 54 of imrc_payload in ../shared/data read 0.502",
)
SILENT_SHARE = Threshold(
    "speed of a rotor over that of the others at the same command below which it stands, or is not told",
    0.1,
    "",
    "idling rotors turn at a fifth of the speed of hover, and tachometers that miscount at half",
    "eckart51 to 54 of imrc_payload in ../shared/data read 0.502",
)
USUAL_GAIN = Threshold(
    "standard deviation from flight to flight of one gain of all rotor speeds from commands",
    0.02,
    "",
    "air and battery change thrust by up to 7.6 % at the same command and voltage, speed by half of that",
    "of motors whose flights do not tell it; imrc_brushed of ../shared/data",
)


@dataclass(frozen=True, kw_only=True)
class Motors(Section):
    """The key `motors` of a vehicle file: flights of a vehicle that has it are read by their commands.

    Attributes:
        source: whose commands, as adapters and log formats name them: others have another scale.
        coefficients: of 1, u, u², V and u V, for each rotor, rad/s.
        lag_s: time constant of the first order.
        dead_s: dead time before it.
        volts: battery voltage until a message tells it; those of V are 0 where it is not used.
        error: root mean square of what is left, over the mean speed, by rotor, on flights left out; empty
            where no flight had rotor speeds, and their scale is that of hover thrust.
        gain: standard deviation from flight to flight of one gain of all speeds.
    """

    source: str
    coefficients: tuple[tuple[Real, ...], ...]
    lag_s: Annotated[float, Within(0.0, LAG_MAX_S)]
    dead_s: Annotated[float, Within(0.0, DEAD_MAX_S)] = 0.0
    volts: Positive = 1.0
    error: tuple[Real, ...] = ()
    gain: Annotated[float, Within(0.0, 1.0)] = USUAL_GAIN.value

    def __post_init__(self) -> None:
        """Refuse another number of coefficients."""
        if not self.coefficients or any(len(own) != TERMS for own in self.coefficients):
            raise ValueError(f"`coefficients` must list {TERMS} numbers for each rotor")

    def to_file(self) -> dict[str, Any]:
        """Content of the key."""
        lists = {"coefficients": [list(own) for own in self.coefficients], "error": list(self.error)}
        return {**asdict(self), **lists}

    @property
    def with_battery(self) -> bool:
        """Whether voltage is in it."""
        return any(own[3] or own[4] for own in self.coefficients)


# Rotors of a quadrotor, the only vehicle that logs, bags, live nodes and the search for what is missing in a
# simulation know so far; they refuse others.
ROTORS = 4
_SPIKE_MARGIN = 1.1
# Moment of inertia about z, over mass times squared distance of the rotors. Quadrotors from 27 g to 0.8 kg
# have 0.29 to 0.7: a factor of 15 beyond is a mistake in the unit (g m² for kg m² is 1000).
_YAW_INERTIA = (0.02, 10.0)
_CONSTANTS = ("rotor_speed_max_rad_s", "air_density_kg_m3", "gravity_m_s2")
# What to call for one, in refusals of anything else.
LOAD_VEHICLE = "Vehicle.load(name_or_path) reads one"
SPIN_SIGN = {"clockwise": 1.0, "counterclockwise": -1.0}


# Length of the estimator's buffer of past states [s].
_MOCAP_DELAY_MAX_S = 0.3


# Deviation of an attitude [rad] that is a placeholder: drivers fill covariances with ones, and no vehicle
# could fly with an attitude that uncertain.
FILLED_IN = 1.0


def stated_deviation(deviation: Array) -> Array:
    """Standard deviations (..., 3) of states, with 0 (not known) for placeholders, see :data:`FILLED_IN`.

    The deviations of position and velocity beside a placeholder of the attitude are placeholders too.
    """
    filled = (deviation[..., 1:2] >= FILLED_IN) & (deviation >= 0.0)
    return np.where(filled, 0.0, deviation)


@dataclass(frozen=True)
class SensorNoise(Section):
    """Standard deviations of the sensors that the estimator fuses: the key `noise` of a vehicle file.

    ``*_noise`` of the IMU are per sample; ``*_bias_walk`` are in units per square-root second. A pose of
    motion capture with stamp s was measured at s - `mocap_delay_s`, known to within `mocap_delay_std_s`. The
    estimator refines the delay, unless its deviation is zero: then it is exact. `wind_m_s` is of the wind to
    north and east where nothing measures it, 6 unless given; 0: there is none, as in a hall.
    """

    accelerometer_noise_m_s2: Positive = 0.3
    gyro_noise_rad_s: Positive = 0.02
    accelerometer_bias_walk: Positive = 0.02
    gyro_bias_walk: Positive = 0.001
    mocap_position_m: Positive = 0.003
    mocap_attitude_rad: Positive = 0.01
    mocap_velocity_m_s: Positive = 0.05
    mocap_delay_s: Annotated[float, Within(-_MOCAP_DELAY_MAX_S, _MOCAP_DELAY_MAX_S)] = 0.0
    mocap_delay_std_s: Annotated[float, Within(0.0, _MOCAP_DELAY_MAX_S)] = 0.05
    state_position_m: Positive | None = None
    state_attitude_rad: Positive | None = None
    state_velocity_m_s: Positive | None = None
    wind_m_s: Annotated[float, Within(0.0)] | None = None

    @property
    def of_state(self) -> tuple[float | None, float | None, float | None]:
        """Deviations of a slow state that states none: position m, attitude rad, velocity m/s; or None."""
        return self.state_position_m, self.state_attitude_rad, self.state_velocity_m_s

    def of_odometry(self, stated: Array) -> Array:
        """Deviations (N, 3) to use for the stated ones of `mocap/odometry`, in the units of :attr:`of_state`.

        At least those of motion capture in this file: drivers often state a variance that nobody measured,
        such as 1e-9, with which the filter would reject later samples. Negative ones (not measured) stay.
        """
        stated = stated_deviation(stated)
        usual = np.array([told or 0.0 for told in self.of_state])
        surest = np.array([self.mocap_position_m, self.mocap_attitude_rad, self.mocap_velocity_m_s])
        return np.where(stated > 0.0, np.maximum(stated, surest), np.where(stated == 0.0, usual, stated))


# Compared and hashed by identity: arrays have no truth value.
@dataclass(frozen=True, eq=False)
class Vehicle:
    """A multicopter with up to 12 rotors as the model sees it; SI units, body axes forward-right-down.

    Attributes:
        inertia: (3, 3), about the centre of gravity.
        rotor_positions: (rotors, 3), from the centre of gravity; the row order is the rotor order.
        rotor_spins: (rotors,), +1 where the rotor turns clockwise seen from above, else -1.
        pole_pairs: mechanical speed = electrical speed / pole_pairs; None where the source of the
            vehicle does not say it; electrical speeds are then refused.
        thrust_coefficient: C_T = thrust / (ρ π R⁴ ω²) of a rotor in still air, where it is known; flights are
            compared with it.
        motors: rotor speed by command, for flights without tachometers: where a flight has commands, its
            rotor speeds are made of them.
    """

    __repr__ = brief_repr

    name: str
    mass_kg: float
    inertia: Array
    rotor_radius_m: float
    rotor_positions: Array
    rotor_spins: Array
    pole_pairs: int | None
    rotor_speed_max_rad_s: float = 1e4
    air_density_kg_m3: float = 1.225
    gravity_m_s2: float = 9.80665
    noise: SensorNoise = field(default_factory=SensorNoise)
    thrust_coefficient: float | None = None
    motors: Motors | None = None

    def __post_init__(self) -> None:
        """Refuse what is no vehicle, in the words of `quadpi_core.array_checks`."""
        with named_in(f"vehicle {self.name}"):
            for name in ("mass_kg", "rotor_radius_m", *_CONSTANTS):
                array_checks.number(name, getattr(self, name), above=0.0)
            inertia = array_checks.floats("inertia", self.inertia, 3, rows=3)
            positions = array_checks.floats("rotor_positions", self.rotor_positions, 3)
            count = len(positions)
            if not 1 <= count <= ROTORS_MAX:
                raise VehicleError(f"rotor_positions: expected 1 to {ROTORS_MAX} rotors, found {count}")
            spins = array_checks.floats("rotor_spins", self.rotor_spins, rows=count, of="rotor_positions")
            checked = {"inertia": inertia, "rotor_positions": positions, "rotor_spins": spins}
            for name, array in checked.items():
                object.__setattr__(self, name, array)
            if not np.all(np.abs(self.rotor_spins) == 1.0):
                raise VehicleError(f"rotor_spins: expected 1 or -1 each, found {self.rotor_spins.tolist()}")
            array_checks.instance("noise", self.noise, SensorNoise)

    @classmethod
    def load(cls, name_or_path: str | Path) -> Vehicle:
        """Read a vehicle by the name of a file in config/vehicles, or by path.

        Raises:
            VehicleError: naming the file and the key that is missing, unknown or impossible.
        """
        path, content = load_config("vehicle", name_or_path, _VehicleFile, VehicleError)
        return content.vehicle(path.stem)

    @classmethod
    def from_content(cls, data: Any, name: str, where: str) -> Vehicle:
        """The vehicle of a vehicle file's content, as of :meth:`to_file`.

        Raises:
            VehicleError: that begins with `where`, naming the key that is missing, unknown or impossible.
        """
        return parse_config(_VehicleFile, data, where, VehicleError).vehicle(name)

    def to_file(self) -> dict[str, Any]:
        """Content of a vehicle file that :meth:`load` reads as this vehicle, without a simulation."""
        spins = {sign: word for word, sign in SPIN_SIGN.items()}
        numbers = ("mass_kg", "rotor_radius_m", *_CONSTANTS, "pole_pairs", "thrust_coefficient")
        return {
            **{name: getattr(self, name) for name in numbers},
            "inertia_kg_m2": self.inertia.tolist(),
            "rotors": [
                {"position_m": position.tolist(), "spin": spins[float(spin)]}
                for position, spin in zip(self.rotor_positions, self.rotor_spins, strict=True)
            ],
            "noise": {name: value for name, value in asdict(self.noise).items() if value is not None},
            **({} if self.motors is None else {"motors": self.motors.to_file()}),
        }

    @property
    def rotor_count(self) -> int:
        """Number of rotors."""
        return len(self.rotor_spins)

    def require_four(self, what: str) -> None:
        """Refuse another number of rotors for what knows four, with a VehicleError that says what does."""
        if self.rotor_count != ROTORS:
            raise VehicleError(f"vehicle {self.name} has {self.rotor_count} rotors: {what} with four alone")

    @cached_property
    def hover_induced_velocity(self) -> float:
        """v_h [m/s]: induced velocity in hover by momentum theory, from weight and disc area."""
        disc_area = self.rotor_count * np.pi * np.square(self.rotor_radius_m)
        weight = self.mass_kg * self.gravity_m_s2
        return float(np.sqrt(weight / (2.0 * self.air_density_kg_m3 * disc_area)))

    @property
    def rotor_speed_spike_rad_s(self) -> float:
        """Limit above which a measured speed is a spike, with a margin for noise at the largest speed."""
        return _SPIKE_MARGIN * self.rotor_speed_max_rad_s

    @cached_property
    def fingerprint(self) -> str:
        """Hash of the numbers that inputs and measured wrench depend on: a model fits only these."""
        numbers = np.concatenate(
            [
                [self.mass_kg, self.rotor_radius_m, self.air_density_kg_m3, self.gravity_m_s2],
                self.inertia.ravel(),
                np.sign(self.rotor_positions[:, :2]).ravel(),
                self.rotor_spins,
            ]
        )
        return hashlib.sha256(numbers.astype("<f8").tobytes()).hexdigest()

    def rotor_speeds_from_erpm(self, erpm: Array) -> Array:
        """Convert electrical rev/min (..., rotors) to mechanical rad/s.

        Raises:
            ArgumentError: for what are no numbers of its rotors.
            VehicleError: if the vehicle file does not give the pole pairs.
        """
        erpm = array_checks.by_rotor("erpm", erpm, self.rotor_count)
        if self.pole_pairs is None:
            raise VehicleError(
                f"vehicle {self.name}: electrical rotor speeds need `pole_pairs` in the vehicle file"
            )
        return erpm * (2.0 * np.pi / 60.0 / self.pole_pairs)


def simulation_section(name_or_path: str | Path) -> tuple[Path, dict[str, Any]]:
    """Path and key `simulation` of a vehicle file; the rooms that simulate read what it holds."""
    path, content = load_config("vehicle", name_or_path, _VehicleFile, VehicleError)
    return path, content.simulation


@dataclass(frozen=True, kw_only=True)
class _Rotor(Section):
    """An entry of `rotors`."""

    position_m: Vector
    spin: Annotated[str, OneOf(*SPIN_SIGN)]


@dataclass(frozen=True, kw_only=True)
class _VehicleFile(Section):
    """The content of a vehicle file; config/vehicles holds examples."""

    mass_kg: Positive
    inertia_kg_m2: Annotated[
        Vector | tuple[Vector, Vector, Vector], Expected("must be 3 numbers or a 3x3 matrix")
    ]
    rotor_radius_m: Positive
    rotors: tuple[_Rotor, ...]
    pole_pairs: Annotated[
        Annotated[int, Within(positive=True)] | None, Expected("must be a positive whole number or null")
    ]
    rotor_speed_max_rad_s: Positive = Vehicle.rotor_speed_max_rad_s
    air_density_kg_m3: Positive = Vehicle.air_density_kg_m3
    gravity_m_s2: Positive = Vehicle.gravity_m_s2
    thrust_coefficient: Positive | None = None
    noise: SensorNoise = SensorNoise()
    motors: Motors | None = None
    simulation: dict[str, Any] = field(default_factory=dict)
    source: Any = None

    def __post_init__(self) -> None:
        """Refuse numbers that no multicopter has."""
        if not 1 <= len(self.rotors) <= ROTORS_MAX:
            raise ValueError(f"`rotors` must list 1 to {ROTORS_MAX} rotors")
        if not is_rigid_body(self._inertia):
            raise ValueError(
                "`inertia_kg_m2` is not the inertia of a rigid body "
                "(symmetric, principal moments positive and obeying the triangle inequality)"
            )
        if self.motors is not None and len(self.motors.coefficients) != len(self.rotors):
            raise ValueError(f"`motors` must have `coefficients` of each of the {len(self.rotors)} rotors")
        if len(self.rotors) == 4:
            self._check_four()
        if len(self.rotors) < 3:
            return
        arm_squared = np.mean(np.sum(self._positions[:, :2] ** 2, axis=1))
        ratio = float(self._inertia[2, 2] / (self.mass_kg * arm_squared))
        if not _YAW_INERTIA[0] < ratio < _YAW_INERTIA[1]:
            raise ValueError(
                f"`inertia_kg_m2`: about z it is {ratio:.3g} times mass times squared distance of the rotors "
                "from the centre, expected 0.2 to 1: wrong unit?"
            )

    def _check_four(self) -> None:
        """Refuse four rotors that no frame has: of more, any layout may hold thrust and moments."""
        signs = np.sign(self._positions[:, :2])
        on_axes = (np.abs(signs).sum(axis=1) == 1.0).all()
        if len({tuple(pair) for pair in signs.tolist()}) < 4 or not (on_axes or signs.all()):
            raise ValueError(
                "`rotors` must lie one in each quadrant (front left, front right, rear left, rear right), or "
                "one on each half of the body axes"
            )
        around = np.argsort(np.arctan2(signs[:, 1], signs[:, 0]))
        if abs(float(np.sum(self._spins[around] * (1.0, -1.0, 1.0, -1.0)))) < 4:
            raise ValueError(
                "`rotors`: opposite rotors must turn the same way and neighbours the other way, or nothing "
                "holds the yaw"
            )

    @property
    def _inertia(self) -> Array:
        inertia = np.array(self.inertia_kg_m2)
        return np.diag(inertia) if inertia.ndim == 1 else inertia

    @property
    def _positions(self) -> Array:
        return np.array([rotor.position_m for rotor in self.rotors])

    @property
    def _spins(self) -> Array:
        return np.array([SPIN_SIGN[rotor.spin] for rotor in self.rotors])

    def vehicle(self, name: str) -> Vehicle:
        """The vehicle of the file."""
        same = {one.name: getattr(self, one.name) for one in fields(Vehicle) if hasattr(self, one.name)}
        arrays = {"inertia": self._inertia, "rotor_positions": self._positions, "rotor_spins": self._spins}
        numbers: dict[str, Any] = {**same, **arrays}
        return Vehicle(name=name, **numbers)


def is_rigid_body(inertia: Array) -> bool:
    """Whether a body has this inertia (3, 3): symmetric, positive, no moment above the sum of the others."""
    moments = np.linalg.eigvalsh(inertia)
    return bool(np.allclose(inertia, inertia.T) and moments[0] > 0 and moments[0] + moments[1] >= moments[2])
