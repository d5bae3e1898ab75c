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
from quadpi_core.frames import Array
from quadpi_core.models.disturbance import Disturbance
from quadpi_core.models.physical_regressors import wrenches
from quadpi_core.models.physical_rollout import (
    POSITION,
    RIGID_BODY,
    STATES,
    Disturbances,
    Rolled,
    Track,
    roll_out,
)
from quadpi_core.models.physical_terms import TERM_NAMES
from quadpi_core.models.rollout_covariance import Uncertainty, error_covariance
from quadpi_core.models.rollout_flight import RolloutFlight
from quadpi_core.models.stored_body import StoredBody, require_arrays
from quadpi_core.models.tubes import TubeCalibration
from quadpi_core.records import Records
from quadpi_core.vehicle import Vehicle

# Samples [s] before a start whose residual is not used: the low-pass of all signals works in both directions,
# and its impulse response at 30 Hz has died out after this.
LEAD_S = 0.02
# Places of a rotor [m] that are the same: of one file, however it was written.
_SAME_PLACE_M = 1e-6
# Parameters of sensors move no body: place, bias and inclination of the accelerometer.
_SENSORS = ("imu_", "bias_x", "bias_y", "bias_z", "incline_")
MOVES = np.array([not name.startswith(_SENSORS) for name in TERM_NAMES])


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
            ModelError: naming the first rotor that is.
        """
        apart = np.linalg.norm(self.vehicle["positions"][0] - vehicle.rotor_positions, axis=1)
        if np.any(elsewhere := apart > _SAME_PLACE_M):
            rotor = int(np.argmax(elsewhere))
            raise ModelError(
                f"was identified with rotor {rotor + 1} {apart[rotor] * 1e3:.3g} mm from where vehicle file "
                f"{vehicle.name} has it now; identify it again"
            )

    def track(self, flight: RolloutFlight) -> Track:
        """A flight on an even time grid as roll-outs need it."""
        body = np.zeros(1, RIGID_BODY)
        body["mass"], body["gravity"] = self.vehicle["mass"], self.gravity
        body["inertia"], body["inverse_inertia"] = self.inertia, np.linalg.inv(self.inertia)
        return Track(
            flight.step,
            flight.delayed(self.rotor_delay_s).motion,
            np.ascontiguousarray(flight.attitude),
            self.vehicle,
            body,
        )

    def lead(self, step_s: float) -> int:
        """Samples before a start whose residuals are not used."""
        return max(1, round(self.lead_s / step_s))

    def residuals(self, flight: RolloutFlight) -> Array:
        """Measured less predicted wrench (N, 6)."""
        motion = flight.delayed(self.rotor_delay_s).motion
        residuals: Array = flight.wrench - wrenches(motion, self.vehicle, self.parameters)
        return residuals

    def delayed(self, rotor_delay_s: float) -> RolloutModel:
        """The model with rotor speeds that act so much later than they were measured."""
        return replace(self, rotor_delay_s=rotor_delay_s)

    def predicted(
        self, flight: RolloutFlight, starts: npt.NDArray[np.int64], horizons: npt.NDArray[np.int64]
    ) -> Rolled:
        """Predict ahead from samples of a flight, without tubes; see :meth:`roll`."""
        track = self.track(flight)
        lead, process = self.lead(track.step), self._process(track)
        known = process.filtered(self.residuals(flight))[np.maximum(starts - lead, 0)] * process.decay**lead
        return roll_out(
            track,
            starts,
            horizons,
            self.moving,
            derivatives=False,
            disturbances=Disturbances(known, np.zeros((0, 0, 0)), process.decay),
        )

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
        rolled, track = self.predicted(flight, starts, horizons), self.track(flight)
        process = self._process(track)
        aged = process.decay ** (2 * self.lead(track.step))
        stationary = np.square([axis.deviation for axis in process.axes])
        uncertainty = Uncertainty(
            self.measured_variance,
            aged * process.filtered_variance + (1.0 - aged) * stationary,
            process.drive,
            process.decay,
            np.where(np.outer(MOVES, MOVES), self.covariance, 0.0),
        )
        covariance = error_covariance(track, starts, horizons, rolled.path, self.moving, uncertainty)
        errors = rolled.errors.copy()
        if flight.position is not None:
            for k, steps in enumerate(horizons):
                moved = flight.position[starts + steps] - flight.position[starts]
                errors[:, k, POSITION] = rolled.path["displacement"][:, steps] - moved
        return FlightRollouts(starts, errors, covariance, rolled.path)

    @property
    def moving(self) -> Array:
        """The parameters (P,) but for those of sensors, which are zero."""
        return np.where(MOVES, self.parameters, 0.0)

    def _process(self, track: Track) -> Disturbance:
        return replace(self.disturbance, step_s=track.step)

    def arrays(self) -> dict[str, Array]:
        """What a stored model keeps as arrays, by name."""
        body = StoredBody(self.parameters, self.covariance, self.vehicle, self.inertia)
        calibration = {} if self.calibration is None else self.calibration.arrays()
        return {**body.arrays("parameters"), "measured_variance": self.measured_variance, **calibration}

    def to_json(self) -> dict[str, Any]:
        """What a stored model keeps beside the arrays."""
        return {
            "parameters": list(TERM_NAMES),
            "gravity": self.gravity,
            "rotor_delay_s": self.rotor_delay_s,
            "disturbance": asdict(self.disturbance),
            "remark": self.remark,
        }

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
        return cls(
            *body,
            entry.gravity,
            entry.rotor_delay_s,
            entry.disturbance,
            arrays["measured_variance"],
            calibration,
            remark=entry.remark,
        )


def disturbance_left(models: Sequence[RolloutModel], flights: Sequence[RolloutFlight]) -> Disturbance:
    """The process that models leave on flights, best on ones that they did not see."""
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
