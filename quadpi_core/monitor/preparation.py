# SPDX-FileCopyrightText: 2026 The quadpi authors
# SPDX-License-Identifier: Apache-2.0
"""From paired samples to filtered inputs and the measured wrench: what models of one cut-off share."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from quadpi_core import array_checks
from quadpi_core.core import compiled
from quadpi_core.errors import ArgumentError
from quadpi_core.estimator.filter_state import RATE_BEFORE_HZ, ImuRate
from quadpi_core.flight import AXES, NO_STAMP, Stamps
from quadpi_core.frames import Array
from quadpi_core.inputs import (
    DENSITY_MAX,
    DENSITY_MIN,
    INPUT_NAMES,
    Derivatives,
    VehicleConstants,
    derivatives_like,
    vehicle_constants,
)
from quadpi_core.records import ROTORS_MAX, PerRotor, Records, Threshold, Vector3, brief_repr, record_dtype
from quadpi_core.signals.chain import SETTLING_PERIODS, ChainMemory, LowPass, channels, design_low_pass
from quadpi_core.vehicle import Vehicle

# The density of the air, how sure the state is, and which rotor speeds are commands.

STATE_ERRORS = 9
# By what share of its scale a covariance may be off a symmetric one without negative variances: rounding.
_ROUNDING = 1e-9


class Conditions:
    """Of one sample.

    Attributes:
        air_density: kg/m³; 0 where only the vehicle file tells. At the same velocities and rotor speeds the
            wrench of the air goes with it.
        covariance: of the errors of the state: velocity in body axes m/s, rotation about the world's axes
            rad, rates rad/s; as `nav_msgs/Odometry` has them. Zero where nothing is known. What the model's
            flights were unsure of is in its intervals already: give what goes beyond.
        commanded: bit per rotor, the first 1, whose speed follows from its command, as nothing measured it.
            Verdicts carry it on; nothing is decided by it yet.
        wind_unknown: 1 while the wind is still to be told: horizontal forces are not judged.
    """

    air_density: float
    covariance: Annotated[Array, STATE_ERRORS, STATE_ERRORS]
    commanded: int
    wind_unknown: int


CONDITIONS = record_dtype(Conditions)


def conditions(
    samples: int,
    air_density: npt.ArrayLike | None = None,
    state_covariance: npt.ArrayLike | None = None,
    commanded: npt.ArrayLike | None = None,
) -> Records | None:
    """The :class:`Conditions` (K,) of samples; None where nothing is given.

    Args:
        samples: K.
        air_density: kg/m³, one or (K,).
        state_covariance: (9, 9) or (K, 9, 9), see :class:`Conditions`.
        commanded: (n,) or (K, n) which rotors' speeds are commands.

    Raises:
        ArgumentError: naming what is no density of air, no covariance, or of other shapes.
    """
    if air_density is None and state_covariance is None and commanded is None:
        return None
    found = np.zeros(samples, CONDITIONS)
    if air_density is not None:
        if np.ndim(air_density) == 0:
            air_density = np.full(samples, air_density)
        density = array_checks.floats("air_density", air_density, rows=samples, of="time_ns")
        if wrong := np.flatnonzero((density < DENSITY_MIN) | (density > DENSITY_MAX)).tolist():
            raise ArgumentError(
                f"air_density: sample {wrong[0]} has {density[wrong[0]]:g}, no density of air in kg/m³ "
                f"({DENSITY_MIN:g} to {DENSITY_MAX:g})"
            )
        found["air_density"] = density
    if commanded is not None:
        flags = np.atleast_2d(np.asarray(commanded))
        fits = flags.ndim == 2 and len(flags) in (1, samples) and flags.shape[1] <= ROTORS_MAX
        if flags.dtype != np.bool_ or not fits:
            raise ArgumentError(
                f"commanded: expected true or false for each rotor, found {array_checks.description(flags)}"
            )
        found["commanded"] = flags @ (1 << np.arange(flags.shape[1]))
    if state_covariance is not None:
        found["covariance"] = _checked(state_covariance, samples)
    return found


def _checked(covariance: npt.ArrayLike, samples: int) -> Array:
    if np.ndim(covariance) == 2:
        one = array_checks.floats("state_covariance", covariance, STATE_ERRORS, rows=STATE_ERRORS)
        covariance = np.broadcast_to(one, (samples, *one.shape))
    rows = array_checks.floats(
        "state_covariance", covariance, STATE_ERRORS, STATE_ERRORS, rows=samples, of="time_ns"
    )
    scale = np.sqrt(np.maximum(np.einsum("kii->ki", rows), 0.0))
    limits = _ROUNDING * scale[:, :, np.newaxis] * scale[:, np.newaxis]
    uneven = (np.abs(rows - np.swapaxes(rows, 1, 2)) > limits).any(axis=(1, 2))
    # In units of its own deviations, so that metres and radians are alike.
    units = np.where(scale > 0.0, scale, 1.0)
    least = np.linalg.eigvalsh(rows / (units[:, :, np.newaxis] * units[:, np.newaxis]))[:, 0]
    if wrong := np.flatnonzero(uneven | (least < -STATE_ERRORS * _ROUNDING)).tolist():
        raise ArgumentError(
            f"state_covariance: that of sample {wrong[0]} is none: not symmetric, or a variance below 0"
        )
    return rows


# Some faults make a sample unusable: it is not finite, not plausible, or its stamp does not advance. The
# others are reported of samples that are used: a sensor that repeats its reading for longer than noise
# allows, a rotor whose speed contradicts the others.
#
# The yaw moment of four rotors in flight is small, so the squared speeds of those turning one way and of
# those turning the other have about the same sum. A rotor reads half its speed where these sums differ, its
# own speed is far below that of the others, and doubling its reading makes the sums agree.

NOT_FINITE, NOT_PLAUSIBLE = compiled.NOT_FINITE, compiled.NOT_PLAUSIBLE
STAMP_REPEATED, STAMP_BACKWARD, GAP = compiled.STAMP_REPEATED, compiled.STAMP_BACKWARD, compiled.GAP
STATE_MISSING, ROTORS_MISSING = compiled.STATE_MISSING, compiled.ROTORS_MISSING
GYRO_FROZEN, ACCELEROMETER_FROZEN = compiled.GYRO_FROZEN, compiled.ACCELEROMETER_FROZEN
# One bit per rotor from each of these on, for rotors 1 to 4. Of `more_faults` the first has the bits of
# rotors 5 to 8 at the same places, the second those of rotors 9 to 12.
MoreFaults: TypeAlias = Annotated[npt.NDArray[np.int64], 2]
_OF_WORD = 4
ROTOR_FROZEN, ROTOR_HALF, ROTOR_JUMPS = compiled.ROTOR_FROZEN, compiled.ROTOR_HALF, compiled.ROTOR_JUMPS
ROTOR_DIFFERS, ROTOR_ZERO = compiled.ROTOR_DIFFERS, compiled.ROTOR_ZERO
# The IMU's rate.
RATE_DIFFERS, RATE_UNKNOWN, RATE_LOW = compiled.RATE_DIFFERS, compiled.RATE_UNKNOWN, compiled.RATE_LOW

# An inertial sensor repeats a sample bit for bit once in a while, not for this long [s] and this many
# samples.
_FROZEN_S, _FROZEN_SAMPLES = 0.03, 8
FINE_STEP = Threshold(
    "resolution in which a rotor that turns changes its reading within half a second",
    compiled.FINE_STEP,
    "of the speed",
    "in half a second of flight a rotor's speed changes by 0.6 % or more, that of one of four by 1.1 %",
    "24 real flights of five vehicles, in steps of 0 to 0.05 %",
)


class Quality:
    """What the checks know of the vehicle, and remember of the samples."""

    rotors: int
    rotor_speed_max: float  # rad/s, beyond which a reading is not plausible
    rotor_spins: PerRotor  # ±1
    frozen_after_s: float  # for which an inertial sensor may repeat a reading
    previous_ns: int  # stamp of the last usable sample; NO_STAMP before the first
    followed_ns: int  # of the last one that was usable but for readings of rotors
    # The last reading of each sensor, and for how long it has not changed.
    rates: Vector3
    rates_still_s: float
    specific_force: Vector3
    specific_force_still_s: float
    rotor_speeds: PerRotor
    rotor_still_s: PerRotor
    # Of all rotors, since each of them has not changed.
    rotors_lowest: Annotated[Array, ROTORS_MAX, ROTORS_MAX]
    rotors_highest: Annotated[Array, ROTORS_MAX, ROTORS_MAX]
    # The last reading that a rotor held, for how long it has not, and the smallest step between two [rad/s].
    rotor_held: PerRotor
    rotor_moves_s: PerRotor
    rotor_step: float
    mean_squares: PerRotor  # of the rotor speeds, over 0.3 s
    averaged_s: float  # since the means began


def quality(vehicle: Vehicle, rate_hz: float) -> Records:
    """The :class:`Quality` (1,) of a vehicle, and the sample rate of its IMU, before the first sample."""
    memory = np.zeros(1, record_dtype(Quality))
    memory["rotor_speed_max"] = vehicle.rotor_speed_spike_rad_s
    memory["rotors"] = vehicle.rotor_count
    memory["rotor_spins"][:, : vehicle.rotor_count] = vehicle.rotor_spins
    memory["frozen_after_s"] = frozen_s(rate_hz)
    memory["rotor_step"] = np.inf
    memory["previous_ns"] = memory["followed_ns"] = NO_STAMP
    return memory


def frozen_s(rate_hz: float) -> float:
    """For how long an inertial sensor of that rate may repeat a reading [s]."""
    return max(_FROZEN_S, _FROZEN_SAMPLES / rate_hz)


STATE_MISSING_WORDS, ROTORS_MISSING_WORDS = "state missing", "rotor speeds missing"
# Which of the two nobody can tell from a sample alone.
EITHER_MISSING_WORDS = "state or rotor speeds missing"


def fault_words(faults: int, more: Iterable[int] = ()) -> Iterator[str]:
    """What the bits of faults, and of those of more rotors than four, mean, in plain words."""
    words = {
        NOT_FINITE: "sample not finite",
        NOT_PLAUSIBLE: "sample not plausible",
        STAMP_REPEATED: "stamp repeated",
        STAMP_BACKWARD: "stamp runs backward",
        GAP: "gap in the samples",
        STATE_MISSING: STATE_MISSING_WORDS,
        ROTORS_MISSING: ROTORS_MISSING_WORDS,
        GYRO_FROZEN: "gyro frozen",
        ACCELEROMETER_FROZEN: "accelerometer frozen",
        RATE_DIFFERS: "imu rate is not imu_rate_hz",
        RATE_UNKNOWN: "imu rate not known yet",
        RATE_LOW: "imu rate too low for the model",
    }
    if faults & STATE_MISSING and faults & ROTORS_MISSING:
        yield EITHER_MISSING_WORDS
        faults &= ~(STATE_MISSING | ROTORS_MISSING)
    yield from (text for bit, text in words.items() if faults & bit)
    for first, text in (
        (ROTOR_FROZEN, "frozen"),
        (ROTOR_HALF, "reads half"),
        (ROTOR_JUMPS, "jumps"),
        (ROTOR_DIFFERS, "differs from the others"),
        (ROTOR_ZERO, "reads 0"),
    ):
        every = [bits & first << k for bits in (faults, *more) for k in range(_OF_WORD)]
        for rotor in np.flatnonzero(every).tolist():
            yield f"rotor {rotor + 1} {text}"


SETTLE_NS = compiled.SETTLE_NS


class Verdict:
    """What data quality and low-pass say of one sample.

    What follows `absent` means something for a sample that is usable, or but for absent rotors; the signals
    have passed the low-pass. A sample has not settled in the first :data:`SETTLE_NS` of a state, or after
    more than `MAX_GAP_NS` without one, nor before the low-pass has settled. Where rotor speeds alone are
    missing, the state goes on.
    """

    time_ns: int
    faults: int  # bits of what is wrong, see :mod:`quadpi_core.monitor.preparation`
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
    commanded: int  # bit per rotor whose speed follows from its command, see :class:`Conditions`
    wind_unknown: bool  # whether the wind is still to be told: horizontal forces are not judged


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
        return self.verdicts["usable"]

    @property
    def settled(self) -> npt.NDArray[np.bool_]:
        """(U,) which usable samples have settled."""
        return self.verdicts["settled"][self.usable]


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
