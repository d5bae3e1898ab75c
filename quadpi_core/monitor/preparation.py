# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From paired samples to filtered inputs and the measured wrench: what models of one cut-off share."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.brief_repr import brief_repr
from quadpi_core.compiled import njit
from quadpi_core.estimator.imu_rate import RATE_BEFORE_HZ, ImuRate
from quadpi_core.flight import AXES, MAX_GAP_NS, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import (
    DERIVATIVES,
    INPUT_NAMES,
    inputs_kernel,
    relative_to_air,
    vehicle_constants,
)
from quadpi_core.monitor.data_quality import (
    NOT_FINITE,
    NOT_PLAUSIBLE,
    RATE_DIFFERS,
    RATE_LOW,
    RATE_UNKNOWN,
    STAMP_BACKWARD,
    STAMP_REPEATED,
    STATE_MISSING,
    Quality,
    frozen_s,
    judge,
    quality,
    with_last_readings,
)
from quadpi_core.records import Records, Vector3, record_dtype
from quadpi_core.rotations import matrix
from quadpi_core.signals.chain import (
    ATTITUDE,
    CHANNELS,
    RATES,
    ROTOR_SPEEDS,
    SPECIFIC_FORCE,
    VELOCITY,
    WIND,
    ChainMemory,
    filter_sample,
    forget,
)
from quadpi_core.signals.filters import SETTLING_PERIODS, LowPass, design_low_pass
from quadpi_core.signals.wrench import newton_euler
from quadpi_core.vehicle import ROTORS, Vehicle

# When a state begins or comes back, its accelerometer bias is still being found: measured forces then leave
# their intervals up to ten times as often (experiments/results/alarm.md).
SETTLE_NS = 1_000_000_000
# Faults of samples that say nothing of the state.
_WITHOUT_STATE = NOT_FINITE | NOT_PLAUSIBLE | STAMP_REPEATED | STAMP_BACKWARD | STATE_MISSING


class Verdict:
    """What data quality and low-pass say of one sample.

    What follows `absent` means something for a sample that is usable, or but for absent rotors; the signals
    have passed the low-pass. A sample has not settled in the first :data:`SETTLE_NS` of a state, or after
    more than `MAX_GAP_NS` without one, nor before the low-pass has settled. Where rotor speeds alone are
    missing, the state goes on.
    """

    time_ns: int
    faults: int  # bits of what is wrong, see :mod:`quadpi_core.monitor.data_quality`
    usable: bool
    # Bit per rotor without a reading, in a sample that is usable but for these: the last ones hold.
    absent: int
    wrench: Annotated[Array, len(AXES)]  # measured, of such a sample alone: that of others is with `Prepared`
    settled: bool
    velocity: Vector3  # over ground, m/s, world axes
    rates: Vector3  # rad/s
    specific_force: Vector3  # m/s², body axes
    rotor_speeds: Annotated[Array, ROTORS]  # rad/s


class _VehicleConstants:
    """Numbers of a vehicle for inputs and wrench; see :func:`quadpi_core.inputs.vehicle_constants`."""

    control_signs: Annotated[Array, 3, ROTORS]
    rotor_radius: float
    hover_induced_velocity: float
    mass: float
    inertia: Annotated[Array, 3, 3]


class Memory:
    """All that the preparation knows and remembers."""

    vehicle: _VehicleConstants
    low_pass: LowPass  # of rate 0 while no rate of the IMU is known that fits: no sample is usable
    fault_without_rate: int  # bits of the fault of a sample that has no low-pass
    quality: Quality
    chain: ChainMemory
    settling_ns: int  # of the low-pass
    filtered_ns: int  # stamp of the first sample since the low-pass began
    begun_ns: int  # that of the first one since the state began
    state_ns: int  # that of the last one with a state


# What the rows of the other arrays go by, in the words of a refusal.
_USABLE = "usable verdicts"

VERDICT, MEMORY = record_dtype(Verdict), record_dtype(Memory)


