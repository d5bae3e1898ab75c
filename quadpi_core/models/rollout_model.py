# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""A model that predicts the state ahead: open loop by the rotor speeds, with a tube around the prediction.

The mean starts at the estimated state, with the disturbance that the past of the flight tells (see
`disturbance`), which decays. The tube is the covariance of the errors that start state, disturbance and
parameters leave, scaled by a factor that was calibrated on flights left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core.config_schema import NotNegative, Positive, Text, parse_config
from quadpi_core.errors import ModelError, named_in
from quadpi_core.flight import Flight, hole_ends
from quadpi_core.frames import Array
from quadpi_core.inputs import relative_to_air
from quadpi_core.models.physical_rollout import (
    POSITION,
    STATES,
    Disturbance,
    Disturbances,
    Rolled,
    Track,
    roll_out,
)
from quadpi_core.models.physical_terms import (
    TERM_INDEX,
    TERM_NAMES,
    TERMS,
    MotionSample,
    PhysicalVehicle,
    control_signs,
    wrenches,
)
from quadpi_core.models.tubes import TubeCalibration, Uncertainty, error_covariance
from quadpi_core.records import ROTORS_MAX, Records, record_dtype
from quadpi_core.signals.wrench import measured_wrench
from quadpi_core.vehicle import Vehicle


class StoredBody(NamedTuple):
    """Everything that the equations of motion of a vehicle need, as a model folder stores it.

    Attributes:
        values: (P,) parameters in the order of TERMS; zero where the folder has none.
        covariance: (P, P) of them.
        vehicle: PHYSICAL_VEHICLE (1,).
        inertia: (3, 3) kg m².
    """

    values: Array
    covariance: Array
    vehicle: Records
    inertia: Array

    def arrays(self, values: str) -> dict[str, Array]:
        """What a stored model keeps, the parameters by the name of `values`."""
        return {
            values: self.values,
            "covariance": np.ascontiguousarray(self.covariance),
            "vehicle": _stored_vehicle(self.vehicle),
            "inertia": np.ascontiguousarray(self.inertia),
        }

    @classmethod
    def read(cls, names: Sequence[str], arrays: Mapping[str, Array], values: str) -> StoredBody:
        """Read what :meth:`arrays` gave, for parameters of these names.

        Raises:
            ModelError: for parameters that this version does not know, and numbers that no fit gives.
        """
        require_known(names)
        order, count = [TERM_INDEX[name] for name in names], len(names)
        shapes = {values: (count,), "covariance": (count, count), "inertia": (3, 3)}
        require_arrays(arrays, shapes)
        parameters, covariance = np.zeros(len(TERMS)), np.zeros((len(TERMS), len(TERMS)))
        parameters[order], covariance[np.ix_(order, order)] = arrays[values], arrays["covariance"]
        vehicle = _read_vehicle(arrays)
        if np.any(np.diag(covariance) < 0.0):
            raise ModelError("covariance: a negative variance")
        for name in ("mass", "reference_thrust", "disc"):
            if not vehicle[name][0] > 0.0:
                raise ModelError(f"vehicle: {name} must be positive, is {vehicle[name][0]:g}")
        control_signs(vehicle)
        inertia = arrays["inertia"]
        if not np.allclose(inertia, inertia.T) or np.any(np.linalg.eigvalsh(inertia) <= 0.0):
            raise ModelError("inertia: not that of a body")
        return cls(parameters, covariance, vehicle, inertia)


def _stored_vehicle(vehicle: Records) -> Array:
    """Mass, reference thrust, disc, places and spins of a PHYSICAL_VEHICLE (1,): (3 + 4 rotors,)."""
    numbers = [vehicle[name].ravel() for name in ("mass", "reference_thrust", "disc", "positions", "spins")]
    return np.concatenate(numbers)


def _read_vehicle(arrays: Mapping[str, Array]) -> Records:
    """What :func:`_stored_vehicle` gave."""
    count = (np.size(arrays.get("vehicle", ())) - 3) // 4
    if not 1 <= count <= ROTORS_MAX:
        count = 4
    require_arrays(arrays, {"vehicle": (3 + 4 * count,)})
    numbers, vehicle = arrays["vehicle"], np.zeros(1, record_dtype(PhysicalVehicle, count))
    vehicle["mass"], vehicle["reference_thrust"], vehicle["disc"] = numbers[:3]
    vehicle["rotors"], vehicle["spins"] = count, numbers[3 + 3 * count :]
    vehicle["positions"] = numbers[3 : 3 + 3 * count].reshape(count, 3)
    return vehicle


