# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From paired samples to filtered inputs and the measured wrench: what models of one cut-off share."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.core import compiled
from quadpi_core.estimator.imu_rate import RATE_BEFORE_HZ, ImuRate
from quadpi_core.flight import AXES, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import INPUT_NAMES, Derivatives, VehicleConstants, derivatives_like, vehicle_constants
from quadpi_core.monitor.conditions import STATE_ERRORS
from quadpi_core.monitor.data_quality import (
    RATE_DIFFERS,
    RATE_LOW,
    RATE_UNKNOWN,
    MoreFaults,
    Quality,
    frozen_s,
    quality,
)
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, Vector3, brief_repr, record_dtype
from quadpi_core.signals.chain import SETTLING_PERIODS, ChainMemory, LowPass, channels, design_low_pass
from quadpi_core.vehicle import Vehicle

SETTLE_NS = compiled.SETTLE_NS


class Verdict:
    """What data quality and low-pass say of one sample.

    What follows `absent` means something for a sample that is usable, or but for absent rotors; the signals
    have passed the low-pass. A sample has not settled in the first :data:`SETTLE_NS` of a state, or after
    more than `MAX_GAP_NS` without one, nor before the low-pass has settled. Where rotor speeds alone are
    missing, the state goes on.
    """

    time_ns: int
    faults: int  # bits of what is wrong, see :mod:`quadpi_core.monitor.data_quality`
    more_faults: MoreFaults  # of rotors 5 to 12
    usable: bool
    # Bit per rotor without a reading, in a sample that is usable but for these: the last ones hold.
    absent: int
    wrench: Annotated[Array, len(AXES)]  # measured, of such a sample alone: that of others is with `Prepared`
    settled: bool
    velocity: Vector3  # over ground, m/s, world axes
    rates: Vector3  # rad/s
    specific_force: Vector3  # m/s², body axes
    rotor_speeds: PerRotor  # rad/s
    commanded: int  # bit per rotor whose speed follows from its command, see :mod:`.conditions`
    windy: bool  # whether the wind is still to be told: it then has not settled either


class Memory:
    """All that the preparation knows and remembers."""

    vehicle: VehicleConstants
    low_pass: LowPass  # of rate 0 while no rate of the IMU is known that fits: no sample is usable
    fault_without_rate: int  # bits of the fault of a sample that has no low-pass
    quality: Quality
    chain: ChainMemory
    settling_ns: int  # of the low-pass
    filtered_ns: int  # stamp of the first sample since the low-pass began
    begun_ns: int  # that of the first one since the state began
    state_ns: int  # that of the last one with a state
    density_excess: float  # by what share the air is denser than the vehicle file says


# What the rows of the other arrays go by, in the words of a refusal.
_USABLE = "usable verdicts"

MEMORY = record_dtype(Memory)
# Of four rotors.
VERDICT = record_dtype(Verdict, 4)
# Filtered signals, which the core alone reads, have room for all rotors.
_CHANNELS = channels(ROTORS_MAX)
ERRING_COLUMNS = STATE_ERRORS * 2 * len(INPUT_NAMES)
_NOT_ERRING, _NOT_ASKED = np.empty((0, ERRING_COLUMNS)), np.empty((0, _CHANNELS))


class Prepared(NamedTuple):
    """K samples, U of them usable.

    Attributes:
        verdicts: (K,) a :class:`Verdict` of each.
        inputs: (U, 19) input vectors of the usable samples.
        measured: (U, 6) their measured wrench, N and Nm, body axes.
        usable_ns: (U,) their stamps.
        derivatives: (U,) what their motion has beside the input vectors, see `inputs.Derivatives`.
        erring: (U, 342) their input vectors if the state errs by one standard deviation: for each of nine
            independent errors one way, then the other; (0, 342) where samples came without conditions.
    """

    verdicts: Records
    inputs: Array
    measured: Array
    usable_ns: Stamps
    derivatives: Records
    erring: Array = _NOT_ERRING

    def __repr__(self) -> str:
        return brief_repr(self)

    def checked(self) -> Prepared:
        """The same, from whoever made it: arrays that fit each other, as compiled code takes them.

        Raises:
            ArgumentError: naming the array that does not.
        """
        derivatives = derivatives_like(self.derivatives)
        rotors = derivatives["rotor_speeds"].shape[0]
        verdicts = array_checks.records(
            "verdicts", self.verdicts, record_dtype(Verdict, rotors), finite=False
        )
        usable = int(np.count_nonzero(verdicts["usable"]))
        return Prepared(
            verdicts,
            array_checks.floats("inputs", self.inputs, len(INPUT_NAMES), rows=usable, of=_USABLE),
            array_checks.floats("measured", self.measured, len(AXES), rows=usable, of=_USABLE),
            array_checks.stamps("usable_ns", self.usable_ns, rows=usable, of=_USABLE),
            array_checks.records("derivatives", self.derivatives, derivatives, rows=usable, of=_USABLE),
            self._checked_erring(usable),
        )

    def _checked_erring(self, usable: int) -> Array:
        if len(self.erring) == 0:
            return _NOT_ERRING
        return array_checks.floats("erring", self.erring, ERRING_COLUMNS, rows=usable, of=_USABLE)

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