class Prepared(NamedTuple):
    """K samples, U of them usable.

    Attributes:
        verdicts: (K,) a :class:`Verdict` of each.
        inputs: (U, 19) input vectors of the usable samples.
        measured: (U, 6) their measured wrench, N and Nm, body axes.
        usable_ns: (U,) their stamps.
        derivatives: (U,) what their motion has beside the input vectors, see `inputs.Derivatives`.
    """

    verdicts: Records
    inputs: Array
    measured: Array
    usable_ns: Stamps
    derivatives: Records

    def __repr__(self) -> str:
        return brief_repr(self)

    def checked(self) -> Prepared:
        """The same, from whoever made it: arrays that fit each other, as compiled code takes them.

        Raises:
            ArgumentError: naming the array that does not.
        """
        verdicts = array_checks.records("verdicts", self.verdicts, VERDICT, finite=False)
        usable = int(np.count_nonzero(verdicts["usable"]))
        return Prepared(
            verdicts,
            array_checks.floats("inputs", self.inputs, len(INPUT_NAMES), rows=usable, of=_USABLE),
            array_checks.floats("measured", self.measured, len(AXES), rows=usable, of=_USABLE),
            array_checks.stamps("usable_ns", self.usable_ns, rows=usable, of=_USABLE),
            array_checks.records("derivatives", self.derivatives, DERIVATIVES, rows=usable, of=_USABLE),
        )

    @property
    def usable(self) -> npt.NDArray[np.bool_]:
        """(K,) which samples are usable."""
        usable: npt.NDArray[np.bool_] = self.verdicts["usable"]
        return usable

    @property
    def settled(self) -> npt.NDArray[np.bool_]:
        """(U,) which usable samples have settled."""
        settled: npt.NDArray[np.bool_] = self.verdicts["settled"][self.usable]
        return settled

    def where(self, chosen: npt.NDArray[np.bool_]) -> Prepared:
        """The same with only those of the usable samples (U,) left that a mask chooses."""
        verdicts = self.verdicts.copy()
        verdicts["usable"][self.usable] = chosen
        return Prepared(
            verdicts,
            self.inputs[chosen],
            self.measured[chosen],
            self.usable_ns[chosen],
            self.derivatives[chosen],
        )


class Preparation:
    """Judges and filters the samples of one vehicle; memory and time per sample are constant.

    Args:
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU; None if :meth:`retune` will give it.
        cutoff_hz: of the low-pass.

    Raises:
        SignalError: if the sample rate is too low for the cut-off.
    """

    def __init__(self, vehicle: Vehicle, rate_hz: float | None, cutoff_hz: float) -> None:
        self._vehicle = vehicle
        self._cutoff_hz = cutoff_hz
        self._rate: ImuRate | None = None
        self._quality_hz = rate_hz or RATE_BEFORE_HZ
        self._memory = np.zeros(1, MEMORY)
        constants = self._memory["vehicle"]
        for name, value in zip(
            ("control_signs", "rotor_radius", "hover_induced_velocity", "mass", "inertia"),
            (*vehicle_constants(vehicle), vehicle.mass_kg, vehicle.inertia),
            strict=True,
        ):
            constants[name] = value
        self._memory["settling_ns"] = min(SETTLE_NS, round(1e9 * SETTLING_PERIODS / cutoff_hz))
        self.retune(ImuRate(rate_hz or 0.0))
        self.reset()

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self._memory["quality"] = quality(self._vehicle, self._quality_hz)
        self._memory["chain"] = 0

    def retune(self, rate: ImuRate) -> None:
        """Go on with samples of another rate, with an empty low-pass. Without one, no sample is usable.

        Raises:
            SignalError: if the rate is too low for the cut-off; then no sample is usable either.
        """
        if rate == self._rate:
            return
        self._rate = rate
        memory = self._memory
        memory["chain"] = 0
        memory["low_pass"]["rate_hz"] = 0.0
        memory["fault_without_rate"] = RATE_DIFFERS if rate.differs else RATE_UNKNOWN
        if rate.filter_hz > 0.0:
            memory["fault_without_rate"] = RATE_LOW
            memory["low_pass"] = design_low_pass(self._cutoff_hz, rate.filter_hz)
            self._quality_hz = rate.filter_hz
            memory["quality"]["frozen_after_s"] = frozen_s(rate.filter_hz)

    def step(self, time_ns: Stamps, values: Array) -> Prepared:
        """Take K samples; see :meth:`quadpi_core.monitor.Monitor.step`."""
        count = len(time_ns)
        verdicts = np.zeros(count, VERDICT)
        inputs, measured = np.empty((count, len(INPUT_NAMES))), np.empty((count, len(AXES)))
        derivatives = np.empty(count, DERIVATIVES)
        used = _prepare(self._memory, time_ns, values, verdicts, inputs, measured, derivatives)
        if used == count:
            return Prepared(verdicts, inputs, measured, time_ns, derivatives)
        usable_ns = time_ns[verdicts["usable"]]
        return Prepared(verdicts, inputs[:used], measured[:used], usable_ns, derivatives[:used])