def require_known(names: Sequence[str]) -> None:
    """Refuse names that are not of parameters.

    Raises:
        ModelError: naming the first of them.
    """
    if unknown := [name for name in names if name not in TERM_INDEX]:
        raise ModelError(f"parameter {unknown[0]!r} is not known to this version")


def require_arrays(arrays: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse arrays of other shapes, or that are not finite.

    Raises:
        ModelError: naming the first of them.
    """
    for name, wanted in shapes.items():
        if name not in arrays:
            raise ModelError(f"{name} is missing")
        if arrays[name].shape != wanted or not np.all(np.isfinite(arrays[name])):
            raise ModelError(f"{name} of shape {arrays[name].shape}, expected finite numbers {wanted}")


# Samples that are predicted [Hz], about: signals have passed a low-pass at 30 Hz.
_RATE_HZ = 100.0
# A rotor below this share of its median speed over a flight was not measured: a sensor that drops out reads
# zero, and no flight of the data sets lets a rotor below 0.3.
_MISSING_SHARE = 0.2
# Samples [s] before a start whose residual is not used: the low-pass of all signals works in both directions,
# and its impulse response at 30 Hz has died out after this.
LEAD_S = 0.02
# Places of a rotor [m] that are the same: of one file, however it was written.
_SAME_PLACE_M = 1e-6
# Parameters of sensors move no body: place, bias and inclination of the accelerometer.
_SENSORS = ("imu_", "bias_x", "bias_y", "bias_z", "incline_")
MOVES = np.array([not name.startswith(_SENSORS) for name in TERM_NAMES])


@dataclass(frozen=True)
class RolloutFlight:
    """A flight to be predicted, on an even time grid of about 100 Hz.

    Attributes:
        name: of the flight.
        time: (N,) s.
        attitude: (N, 4) body to world; of flights that training gave, heading counts from their start.
        motion: MOTION (N,), rotor speeds not delayed.
        wrench: (N, 6) measured, N and Nm.
        position: (N, 3) m in the world, measured, relative to the air where there is wind; None where it is
            not measured, or not kept.
    """

    name: str
    time: Array
    attitude: Array
    motion: Records
    wrench: Array
    position: Array | None = None

    @classmethod
    def from_flight(cls, flight: Flight, vehicle: Vehicle) -> RolloutFlight:
        """Of a flight that passed its low-pass, thinned to about 100 Hz."""
        motion = np.zeros(len(flight), record_dtype(MotionSample, vehicle.rotor_count))
        motion["velocity"] = relative_to_air(flight.velocity, flight.attitude, flight.wind)
        motion["rates"] = flight.rates
        motion["angular_acceleration"] = flight.angular_acceleration
        motion["rotor_speeds"] = flight.rotor_speeds
        motion["rotor_accelerations"] = np.gradient(flight.rotor_speeds, flight.time, axis=0)
        steps = 0.5 * np.diff(flight.time)[:, np.newaxis] * (flight.wind[1:] + flight.wind[:-1])
        drift = np.concatenate((np.zeros((1, 3)), np.cumsum(steps, axis=0)))
        every = slice(None, None, max(1, round(flight.rate_hz / _RATE_HZ)))
        return cls(
            flight.name,
            flight.time[every],
            flight.attitude[every],
            motion[every],
            measured_wrench(flight, vehicle)[every],
            (flight.position - drift)[every] if flight.position_measured else None,
        )

    @property
    def step(self) -> float:
        """Seconds between samples."""
        return float(np.median(np.diff(self.time)))

    def delayed(self, delay_s: float) -> RolloutFlight:
        """The flight with rotor speeds as they were so much earlier."""
        if delay_s == 0.0:
            return self
        # Slow to import, and no model in flight needs it.
        from scipy.interpolate import CubicSpline

        motion, earlier = self.motion.copy(), np.clip(self.time - delay_s, self.time[0], None)
        for name in ("rotor_speeds", "rotor_accelerations"):
            motion[name] = CubicSpline(self.time, self.motion[name], axis=0)(earlier)
        return replace(self, motion=motion)

    def starts(self, last: int, every: int) -> npt.NDArray[np.int64]:
        """Every k-th sample, from which on rotor speeds were measured for `last` samples without a hole."""
        starts = np.arange(0, len(self.time) - last, every, dtype=np.int64)
        holes = hole_ends(self.time)
        whole = np.searchsorted(holes, starts, "right") == np.searchsorted(holes, starts + last, "right")
        speeds = self.motion["rotor_speeds"]
        missing = np.any(speeds < _MISSING_SHARE * np.median(speeds, axis=0), axis=1)
        count = np.concatenate(([0], np.cumsum(missing)))
        return starts[whole & (count[starts + last + 1] == count[starts])]


def horizon_steps(horizons_s: Sequence[float], step_s: float) -> npt.NDArray[np.int64]:
    """Samples (H,) nearest to horizons, one at least."""
    return np.maximum(1, np.rint(np.array(horizons_s) / step_s)).astype(np.int64)


class FlightRollouts(NamedTuple):
    """Roll-outs of a flight from W starts.

    Attributes:
        starts: (W,) samples.
        errors: (W, H, 12) predicted less measured.
        covariance: (W, H, 12, 12) of the errors, by the physics.
        path: MOVING (W, S + 1).
    """

    starts: npt.NDArray[np.int64]
    errors: Array
    covariance: Array
    path: Records


@dataclass(frozen=True)
class RolloutModel:
    """What a model folder keeps to predict ahead.

    Attributes:
        parameters: (P,) of the physical model, SI.
        covariance: (P, P) of them.
        vehicle: PHYSICAL_VEHICLE (1,).
        inertia: (3, 3) kg m².
        gravity: m/s².
        rotor_delay_s: that rotor speeds act after they were measured.
        disturbance: what the model lacks.
        measured_variance: (12,) of a measured state.
        calibration: of the tubes; None before it is made.
        lead_s: before a start whose residuals are not used.
        remark: on where the parameters come from.
    """

    parameters: Array
    covariance: Array
    vehicle: Records
    inertia: Array
    gravity: float
    rotor_delay_s: float
    disturbance: Disturbance
    measured_variance: Array
    calibration: TubeCalibration | None = None
    lead_s: float = LEAD_S
    remark: str = ""

    def require_rotors(self, vehicle: Vehicle) -> None:
        """Refuse a vehicle whose rotors are at other places than those that the model was fitted with.

        Raises:
            ModelError: naming the first rotor that is, or the numbers of rotors where they differ.
        """
        own, count = int(self.vehicle["rotors"][0]), vehicle.rotor_count
        if own != count:
            raise ModelError(
                f"was identified with {own} rotors, vehicle {vehicle.name} has {count}; identify it again"
            )
        apart = np.linalg.norm(self.vehicle["positions"][0] - vehicle.rotor_positions, axis=1)
        if np.any(elsewhere := apart > _SAME_PLACE_M):
            rotor = int(np.argmax(elsewhere))
            raise ModelError(
                f"was identified with rotor {rotor + 1} {apart[rotor] * 1e3:.3g} mm from where vehicle file "
                f"{vehicle.name} has it now; identify it again"
            )

    def track(self, flight: RolloutFlight) -> Track:
        """A flight as roll-outs need it."""
        return Track(
            flight.step,
            flight.delayed(self.rotor_delay_s).motion,
            np.ascontiguousarray(flight.attitude),
            self.vehicle,
            float(self.vehicle["mass"][0]),
            self.gravity,
            self.inertia,
            np.asarray(np.linalg.inv(self.inertia), dtype=float),
        )

    def lead(self, step_s: float) -> int:
        """Samples before a start whose residuals are not used."""
        return max(1, round(self.lead_s / step_s))

    def residuals(self, flight: RolloutFlight) -> Array:
        """Measured less predicted wrench (N, 6)."""
        motion = flight.delayed(self.rotor_delay_s).motion
        return flight.wrench - wrenches(motion, self.vehicle, self.parameters)

    def predicted(
        self, flight: RolloutFlight, starts: npt.NDArray[np.int64], horizons: npt.NDArray[np.int64]
    ) -> Rolled:
        """Predict ahead from samples of a flight, without tubes; see :meth:`roll`."""
        lead, process = self.lead(flight.step), replace(self.disturbance, step_s=flight.step)
        known = process.filtered(self.residuals(flight))[np.maximum(starts - lead, 0)] * process.decay**lead
        disturbances = Disturbances(known, np.zeros((0, 0, 0)), process.decay)
        track = self.track(flight)
        return roll_out(track, starts, horizons, self.moving, derivatives=False, disturbances=disturbances)

    def roll(
        self, flight: RolloutFlight, starts: npt.NDArray[np.int64], horizons: npt.NDArray[np.int64]
    ) -> FlightRollouts:
        """Predict ahead from samples of a flight, with tubes.

        Errors of position are against the measured one, of a flight without it against integrated velocity.

        Args:
            flight: on an even time grid.
            starts: (W,) samples; the last horizon after each lies within the flight.
            horizons: (H,) samples after the start, rising.
        """
        rolled, process = (
            self.predicted(flight, starts, horizons),
            replace(self.disturbance, step_s=flight.step),
        )
        aged = process.decay ** (2 * self.lead(flight.step))
        stationary = np.square([axis.deviation for axis in process.axes])
        uncertainty = Uncertainty(
            self.measured_variance,
            aged * process.filtered_variance + (1.0 - aged) * stationary,
            process.drive,
            process.decay,
            np.where(np.outer(MOVES, MOVES), self.covariance, 0.0),
        )
        track, errors = self.track(flight), rolled.errors.copy()
        covariance = error_covariance(track, starts, horizons, rolled.path, self.moving, uncertainty)
        if flight.position is not None:
            for k, steps in enumerate(horizons):
                moved = flight.position[starts + steps] - flight.position[starts]
                errors[:, k, POSITION] = rolled.path["displacement"][:, steps] - moved
        return FlightRollouts(starts, errors, covariance, rolled.path)

    @property
    def moving(self) -> Array:
        """The parameters (P,) but for those of sensors, which are zero."""
        return np.where(MOVES, self.parameters, 0.0)

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        body = StoredBody(self.parameters, self.covariance, self.vehicle, self.inertia)
        calibration = {} if self.calibration is None else self.calibration.arrays()
        return {**body.arrays("parameters"), "measured_variance": self.measured_variance, **calibration}

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        return asdict(
            _Entry(tuple(TERM_NAMES), self.gravity, self.rotor_delay_s, self.disturbance, self.remark)
        )

    @classmethod
    def stored(cls, data: Any, arrays: Mapping[str, Array]) -> RolloutModel:
        """Read what `to_json` and `arrays` gave.

        Raises:
            ModelError: for numbers that no fit gives, and parameters that this version does not know.
        """
        entry = parse_config(_Entry, data, "roll-outs", ModelError)
        with named_in("roll-outs"):
            body = StoredBody.read(entry.parameters, arrays, "parameters")
            require_arrays(arrays, {"measured_variance": (STATES,)})
            if not np.all(arrays["measured_variance"] > 0.0):
                raise ModelError("measured_variance is not positive")
            calibration = TubeCalibration.stored(arrays)
        settings = entry.gravity, entry.rotor_delay_s, entry.disturbance, arrays["measured_variance"]
        return cls(*body, *settings, calibration, remark=entry.remark)


def disturbance_left(models: Sequence[RolloutModel], flights: Sequence[RolloutFlight]) -> Disturbance:
    """Disturbance process of the residuals of flights, each better under a model that did not see it."""
    residuals, step = [m.residuals(f) for m, f in zip(models, flights, strict=True)], flights[0].step
    return Disturbance.of_residuals(residuals, step, models[0].lead(step))


@dataclass(frozen=True)
class _Entry:
    """What a stored model keeps beside the arrays."""

    parameters: tuple[Text, ...]
    gravity: Positive
    rotor_delay_s: NotNegative
    disturbance: Disturbance
    remark: str = ""
