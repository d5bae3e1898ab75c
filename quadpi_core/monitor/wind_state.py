# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""Wind as a state of the monitor: told by drag, where no topic tells it and the model's flights did so.

The specific force along body x and y is drag over mass, with a bias: f = −k (Rᵀ(v − w)) + b. A Kalman filter
of the wind w to north and east and of b takes the means of each fifth of a second; w walks as the wind of
:mod:`quadpi_core.field.drag` does. What is filtered is scalar arithmetic, so that live and replay give
the same bits.
"""

from __future__ import annotations

import math

import numpy as np

from quadpi_core.flight import Stamps
from quadpi_core.frames import Array, rotation_matrix
from quadpi_core.models.aerodynamic import AerodynamicModel
from quadpi_core.models.interval_rules import SETTLED, WindDrag
from quadpi_core.monitor.alarm_kernel import LIFTED
from quadpi_core.monitor.pairing import PairedSamples
from quadpi_core.monitor.preparation import CONDITIONS
from quadpi_core.monitor.unsure_states import UnsureStates
from quadpi_core.records import (
    AIRSPEED_MAX_M_S,
    CONVENTION,
    QUATERNION_NORM_TOLERANCE,
    RATE_MAX_RAD_S,
    SPECIFIC_FORCE_MAX_M_S2,
    Records,
    Threshold,
)
from quadpi_core.vehicle import Vehicle

TOLD = Threshold(
    "standard deviation of the wind, over that in a model's flights, up to which forces are judged",
    2.0,
    "",
    "beyond, at the start of a flight, they are predicted, with intervals that are several times as wide",
    CONVENTION,
)
FORGOTTEN_S = Threshold(
    "time without a sample after which the wind of before is forgotten",
    600.0,
    "s",
    "it turns in that time; stamps that jump by so much, or back, for less than two steps are no time",
    CONVENTION,
)
_STATES = range(4)


class WindState:
    """Estimates the wind of a flight from paired samples, as they come.

    Args:
        drag: of the model.
        hover_rotor_speed: of the model, rad/s: slower rotors do not carry the vehicle, and the ground's force
            is no drag; 0 where it is not known.

    Attributes:
        drag: as given.
        is_measured: whether a topic tells the wind, which then counts.
    """

    def __init__(self, drag: WindDrag, hover_rotor_speed: float) -> None:
        # Slow to import, and most models have no wind to find.
        from quadpi_core.field.drag import BIAS, STEP_S, WALK

        self.drag, self._step_ns = drag, round(1e9 * STEP_S)
        self._forgotten = round(FORGOTTEN_S.value / STEP_S)
        self._bias, self._walked = BIAS * BIAS, WALK * WALK * STEP_S
        self._carrying = LIFTED.value * hover_rotor_speed * hover_rotor_speed
        self.reset()

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self.is_measured = False
        self._forget()

    def _forget(self) -> None:
        """Forget the wind."""
        self._step: int | None = None
        # The step of samples whose stamps have just jumped from there; None without.
        self._aside: int | None = None
        # Sums of a step: specific force and velocity along x and y, both rows of the rotation, count.
        self._sums = np.zeros(9)
        self._state = [0.0] * 4
        variances = (self.drag.wind_m_s**2, self.drag.wind_m_s**2, self._bias, self._bias)
        self._covariance = [[variances[i] if i == j else 0.0 for j in _STATES] for i in _STATES]

    @property
    def deviation(self) -> float:
        """Standard deviation of the wind, m/s: root mean square of north and east."""
        return math.sqrt(0.5 * (self._covariance[0][0] + self._covariance[1][1]))

    def take(self, samples: PairedSamples) -> tuple[PairedSamples, Array]:
        """Samples (K) with the wind that was known before each, and its deviation (K,) m/s.

        Blocks of any length have the same effect.
        """
        deviation = np.zeros(len(samples.time_ns))
        measured = np.flatnonzero(np.any(samples.wind != 0.0, axis=1))
        # A topic counts from its first sample on, wherever in a block that is.
        before = 0 if self.is_measured else int(measured[0]) if len(measured) else len(deviation)
        self.is_measured = self.is_measured or len(measured) > 0
        if before == 0:
            return samples, deviation
        values = samples.values.copy()
        wind = values[:, -3:]
        steps = samples.time_ns[:before] // self._step_ns
        rows = self._rows(PairedSamples(samples.time_ns[:before], samples.values[:before]))
        begins = np.flatnonzero(np.diff(steps, prepend=steps[0] - 1))
        for begin, end in zip(begins, [*begins[1:], before], strict=True):
            counts = self._go_to(int(steps[begin]))
            wind[begin:end, :2] = self._state[:2]
            deviation[begin:end] = self.deviation
            if counts:
                # Sample by sample, so that no length of blocks shows in the digits.
                self._sums = np.add.accumulate(np.vstack([self._sums, rows[begin:end]]))[-1]
        return PairedSamples(samples.time_ns, values), deviation

    def _rows(self, samples: PairedSamples) -> Array:
        """What each sample (K, 9) adds to the sums of its step: nothing where it is not usable."""
        with np.errstate(invalid="ignore", over="ignore"):
            turn = rotation_matrix(samples.attitude)
            rows = np.column_stack(
                (
                    samples.specific_force[:, :2],
                    samples.velocity[:, :2],
                    *(turn[:, world, body] for body in (0, 1) for world in (0, 1)),
                    np.ones(len(turn)),
                )
            )
            squares = np.square(samples.rotor_speeds)
            load = np.add.accumulate(squares, axis=1)[:, -1]
            usable = np.isfinite(rows).all(axis=1) & (load >= self._carrying * squares.shape[1])
            # A sample that data quality refuses.
            usable &= np.abs(np.linalg.norm(samples.attitude, axis=1) - 1.0) <= QUATERNION_NORM_TOLERANCE
            for values, largest in (
                (samples.specific_force, SPECIFIC_FORCE_MAX_M_S2),
                (samples.velocity, AIRSPEED_MAX_M_S),
                (samples.rates, RATE_MAX_RAD_S),
            ):
                usable &= (np.abs(values) <= largest).all(axis=1)
        return np.where(usable[:, np.newaxis], rows, 0.0)

    def _go_to(self, step: int) -> bool:
        """Go on to the step of the next samples; whether they count, as their stamps have not just jumped."""
        if self._step is None:
            self._step = step
        elapsed = step - self._step
        if not 0 <= elapsed < self._forgotten:
            if self._aside is None or not 0 < step - self._aside < self._forgotten:
                self._aside = step
                return False
            self._forget()
            self._step, elapsed = step, 0
        self._aside = None
        if elapsed:
            self._close(elapsed)
            self._step = step
        return True

    def _close(self, elapsed: int) -> None:
        """Take the means of the step that ends, and let the wind walk for as many steps as have passed."""
        *sums, count = self._sums.tolist()
        self._sums = np.zeros(9)
        if count > 0.0:
            force, velocity, turn = (
                [one / count for one in sums[begin:end]] for begin, end in ((0, 2), (2, 4), (4, 8))
            )
            drag = self.drag
            for axis, (gain, noise) in enumerate(
                ((drag.per_mass_x_1_s, drag.noise_x_m_s2), (drag.per_mass_y_1_s, drag.noise_y_m_s2))
            ):
                slope = [gain * turn[2 * axis], gain * turn[2 * axis + 1], 0.0, 0.0]
                slope[2 + axis] = 1.0
                self._correct(slope, force[axis] + gain * velocity[axis], noise * noise)
        for axis in range(2):
            self._covariance[axis][axis] += self._walked * elapsed

    def _correct(self, slope: list[float], measured: float, variance: float) -> None:
        """A scalar measurement, linear in the state."""
        p = self._covariance
        across = [_dot(row, slope) for row in p]
        total = variance + _dot(slope, across)
        off = measured - _dot(slope, self._state)
        self._state = [self._state[i] + across[i] * off / total for i in _STATES]
        self._covariance = [[p[i][j] - across[i] * across[j] / total for j in _STATES] for i in _STATES]

    def conditions(self, attitude: Array, deviation: Array, others: Records | None) -> Records | None:
        """The conditions (K,) of samples with what the model's intervals do not hold of the wind's errors.

        Args:
            attitude: (K, 4) of the samples.
            deviation: (K,) of the wind, m/s, see :meth:`take`.
            others: conditions of the state, to which this is added; None where there are none.
        """
        known = self.drag.known_m_s
        beyond = np.maximum(np.square(deviation) - known * known, 0.0)
        if not beyond.any():
            return others
        found = np.zeros(len(deviation), CONDITIONS) if others is None else others
        found["wind_unknown"] = deviation > TOLD.value * known
        # Horizontal, in body axes; an attitude that is none is of a sample that is not used.
        with np.errstate(invalid="ignore", over="ignore"):
            down = np.clip(np.nan_to_num(rotation_matrix(attitude)[:, 2]), -1.0, 1.0)
        for row in range(3):
            for column in range(3):
                level = (row == column) - down[:, row] * down[:, column]
                found["covariance"][:, row, column] += beyond * level
        return found


def _dot(left: list[float], right: list[float]) -> float:
    """Of four numbers, added one after the other: `sum` does it otherwise in newer versions of Python."""
    return left[0] * right[0] + left[1] * right[1] + left[2] * right[2] + left[3] * right[3]


class SampleContext:
    """What a model is told beside its samples: the wind that drag tells, and how sure state and wind are.

    Args:
        model: None for none.
        vehicle: that flies; in halls, where its wind is 0, none is sought.
        wind_since_ns: stamp after which the flight is known to be as those that tell a model the wind (see
            :mod:`quadpi_core.estimator.slow_states`), or None.

    Attributes:
        unsure: takes how sure the states are.
        wind: as drag tells it; None for a model whose flights did not.
        wind_since_ns: as given.
    """

    def __init__(
        self, model: AerodynamicModel | None, vehicle: Vehicle | None, wind_since_ns: int | None = None
    ) -> None:
        self.unsure = UnsureStates(SETTLED if model is None else model.state)
        self.wind: WindState | None = None
        self.wind_since_ns = wind_since_ns
        # Whether a sample was later: then all to come count, also after a clock that is set back.
        self._seeks = False
        in_the_open = vehicle is not None and vehicle.noise.wind_m_s != 0.0
        if model is not None and model.wind is not None and in_the_open:
            self.wind = WindState(model.wind, model.alarm_limits.hover_rotor_speed)

    def reset(self) -> None:
        """Forget the past."""
        self.unsure.reset()
        if self.wind is not None:
            self.wind.reset()

    def go_on_from(self, before: SampleContext) -> None:
        """Keep the wind of a model whose place is taken, where it is told by the same drag."""
        self._seeks = before._seeks
        if self.wind is not None and before.wind is not None and self.wind.drag == before.wind.drag:
            self.wind = before.wind

    @property
    def is_needed(self) -> bool:
        """Whether samples go through here: a wind is to be told, or a state was less sure than known."""
        seeks = self.wind is not None and self.wind_since_ns is not None and not self.wind.is_measured
        return self.unsure.is_beyond or seeks

    def of(self, samples: PairedSamples) -> tuple[Stamps, Array, Records | None]:
        """Stamps (K,), channels and conditions of samples; None where state and wind are sure enough."""
        conditions = self.unsure.conditions(samples.time_ns)
        if self.wind is None or self.wind_since_ns is None:
            return *samples, conditions
        late = samples.time_ns > self.wind_since_ns
        first = 0 if self._seeks else int(np.argmax(late)) if late.any() else len(late)
        self._seeks |= first < len(late)
        told, unsure = self.wind.take(PairedSamples(samples.time_ns[first:], samples.values[first:]))
        samples = PairedSamples(samples.time_ns, np.vstack([samples.values[:first], told.values]))
        deviation = np.append(np.zeros(first), unsure)
        return *samples, self.wind.conditions(samples.attitude, deviation, conditions)