@njit(cache=True)
def _prepare(
    memories: Records,
    time_ns: Stamps,
    values: Array,
    verdicts: Records,
    inputs: Array,
    measured: Array,
    derivatives: Records,
) -> int:
    """Fill the verdicts of K samples (K, 20), and what the usable ones give; returns their number.

    Args:
        memories: (1,) the :class:`Memory`, which changes.
        time_ns: (K,) stamps.
        values: (K, 20) channels of :mod:`quadpi_core.signals.chain`.
        verdicts: (K,) to fill with a :class:`Verdict` each.
        inputs: (K, 19) to fill.
        measured: (K, 6) to fill.
        derivatives: (K,) to fill.
    """
    memory = memories[0]
    vehicle, chain = memory.vehicle, memory.chain
    used = 0
    value, slope, curvature = np.empty((1, CHANNELS)), np.empty((1, CHANNELS)), np.empty(ROTORS)
    for i in range(values.shape[0]):
        row = values[i]
        faults, usable, jump = judge(memory.quality, time_ns[i], row)
        if usable and memory.low_pass.rate_hz == 0.0:
            faults |= memory.fault_without_rate
            usable = False
        absent = 0
        if not usable and chain.started:
            absent, row = with_last_readings(memory.quality, time_ns[i], row)
        if usable or absent != 0 or faults & _WITHOUT_STATE == 0:
            if not 0 < time_ns[i] - memory.state_ns <= MAX_GAP_NS:
                memory.begun_ns = time_ns[i]
            memory.state_ns = time_ns[i]
        verdict = verdicts[i]
        verdict.time_ns, verdict.faults, verdict.usable = time_ns[i], faults, usable
        verdict.absent = absent
        if not usable and absent == 0:
            continue
        if not chain.started:
            memory.begun_ns = time_ns[i]
        if usable and jump:
            forget(chain)
        if not chain.started:
            memory.filtered_ns = time_ns[i]
        verdict.settled = (
            time_ns[i] - memory.begun_ns >= SETTLE_NS
            and time_ns[i] - memory.filtered_ns >= memory.settling_ns
        )
        filter_sample(memory.low_pass, chain, row, value[0], slope[0], curvature)
        turn, velocity = matrix(value[0, ATTITUDE]), value[0, VELOCITY]
        for k in range(3):
            verdict.velocity[k] = (
                turn[k, 0] * velocity[0] + turn[k, 1] * velocity[1] + turn[k, 2] * velocity[2]
            )
        verdict.rates[:] = value[0, RATES]
        verdict.specific_force[:] = value[0, SPECIFIC_FORCE]
        verdict.rotor_speeds[:] = value[0, ROTOR_SPEEDS]
        attitude, rates, own = value[:, ATTITUDE], value[:, RATES], slice(used, used + 1)
        measured[own] = newton_euler(
            value[:, SPECIFIC_FORCE], rates, slope[:, RATES], vehicle.mass, vehicle.inertia
        )
        if not usable:
            verdict.wrench[:] = measured[used]
            continue
        inputs_kernel(
            relative_to_air(value[:, VELOCITY], attitude, value[:, WIND]),
            attitude,
            rates,
            value[:, ROTOR_SPEEDS],
            vehicle.control_signs,
            vehicle.rotor_radius,
            vehicle.hover_induced_velocity,
            inputs[own],
        )
        derivatives[used].angular_acceleration[:] = slope[0, RATES]
        derivatives[used].rotor_accelerations[:] = slope[0, ROTOR_SPEEDS]
        derivatives[used].rotor_jerks[:] = curvature
        # A sample one of whose numbers overflows is not usable.
        verdict.usable = bool(np.isfinite(inputs[used].sum() + measured[used].sum()))
        used += verdict.usable
    return used