class Preparation:
    """Judges and filters the samples of one vehicle; memory and time per sample are constant.

    Args:
        vehicle: as in its vehicle file.
        rate_hz: sample rate of the IMU; None if :meth:`retune` will give it.
        cutoff_hz: of the low-pass.
        goes_with_air: whether the model does; else densities change nothing.

    Attributes:
        goes_with_air: as given.
        memory: a :class:`Memory` (1,), which compiled code changes in place.

    Raises:
        SignalError: if the sample rate is too low for the cut-off.
    """

    def __init__(
        self, vehicle: Vehicle, rate_hz: float | None, cutoff_hz: float, *, goes_with_air: bool = True
    ) -> None:
        self._vehicle = vehicle
        self.goes_with_air = goes_with_air
        self._verdict = record_dtype(Verdict, vehicle.rotor_count)
        self._derivatives = record_dtype(Derivatives, vehicle.rotor_count)
        self._cutoff_hz = cutoff_hz
        self._rate: ImuRate | None = None
        self._quality_hz = rate_hz or RATE_BEFORE_HZ
        self.memory = np.zeros(1, MEMORY)
        self.memory["vehicle"] = vehicle_constants(vehicle)
        self.memory["settling_ns"] = min(SETTLE_NS, round(1e9 * SETTLING_PERIODS / cutoff_hz))
        self.retune(ImuRate(rate_hz or 0.0))
        self.reset()

    def reset(self) -> None:
        """Forget the past: as after construction."""
        self.memory["quality"] = quality(self._vehicle, self._quality_hz)
        self.memory["chain"] = 0

    def retune(self, rate: ImuRate) -> None:
        """Go on with samples of another rate, with an empty low-pass. Without one, no sample is usable.

        Raises:
            SignalError: if the rate is too low for the cut-off; then no sample is usable either.
        """
        if rate == self._rate:
            return
        self._rate = rate
        memory = self.memory
        memory["chain"] = 0
        memory["low_pass"]["rate_hz"] = 0.0
        memory["fault_without_rate"] = RATE_DIFFERS if rate.differs else RATE_UNKNOWN
        if rate.filter_hz > 0.0:
            memory["fault_without_rate"] = RATE_LOW
            memory["low_pass"] = design_low_pass(self._cutoff_hz, rate.filter_hz)
            self._quality_hz = rate.filter_hz
            memory["quality"]["frozen_after_s"] = frozen_s(rate.filter_hz)

    def fly_in(self, density: float) -> None:
        """Go on in air of a density [kg/m³]; 0 where only the vehicle file tells."""
        known = self._vehicle.air_density_kg_m3
        self.memory["density_excess"] = density / known - 1.0 if density and self.goes_with_air else 0.0

    def step(self, time_ns: Stamps, values: Array, conditions: Records | None = None) -> Prepared:
        """Take K samples; see :meth:`quadpi_core.monitor.Monitor.step`."""
        count = len(time_ns)
        verdicts = np.zeros(count, self._verdict)
        inputs, measured = np.empty((count, len(INPUT_NAMES))), np.empty((count, len(AXES)))
        derivatives = np.empty(count, self._derivatives)
        filtered = _NOT_ASKED if conditions is None else np.empty((count, _CHANNELS))
        used = compiled.prepare(
            self.memory, time_ns, values, verdicts, inputs, measured, derivatives, filtered
        )
        inputs, measured, derivatives = inputs[:used], measured[:used], derivatives[:used]
        usable_ns = time_ns if used == count else time_ns[verdicts["usable"]]
        erring = _NOT_ERRING
        if conditions is not None:
            if not self.goes_with_air:
                conditions = conditions.copy()
                conditions["air_density"] = 0.0
            erring = np.empty((used, ERRING_COLUMNS))
            compiled.take_conditions(self.memory, conditions, verdicts, filtered[:used], derivatives, erring)
        return Prepared(verdicts, inputs, measured, usable_ns, derivatives, erring)
